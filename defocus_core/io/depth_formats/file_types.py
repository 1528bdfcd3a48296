"""Reading of depth files other than EXR: the type of a file, and its numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, UsageProblem
from defocus_core.io.array_files import (
    NAMED,
    ArrayEntry,
    array_type,
    frames_of,
    read_entries,
    squeezed_shape,
    wrong_shape,
)
from defocus_core.io.depth_formats.exr_depth_channel import NO_DEPTH, NoDepthChannel
from defocus_core.io.depth_formats.jpeg_overshoot import without_overshoot
from defocus_core.io.depth_formats.photo_depth import read_heic, read_jpeg
from defocus_core.io.depth_formats.reading import (
    DepthNumbers,
    DepthReading,
    Mark,
    own_format,
    require_size,
)
from defocus_core.io.depth_formats.rules import linear
from defocus_core.io.depth_formats.sidecars import with_sidecar
from defocus_core.io.depth_formats.table import NAMES, OF_PHOTOGRAPHS
from defocus_core.io.exr.channel_choice import require_part
from defocus_core.io.exr.windows import Overscan
from defocus_core.io.images import raster
from defocus_core.io.read_files import is_heic, is_jpeg, read_head

# Greatest difference, in levels of 8 bits, of the channels of grey after JPEG; weights of its luma.
_CHROMA_NOISE, _LUMA = 24, (0.299, 0.587, 0.114)
# Metadata assumed for a photograph without a unit or range, whose numbers are relative.
_ANY_ENDS = {"Units": "m", "d_min": 0.0, "d_max": 1.0, "z_near": 1.0, "z_far": 5.0}
WANTED = "EXR, PFM, NPY or float TIFF, or 16-bit PNG in millimetres"

Size = tuple[int, int] | None  # (width, height) of the colour of a depth file, if it has one


def other_numbers(
    path: Path, reading: DepthReading, size: Size, overscan: Overscan
) -> DepthNumbers:
    """The numbers of a depth file that is not EXR; `size`: (width, height) in px of its colour."""
    row, head = reading.row, read_head(path, 32)
    own = own_format(path) if reading.depth_format is None else row.name
    kind = "" if is_heic(head) else array_type(head)
    if reading.depth_channel is not None and kind not in NAMED:
        problem = f"{path} has no named channels"
        raise UsageProblem("idle-option", problem, "leave it out", field="depth-channel")
    if is_heic(head):
        return _from_photo(path, reading, read_heic(path), size)
    if kind:
        return _from_arrays(path, reading, kind, size)
    if is_jpeg(head) and own in OF_PHOTOGRAPHS:
        return _from_photo(path, reading, read_jpeg(path), size)
    return _from_picture(path, reading, size)


def _from_photo(path: Path, reading: DepthReading, photo: DepthNumbers, size: Size) -> DepthNumbers:
    """The numbers of the depth image in a photograph.

    If the reading is relative, they become disparity; else they are those of the file.
    """
    if not reading.relative and photo.type == "GDepth" and "Units" not in photo.metadata:
        problem = "has GDepth without Units, which is relative"
        remedy = "give ‹blur› 20px ‹focus-at› X,Y instead of a lens"
        raise InputError("unknown-unit", problem, remedy, path=path)
    require_size(path, reading, photo.values.shape, size)
    if not reading.relative:
        return photo
    row = replace(reading.row, sidecar=NAMES[own_format(path)].sidecar)
    told = {name: value for name, value in photo.metadata.items() if value is not None}
    row = with_sidecar(row, replace(photo, metadata=_ANY_ENDS | told))
    assert row.ends is not None
    scale, shift = linear(*row.ends, photo.top)
    numbers = photo.values.astype(np.float32) * scale + shift
    near = np.float32(1) / numbers if row.rule == "scale" else numbers
    return replace(photo, values=near.astype(np.float32))


def _from_arrays(path: Path, reading: DepthReading, kind: str, size: Size) -> DepthNumbers:
    row, entries = reading.row, read_entries(path)
    name = _array_name(path, entries, reading)
    values = _frame(path, entries[name], reading, size)
    marks: tuple[Mark, ...] = ()
    if row.holes in entries and name != row.holes:
        holes = _frame(path, entries[row.holes], reading, size) == 0
        marks = (Mark(holes, np.nan, f"holes of {row.holes}"),)
    words = f"{kind} array {name}" if name else kind
    kind = "integer NPY" if kind == "NPY" and values.dtype.kind in "iu" else kind
    return DepthNumbers(path, values, kind, words, channel=name, marks=marks)


def _array_name(path: Path, entries: Mapping[str, ArrayEntry], reading: DepthReading) -> str:
    """The name of the depth array: the one asked for, that of the format, or the only one."""
    names = ", ".join(list(entries)[:20])
    if reading.depth_channel is not None:
        if reading.depth_channel not in entries:
            problem = f"has no array {reading.depth_channel}; it has {names}"
            raise InputError("no-such-channel", problem, "check ‹depth-channel›", path=path)
        return reading.depth_channel
    for pattern in reading.row.channels:
        for name in entries:
            if fnmatchcase(name, pattern) or fnmatchcase(name.rpartition("/")[2], pattern):
                return name
    if len(entries) == 1:
        return next(iter(entries))
    remedy = "choose one with ‹depth-channel›"
    raise InputError("ambiguous", f"holds the arrays {names}", remedy, path=path)


def _frame(path: Path, entry: ArrayEntry, reading: DepthReading, size: Size) -> NDArray[Any]:
    """The map [H, W] that the reading chooses from an array in a file."""
    row, index, shape = reading.row, None, squeezed_shape(entry.shape)
    frames = frames_of(shape)
    if frames > 1 and ("N" in row.axes or entry.shape[-1] not in (2, 3, 4)):
        if reading.part is None:
            remedy = "choose one with ‹part›, counted from 0"
            raise InputError("ambiguous", f"holds {frames} frames", remedy, path=path)
        require_part(path, reading.part, frames)
        index, shape = reading.part, squeezed_shape(shape[1:])
    if len(shape) != 2:
        raise wrong_shape(path, shape)
    is_turned = row.axes.endswith("WH")
    require_size(path, reading, shape[::-1] if is_turned else shape, size)
    values = entry.load(index) if entry.shape[0] != 1 or index is None else entry.load(0)[index]
    return values.reshape(shape).T if is_turned else values.reshape(shape)


def _from_picture(path: Path, reading: DepthReading, size: Size) -> DepthNumbers:
    """The numbers of a PNG, TIFF or JPEG.

    They are one channel, or are put together from several channels as the format says.
    """
    row = reading.row
    page = raster.choose_page(path, raster.read_pages(path, wanted=WANTED), reading.part)
    if page.deep:
        raise InputError("deep-data", "holds deep data", "flatten it first", path=path)
    bits = {"uint8": "8-bit", "uint16": "16-bit"}.get(page.type, page.type)
    first = page.width // 2 if row.is_right_half else 0
    kind, shape = f"{bits} {path.suffix[1:].upper()}", (page.height, page.width - first)
    require_size(path, reading, shape, size)
    if row.weights or row.bits == "float32":
        channels = {3: "8-bit RGB", 4: "8-bit RGBA"} if page.type == "uint8" else {}
        file_type = channels.get(len(page.channels), kind)
        values = raster.read_samples(path, page.page)
        if file_type in row.files and row.weights:
            planes = values[..., : len(row.weights)].astype(np.float64)
            values = planes @ np.array(row.weights)
        elif file_type in row.files:  # OpenCV reads B, G, R, A: these are its bytes, little endian
            values = np.ascontiguousarray(values[..., [2, 1, 0, 3]]).view("<f4")[..., 0]
        return DepthNumbers(path, values, file_type, kind)
    _refuse_unsuited(path, page, reading)
    samples = raster.read_samples(path, page.page)[:, first:]
    values = samples[:, :, 0] if len(page.channels) < 3 else _grey(path, samples)
    if is_jpeg(read_head(path)):
        values = without_overshoot(values)
    if page.type == "half":  # of which 65504 is sky
        values = values.astype(np.float16)
    greatest = 2**page.bits - 1 if page.bits else None
    if greatest is not None:  # the numbers in the file, before they were stretched
        kind = f"{page.bits}-bit {path.suffix[1:].upper()}"
        values = np.rint(values * (greatest / np.iinfo(values.dtype).max)).astype(values.dtype)
    if row.bits == "float16":
        values = values.astype(np.uint16).view(np.float16)
    file_type = {"uint16": "16-bit PNG", "uint8": "8-bit PNG"}.get(page.type, "float TIFF")
    return DepthNumbers(path, values, file_type, kind, greatest=greatest)


def _grey(path: Path, samples: NDArray[Any]) -> NDArray[Any]:
    """The single channel [h, w] of samples [h, w, 3…] whose R, G and B are equal.

    JPEG may make 8-bit channels differ a little: then it is their luma.
    """
    colors = samples[:, :, :3]
    r, g, b = (colors[:, :, c] for c in range(3))  # five times as fast as along the last axis
    spread = np.maximum(np.maximum(r, g), b) - np.minimum(np.minimum(r, g), b)
    if not spread.any():
        return r
    if spread.max() > _CHROMA_NOISE or samples.dtype != np.uint8:
        problem = "has channels R, G, B of other values; depth is one channel"
        remedy = "save the depth itself as a single grey channel: drawn in colours, it is lost"
        raise InputError("not-one-channel", problem, remedy, path=path)
    return np.rint(colors @ _LUMA).astype(samples.dtype)


def _refuse_unsuited(path: Path, page: raster.Raster, reading: DepthReading) -> None:
    """Refuse pictures of 8 bits or of several channels, unless options say what numbers mean."""
    if reading.says_scale:
        return
    if page.type == "uint8":
        problem = "has 8 bits, too few for depth and without a metric scale"
        remedy = f"save depth as {WANTED}; or give ‹depth-range› NEAR FAR and ‹depth-kind›; "
        remedy += "or take it as relative with ‹blur› 20px ‹focus-at› X,Y instead of a lens"
        raise InputError("unknown-unit", problem, remedy, path=path)
    if page.channels[0] in NO_DEPTH:
        problem = f"has no depth channel, only {page.channels[0]}"
        remedy = "give the depth; signed radii are ‹depth-format› coc"
        raise NoDepthChannel("no-depth", problem, remedy, path=path)
    if len(page.channels) == 2:
        problem = f"has channels {', '.join(page.channels)}; depth is one channel"
        remedy = "save the depth as a single grey channel"
        raise InputError("not-one-channel", problem, remedy, path=path)


_TOP = 65535  # of 16 bits
_PARTS = 6  # last parts of a path that are searched for signs of a format
# Patterns that the last parts of a path match, in lower case, by the format that they suggest.
_SIGNS = {
    "vkitti2": r"vkitti|virtual.?kitti|frames/depth/camera_[01]/",
    "kitti": r"proj_depth/(groundtruth|velodyne_raw)/|_selection_cropped/",
    "matterport": r"undistorted_depth_images/|[0-9a-f]{32}_d[0-2]_[0-5]\.png$",
    "tum": r"rgbd_dataset_freiburg|rgbd_bonn|smart_?portraits",
    "ibims1": r"ibims-?1",
    "pointodyssey": r"point_?odyssey",
    "dynamicreplica": r"dynamic_?replica",
    "co3d": r"co3d|\.jpg\.geometric\.png$",
    "cityscapes": r"[a-z]+_\d{6}_\d{6}_disparity\.png$",
}


def refuse_assumed(path: Path, values: NDArray[np.uint16]) -> None:
    """Refuse to take 16-bit numbers [H, W] as millimetres if their path or range contradicts."""
    place = "/".join(path.absolute().parts[-_PARTS:]).lower()
    for name, sign in _SIGNS.items():
        if found := re.search(sign, place):
            problem = f"has 16 bits that may be {name}, not millimetres: its path has '{found[0]}'"
            remedy = f"give ‹depth-format› {name}, or ‹depth-unit› mm"
            raise InputError("unknown-unit", problem, remedy, path=path)
    if (values == 0).any() and (values == _TOP).any():
        problem = f"has numbers from 0 to {_TOP}, as depth has that is scaled file by file"
        remedy = "give ‹depth-range› NEAR FAR and ‹depth-kind›; or ‹depth-unit› mm, or "
        remedy += "‹depth-format›"
        raise InputError("unknown-unit", problem, remedy, path=path)

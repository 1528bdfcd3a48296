"""Depth files of every type opened: which type a file is of, and its numbers."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, UsageProblem
from defocus_core.io.array_files import (
    NPY_MAGIC,
    ArrayEntry,
    bare_type,
    container_type,
    is_float_map,
    read_bare,
    read_entries,
    read_float_map,
    read_headerless,
    read_npy,
    wrong_shape,
)
from defocus_core.io.arrays import Keeping, bands
from defocus_core.io.depth_formats.photo_depth import PhotoDepth, read_gdepth, read_heic
from defocus_core.io.depth_formats.reading import DepthReading, own_format, require_size
from defocus_core.io.depth_formats.rules import DepthFormat, DepthNumbers
from defocus_core.io.depth_formats.sidecars import facts_of
from defocus_core.io.exr.channel_choice import require_part
from defocus_core.io.images.raster import Raster, choose_page, pnm_top, read_pages, read_samples
from defocus_core.io.safe_files import decoding, is_heic, is_jpeg, read_head
from defocus_core.system.text import percent

# Nine colours of each map at even steps, sRGB.
_MAPS = {
    "viridis": "440154 472d7b 3b528b 2c728e 21918c 27ad81 5cc863 aadc32 fde725",
    "inferno": "000004 210c4a 57106e 8a226a bc3754 e35933 f98c0a f9c932 fcffa4",
    "magma": "000004 1d1147 51127c 832681 b73779 e55064 fb8761 fec287 fcfdbf",
    "plasma": "0d0887 4c02a1 7e03a8 aa2395 cc4778 e56b5d f89441 fdc328 f0f921",
    "turbo": "30123b 466be3 28bceb 32f298 a4fc3c ecd13a fb8122 d23105 7a0403",
    "jet": "000080 0000ff 0080ff 16ffe1 7dff7a e1ff16 ff9800 ff2200 800000",
    "Spectral": "9e0142 dd4a4c f98e52 fed481 ffffbe d8ef9b 89d0a4 3f97b7 5e4fa2",
}
# Levels of 8 bits that a colour may be away from its map, by few steps and a codec; the share of
# pixels that are near; steps between the colours of the table.
_NEAR, _MOST, _STEPS = 30, 0.95, 8


def color_map_of(pixels: NDArray[Any]) -> str:
    """The map that colours [N, 3] of 8 bits are drawn in; empty if it is not sure."""
    for name, words in _MAPS.items():
        colors = np.array([list(bytes.fromhex(word)) for word in words.split()], float)
        at = np.linspace(0, len(colors) - 1, (len(colors) - 1) * _STEPS + 1)
        line = np.stack([np.interp(at, range(len(colors)), c) for c in colors.T], axis=1)
        away = np.abs(pixels[:, None].astype(float) - line).max(axis=2).min(axis=1)
        if np.mean(away <= _NEAR) >= _MOST:
            return name
    return ""


# Levels of 8 bits by which channels of grey differ after JPEG; weights of its luma; pixels of a
# strip that are looked at for a map of colours.
_CHROMA_NOISE, _LUMA, _LOOKED_AT = 24, (0.299, 0.587, 0.114), 500
WANTED = "EXR, PFM, NPY or float TIFF, or 16-bit PNG in millimetres"


def numbers_of(
    path: Path, reading: DepthReading, keeping: Keeping, size: tuple[int, int] | None
) -> DepthNumbers:
    """The numbers of a depth file that is no EXR; `size`: (width, height) of its colour."""
    row, head = reading.row, read_head(path, 32)
    if row.files == ("headerless",):
        width, height = size or row.size or (0, 0)
        return DepthNumbers(read_headerless(path, (width, height)), "headerless", "float32 rows")
    if path.suffix.lower() == ".exr":
        raise InputError("wrong-type", "is not an OpenEXR file", "check what wrote it", path=path)
    if kind := container_type(head):
        return _from_container(path, reading, kind, size)
    if reading.depth_channel is not None:
        problem = f"{path} has no named channels"
        raise UsageProblem("idle-option", problem, "leave it out", field="depth-channel")
    if is_float_map(head):
        samples = _from_map(path, reading)
    elif kind := bare_type(head):
        samples = DepthNumbers(read_bare(path), kind, kind)
    elif is_heic(head):
        samples = _from_photo(path, read_heic(path), "HEIC", reading)
    elif is_jpeg(head) and (
        "GDepth" in row.files or (not reading.depth_format and own_format(path))
    ):
        samples = _from_photo(path, read_gdepth(path), "GDepth", reading)
    else:
        samples = _from_raster(path, reading, keeping, size)
    require_size(path, reading, samples.values.shape, size)
    return samples


def _from_photo(
    path: Path, photo: PhotoDepth, file_type: str, reading: DepthReading
) -> DepthNumbers:
    """Numbers of a depth image in a photograph, of unsigned integers; relative ones as 1 / z."""
    metadata = {**photo.metadata, "top": 2.0 ** (8 * photo.values.itemsize) - 1}
    words = f"{file_type} depth image"
    if not reading.relative and file_type == "GDepth" and "Units" not in metadata:
        problem, remedy = (
            "has GDepth without Units, which is relative",
            "say ‹blur› 20px ‹focus-at› X,Y",
        )
        raise InputError("unknown-unit", problem, f"{remedy} instead of a lens", path=path)
    if not reading.relative:
        return DepthNumbers(photo.values, file_type, words, metadata=metadata)
    facts = facts_of(file_type.lower(), path, {"Units": "m", **metadata})
    assert facts is not None
    numbers = photo.values.astype(np.float32) * (facts.scale or 0.0) + (facts.shift or 0.0)
    near = np.float32(1) / numbers if facts.rule == "scale" else numbers
    return DepthNumbers(near.astype(np.float32), file_type, words, metadata=metadata)


def _from_map(path: Path, reading: DepthReading) -> DepthNumbers:
    """Numbers of a PFM, or of an NPY whose axes the format may say."""
    row, integers = reading.row, reading.says_scale
    if read_head(path).startswith(NPY_MAGIC) and (row.plane is not None or "N" in row.axes):
        values = _map_of(path, read_npy(path, integers=integers), row, reading.part)
        file_type = "NPY"
    else:
        read = read_float_map(path, integers=integers)
        values, file_type = read.values, read.format
    whole = values.dtype.kind in "iu"
    return DepthNumbers(values, f"integer {file_type}" if whole else file_type, file_type)


def _from_container(
    path: Path, reading: DepthReading, kind: str, size: tuple[int, int] | None
) -> DepthNumbers:
    row, entries = reading.row, read_entries(path)
    name = _array_name(path, entries, reading)
    values = _frame(path, entries[name], reading, size)
    holes = None
    if row.holes and row.holes in entries and name != row.holes:
        holes = _frame(path, entries[row.holes], reading, size) == 0
    return DepthNumbers(values, kind, f"{kind} array {name}", channel=name, holes=holes)


def _array_name(path: Path, entries: Mapping[str, ArrayEntry], reading: DepthReading) -> str:
    """The array that holds the depth: the one named, that of the format, or the only one."""
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


def _frame(
    path: Path, entry: ArrayEntry, reading: DepthReading, size: tuple[int, int] | None
) -> NDArray[Any]:
    """One map of an array in a container, of which no more than that is loaded."""
    row, part, shape, index = reading.row, reading.part, entry.shape, None
    frames = len(shape) > 2 and ("N" in row.axes or shape[-1] > 4)
    if frames and shape[0] != 1 and row.plane is None:
        index, shape, part = _chosen_frame(path, shape[0], part), shape[1:], None
    with decoding(path):  # a shape may be beyond what NumPy counts
        outline = np.broadcast_to(np.uint8(0), shape)
    require_size(path, reading, _map_of(path, outline, row, part).shape, size)
    return _map_of(path, entry.load(index), row, part)


def _map_of(path: Path, values: NDArray[Any], row: DepthFormat, part: int | None) -> NDArray[Any]:
    """One map [H, W] of an array of any number of axes."""
    while values.ndim > 2 and values.shape[0] == 1:
        values = values[0]
    if values.ndim == 3 and row.plane is not None:
        values = values[:, :, row.plane]
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[:, :, 0]
    if values.ndim == 3 and "N" in row.axes:
        values = values[_chosen_frame(path, values.shape[0], part)]
    if values.ndim != 2:
        raise wrong_shape(path, values.shape)
    return values.T if row.axes.endswith("WH") else values


def _chosen_frame(path: Path, count: int, part: int | None) -> int:
    """The frame that ``part`` chooses of several."""
    if part is None:
        remedy = "choose one with ‹part›, counted from 0"
        raise InputError("ambiguous", f"holds {count} frames", remedy, path=path)
    require_part(path, part, count)
    return part


def _from_raster(
    path: Path, reading: DepthReading, keeping: Keeping, picture: tuple[int, int] | None
) -> DepthNumbers:
    """Numbers of a PNG, TIFF or JPEG: one channel, or the bits of a pixel of several."""
    row = reading.row
    raster = choose_page(path, read_pages(path, wanted=WANTED), reading.part)
    if raster.deep:
        raise InputError("deep-data", "holds deep data", "flatten it first", path=path)
    bits = {"uint8": "8-bit", "uint16": "16-bit"}.get(raster.type, raster.type)
    kind = f"{bits} {path.suffix[1:].upper()}"
    metadata = png_text(path) if row.sidecar == "text-chunks" else {}
    dtypes = {"uint8": np.uint8, "uint16": np.uint16, "half": np.float16}  # 65504 of half is sky
    dtype = dtypes.get(raster.type, np.float32)
    size = raster.height, raster.width
    require_size(path, reading, size, picture)
    if row.weights or row.bits == "float32":
        packed = np.empty((*size, len(raster.channels)), dtype)
        for window, samples in read_samples(path, raster.page):
            packed[window] = samples
        several = len(raster.channels) in (3, 4) and raster.type == "uint8"
        file_type = f"8-bit {'RGBA' if len(raster.channels) == 4 else 'RGB'}" if several else kind
        return DepthNumbers(packed, file_type, kind)
    _refuse_unsuited(path, raster, reading)
    values = keeping.new(size, dtype)
    for window, samples in read_samples(path, raster.page):
        values[window] = samples[:, :, 0] if len(raster.channels) < 3 else _grey(path, samples)
    if (top := pnm_top(path)) is not None:
        values = np.rint(values[:] * (top / (255 if raster.type == "uint8" else 65535))).astype(
            dtype
        )
    file_type = {"uint16": "16-bit PNG", "uint8": "8-bit PNG"}.get(raster.type, "float TIFF")
    return DepthNumbers(values, file_type, kind, metadata=metadata)


def _grey(path: Path, samples: NDArray[Any]) -> NDArray[Any]:
    """The luma of samples [h, w, 3…] of equal channels, or of 8 bits but for a codec's noise."""
    colors = samples[:, :, :3]
    r, g, b = (colors[:, :, c] for c in range(3))  # five times as fast as along the last axis
    spread = np.maximum(np.maximum(r, g), b) - np.minimum(np.minimum(r, g), b)
    if not spread.any():
        return r
    if spread.max() > _CHROMA_NOISE or samples.dtype != np.uint8:
        raise _color_error(path)
    return np.rint(colors @ _LUMA).astype(samples.dtype)


def _color_error(path: Path) -> InputError:
    """The error for depth of several channels, by the name of the map that it is drawn in."""
    page = choose_page(path, read_pages(path), None)
    pieces = (np.ravel(s[:, :, :3]).reshape(-1, 3) for _, s in read_samples(path, page.page))
    pixels = np.concatenate([piece[:: 1 + len(piece) // _LOOKED_AT] for piece in pieces])
    name = color_map_of(pixels) if pixels.dtype == np.uint8 else ""
    if name:
        problem = f"is depth drawn in the colours of {name}, whose numbers are lost"
        return InputError("not-one-channel", problem, "save the depth itself, in grey", path=path)
    problem = f"has channels {', '.join(page.channels)} of other values; depth is one channel"
    remedy = "save the depth as a single grey channel"
    return InputError("not-one-channel", problem, remedy, path=path)


def _refuse_unsuited(path: Path, raster: Raster, reading: DepthReading) -> None:
    """Refuse pictures of 8 bits, and of several channels, unless options declare them as depth."""
    if raster.type == "uint8" and not reading.says_scale:
        if len(raster.channels) >= 3 and "drawn" in (error := _color_error(path)).problem:
            raise error
        problem = "has 8 bits, too few for depth and without a metric scale"
        remedy = f"save depth as {WANTED}; or say ‹depth-range› NEAR FAR and ‹depth-kind›"
        raise InputError("unknown-unit", problem, remedy, path=path)
    if len(raster.channels) != 1 and not reading.says_scale:
        problem = f"has channels {', '.join(raster.channels)}; depth is one channel"
        remedy = "save the depth as a single grey channel"
        raise InputError("not-one-channel", problem, remedy, path=path)


_TOP = 65535  # of 16 bits
_PARTS = 6  # of a path, from its end, that are looked at
_KITTI_SIZES = ((1242, 375), (1241, 376), (1238, 374), (1226, 370), (1224, 370), (1216, 352))


@dataclass(frozen=True)
class Sign:
    """A sign of a format."""

    format: str
    path: str = ""  # an expression that the end of the path matches, in small letters
    sizes: tuple[tuple[int, int], ...] = ()  # (width, height) in px; empty for any
    zeros: tuple[float, float] = (0.0, 1.0)  # least and greatest share of pixels that are 0
    tops: float = 0.0  # least share of pixels that are 65535
    maximum: int = _TOP  # the greatest number


SIGNS = (
    Sign(
        "kitti",
        r"proj_depth/(groundtruth|velodyne_raw)/|_selection_cropped/|kitti",
        zeros=(0.2, 1),
        maximum=32000,
    ),
    Sign("kitti", sizes=_KITTI_SIZES, zeros=(0.5, 1), maximum=32000),
    Sign("vkitti2", r"vkitti|virtual.?kitti|frames/depth/camera_[01]/", zeros=(0, 0)),
    Sign("vkitti2", sizes=((1242, 375),), zeros=(0, 0), tops=0.001),
    Sign("matterport", r"undistorted_depth_images/|[0-9a-f]{32}_d[0-2]_[0-5]\.png$"),
    Sign("tum", r"rgbd_dataset_freiburg|rgbd_bonn|smart_?portraits"),
    Sign("ibims1", r"ibims-?1"),
    Sign("pointodyssey", r"point_?odyssey"),
    Sign("dynamicreplica", r"dynamic_?replica"),
    Sign("co3d", r"co3d|\.jpg\.geometric\.png$"),
    Sign("cityscapes", r"[a-z]+_\d{6}_\d{6}_disparity\.png$"),
)


def refuse_named(path: Path, values: Any) -> None:
    """Refuse 16 bits [H, W] as millimetres that have a sign of another format."""
    place, size = "/".join(path.absolute().parts[-_PARTS:]).lower(), values.shape[1::-1]
    likely = [
        (sign, found)
        for sign in SIGNS
        if (found := re.search(sign.path, place)) and (not sign.sizes or size in sign.sizes)
    ]
    if not likely:
        return
    zeros, tops, maximum = _counted(values)
    for sign, found in likely:
        if (
            sign.zeros[0] <= zeros <= sign.zeros[1]
            and sign.tops <= tops
            and maximum <= sign.maximum
        ):
            told = [f"its path has '{found[0]}'"] if sign.path else [f"{size[0]}x{size[1]} px"]
            told += [
                f"{percent(share)} are {n}" for n, share in ((0, zeros), (_TOP, tops)) if share
            ]
            problem = f"has 16 bits that may be {sign.format}, not millimetres: {', '.join(told)}"
            remedy = f"say ‹depth-format› {sign.format}, or ‹depth-unit› mm"
            raise InputError("unknown-unit", problem, remedy, path=path)


def _counted(values: Any) -> tuple[float, float, int]:
    """The shares of numbers that are 0 and 65535, and the greatest number."""
    zeros = tops = maximum = 0
    for rows in bands(values.shape):
        band = values[rows]
        zeros, tops = zeros + int((band == 0).sum()), tops + int((band == _TOP).sum())
        maximum = max(maximum, int(band.max()))
    pixels = values.shape[0] * values.shape[1]
    return zeros / pixels, tops / pixels, maximum


_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_LONGEST = 1 << 16  # bytes of a text that is read
_MAX_CHUNKS = 100_000


def png_text(path: Path) -> dict[str, str]:
    """Keys and values of tEXt, zTXt and iTXt chunks before or after the pixels; empty if none.

    Chunks longer than 64 kB are passed over, and what is damaged ends the list.
    """
    texts: dict[str, str] = {}
    with path.open("rb") as file:
        if file.read(8) != _SIGNATURE:
            return texts
        for _ in range(_MAX_CHUNKS):
            if len(head := file.read(8)) < 8:
                break
            size, kind = struct.unpack(">I4s", head)
            if kind in (b"tEXt", b"zTXt", b"iTXt") and size <= _LONGEST:
                key, _, value = file.read(size).partition(b"\0")
                texts[key.decode("latin-1")] = _value(kind, value)
                file.seek(4, 1)
            elif kind == b"IEND":
                break
            else:
                file.seek(size + 4, 1)
    return texts


def _value(kind: bytes, value: bytes) -> str:
    if kind == b"tEXt":
        return value.decode("latin-1")
    if kind == b"zTXt":
        return _inflate(value[1:]).decode("latin-1", "replace")
    compressed, text = value[:1] == b"\1", value[2:].split(b"\0", 2)[-1]
    return (_inflate(text) if compressed else text).decode("utf-8", "replace")


def _inflate(data: bytes) -> bytes:
    try:
        return zlib.decompressobj().decompress(data, _LONGEST)
    except zlib.error:
        return b""

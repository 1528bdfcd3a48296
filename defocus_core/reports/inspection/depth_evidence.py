"""Evidence of a depth file's format: numbers, names and files beside it, for people to judge.

Nothing is read by it: it only names the formats that a file could be of.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import DefocusError
from defocus_core.io.array_files import container_type
from defocus_core.io.arrays import Keeping, bands
from defocus_core.io.depth_formats.depth import read_numbers
from defocus_core.io.depth_formats.file_types import png_text
from defocus_core.io.depth_formats.reading import DepthReading, holds_depth, holds_gdepth
from defocus_core.io.depth_formats.rules import DepthNumbers
from defocus_core.io.depth_formats.table import ROWS
from defocus_core.io.exr.header import is_exr
from defocus_core.io.images.describe import FileInfo
from defocus_core.io.safe_files import is_heic, read_head
from defocus_core.system.text import percent

_TOP = 65535
_SEVERAL = 0.001  # share of pixels
# Names of channels and arrays that only one format has.
_TELLING_NAMES = {
    "unreal-mrq": ("FinalImage*WorldDepth*", "ImageDepth*"),
    "coc": ("coc",),
    "hypersim": ("dataset",),
    "nyu-mat": ("rawDepths",),
    "spring": ("disparity",),
    "vision-blender": ("depth_map",),
}
_BESIDE = {
    "middlebury": ("PFM", "calib.txt"),
    "hci-lightfield": ("PFM", "parameters.cfg"),
    "diode": ("NPY", "{stem}_mask.npy"),
    "moge": ("EXR", "fov.json"),
}
# Relative depth is inverted if the top tenth of a picture is nearer by more of the range than this.
_STRIPS, _MOST = 10, 0.6


def may_be_depth(info: FileInfo) -> bool:
    """Whether a file is an EXR, arrays, one channel, or a photograph that holds depth."""
    head = read_head(info.path, 32)
    arrays = len(info.parts[0].channels) == 1 or container_type(head) != ""
    return is_exr(head) or arrays or holds_depth(info.path)


def is_grey_in_color(info: FileInfo, reading: DepthReading, keeping: Keeping) -> bool:
    """Whether a picture of 8 bits and several channels is as grey as one of a single channel."""
    channels = info.parts[0].channels
    if len(channels) < 3 or channels[0][1] != "uint8" or reading.depth_format is not None:
        return False
    try:  # stops at the first pixel of a colour
        read_numbers(info.path, replace(reading, depth_scale=1.0), keeping, None)
    except DefocusError:
        return False
    return True


def evidence_of(
    path: Path, reading: DepthReading, info: FileInfo, keeping: Keeping
) -> tuple[str, ...]:
    """Sentences on the formats that a depth file could be of, and on one that seems inverted."""
    sentences = [] if reading.depth_format is not None else [*_names_evidence(path, info)]
    if holds_gdepth(path):
        return tuple(sentences)
    try:
        scaled = reading if reading.says_scale else replace(reading, depth_scale=1.0)
        samples = read_numbers(path, scaled, keeping, None)
    except DefocusError:  # another line of the report says why
        return tuple(sentences)
    if reading.depth_format is None:
        sentences += _numbers_evidence(path, samples, reading)
    if reading.relative or samples.type == "8-bit PNG":
        sentences += _inverted(samples.values, black_is_near=reading.invert is not None)
    return tuple(sentences)


def _names_evidence(path: Path, info: FileInfo) -> Iterator[str]:
    """Evidence of the names of channels, and of files beside the depth file."""
    names = [name.split(" ")[0] for part in info.parts for name, _ in part.channels]
    for name, patterns in _TELLING_NAMES.items():
        hits = [n for n in names if any(fnmatchcase(n, pattern) for pattern in patterns)]
        if hits:
            yield f"{hits[-1]}: {_say(name)}"
    if holds_gdepth(path):
        yield f"GDepth in its XMP: {_say('android-gdepth')}"
    if is_heic(read_head(path)):
        yield f"a depth image beside the picture: {_say('apple-heic')}"
    kind = path.suffix[1:].upper()
    for name, (file_type, place) in _BESIDE.items():
        if kind == file_type and path.with_name(place.format(stem=path.stem)).is_file():
            yield f"{place.format(stem=path.stem)} beside it: {_say(name)}"


def _numbers_evidence(path: Path, samples: DepthNumbers, reading: DepthReading) -> Iterator[str]:
    """Evidence of the numbers of a file without a named format."""
    texts = png_text(path)
    if {"near", "far"} <= texts.keys():
        yield f"text chunks near and far: {_say('moge-png')}"
        return
    if samples.type == "16-bit PNG":
        top, zero = (_share(samples, number) for number in (_TOP, 0))
        if top >= _SEVERAL:
            names = [r.name for r in _rows_of("16-bit PNG") if 65000 <= r.sky <= _TOP]
            yield f"{_TOP} in {percent(top)} of the 16-bit pixels: {_say(*names)}"
        if zero >= _SEVERAL:
            names = [r.name for r in _rows_of("16-bit PNG") if 0 in r.invalid and r.rule == "scale"]
            shown = ", ".join(names[:5])
            yield (
                f"0 in {percent(zero)} of the 16-bit pixels: holes of {shown} and others, or far "
                "away by a network; say ‹depth-format›, and ‹invalid› far or fill for holes"
            )
    if samples.type == "8-bit PNG" and not reading.says_scale:
        yield (
            "8 bits: relative depth of a network; say ‹blur› 20px ‹focus-at› X,Y if bright is near "
            "(‹invert› if not), or in metres ‹depth-range› NEAR FAR, and ‹depth-kind› disparity if "
            "bright is near, or depth if bright is far"
        )
    has_sidecar = any(path.with_name(place).is_file() for _, place in _BESIDE.values())
    if samples.type == "PFM" and not has_sidecar and samples.values.min() < 0:
        yield f"negative numbers: disparity about a plane, {_say('hci-lightfield')}"


def _inverted(values: Any, *, black_is_near: bool) -> Iterator[str]:
    """A hint if relative depth is nearer at the top of the picture than at its bottom."""
    height = values.shape[0]
    strips = slice(0, -(-height // _STRIPS)), slice(height - -(-height // _STRIPS), height)
    above, below = (float(np.median(values[rows])) for rows in strips)
    ends = [end for rows in bands(values.shape) for end in _ends_of(values[rows])]
    if (below - above if black_is_near else above - below) > _MOST * (max(ends) - min(ends)) > 0:
        near = "white" if black_is_near else "black"
        remedy = "leave ‹invert› out" if black_is_near else "say ‹invert›"
        yield f"the top of the picture is nearer than its bottom: if {near} is near, {remedy}"


def _ends_of(band: NDArray[Any]) -> list[float]:
    finite = band[np.isfinite(band)]
    return [float(end) for end in (finite.min(), finite.max())] if finite.size else []


def _share(samples: DepthNumbers, number: int) -> float:
    values = samples.values
    count = sum(int((values[rows] == number).sum()) for rows in bands(values.shape))
    return count / float(values.shape[0] * values.shape[1])


def _rows_of(file_type: str) -> list[Any]:
    return [row for row in ROWS if file_type in row.files and not row.bits]


def _say(*names: str) -> str:
    """Formats that fit, and the option that names one."""
    listed = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"
    return f"{listed}; say ‹depth-format› {names[0] if len(names) == 1 else 'NAME'}"

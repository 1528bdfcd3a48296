"""Evidence for people to judge: of the format of a depth file that nobody has named.

Numbers, names and files beside it name the formats that a file could be of. That changes nothing in
what is read, and only strong evidence is told.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from defocus_core.errors import DefocusError
from defocus_core.io.arrays import bands
from defocus_core.io.depth_formats.depth import read_numbers
from defocus_core.io.depth_formats.reading import DepthNumbers, DepthReading, holds_gdepth
from defocus_core.io.depth_formats.table import FLOATS, ROWS
from defocus_core.io.images.describe import FileInfo
from defocus_core.io.safe_files import is_heic, read_head
from defocus_core.system.text import percent

_TOP = 65535
_GROWS = 2.0  # how many times greater numbers are below
_SEVERAL = 0.001  # share of pixels
# Names of channels and arrays that only one format has.
_TELLING_NAMES = {
    "unreal-mrq": ("FinalImage*WorldDepth*", "ImageDepth*"),
    "coc": ("coc",),
    "houdini": ("Pz", "*.Pz"),
    "hypersim": ("dataset",),
    "nyu-mat": ("rawDepths",),
    "vision-blender": ("depth_map",),
}
_BESIDE = {
    "middlebury": ("PFM", "calib.txt"),
    "diode": ("NPY", "{stem}_mask.npy"),
    "moge": ("EXR", "fov.json"),
}


def evidence_of(path: Path, reading: DepthReading, info: FileInfo) -> tuple[str, ...]:
    """Sentences on the formats that a depth file could be of."""
    sentences = [] if reading.depth_format is not None else [*_names_evidence(path, info)]
    if holds_gdepth(path):
        return tuple(sentences)
    try:
        scaled = reading if reading.says_scale else replace(reading, depth_scale=1.0)
        samples = read_numbers(path, scaled, None)
    except DefocusError:  # another line of the report says why
        return tuple(sentences)
    if reading.depth_format is None:
        sentences += _numbers_evidence(samples, reading)
    return tuple(sentences)


def _names_evidence(path: Path, info: FileInfo) -> Iterator[str]:
    """Evidence of the names of channels, and of files beside the depth file."""
    names = [name.split(" ")[0] for name in info.names]
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


def _numbers_evidence(samples: DepthNumbers, reading: DepthReading) -> Iterator[str]:
    """Evidence of the numbers of a file without a named format."""
    if samples.is_of_nuke:
        yield f"Nuke wrote it, whose ScanlineRender writes 1/z: {_say('nuke-scanline')}"
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
    if samples.type in FLOATS and not reading.says_scale and _grows_downwards(samples):
        yield (
            "greater numbers below than above, as disparity has: of a network say ‹depth-format› "
            "depth-anything ‹depth-range› NEAR FAR, or ‹blur› 20px ‹focus-at› X,Y"
        )
    if samples.type == "8-bit PNG" and not reading.says_scale:
        yield (
            "8 bits: relative depth of a network; say ‹blur› 20px ‹focus-at› X,Y if bright is near "
            "(‹invert› if not), or in metres ‹depth-range› NEAR FAR, and ‹depth-kind› disparity if "
            "bright is near, or depth if bright is far"
        )


def _grows_downwards(samples: DepthNumbers) -> bool:
    """Whether the lower third has clearly greater numbers than the upper: the ground is near."""
    values, height = samples.values, samples.values.shape[0]
    if samples.marks or height < 3:
        return False
    above, below = (
        np.asarray(values[rows], np.float64)
        for rows in (slice(height // 3), slice(-(height // 3), None))
    )
    usable = all(np.isfinite(each).all() and each.min() >= 0 for each in (above, below))
    return usable and float(np.median(below)) > _GROWS * float(np.median(above)) + 1e-9


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

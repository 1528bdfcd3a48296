"""Evidence, for people, of the format of a depth file whose format was not given.

Evidence does not change how the file is read; only strong evidence is shown.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from defocus_core.errors import DefocusError
from defocus_core.io.depth_formats.depth import read_numbers
from defocus_core.io.depth_formats.reading import DepthNumbers, DepthReading, holds_gdepth
from defocus_core.io.depth_formats.table import FLOATS
from defocus_core.io.images.describe import FileInfo
from defocus_core.io.safe_files import is_heic, read_head

_GROWS = 2.0  # ratio of the numbers in the lower third to those in the upper
# Names of channels and arrays that only one format has.
_TELLING_NAMES = {
    "unreal-mrq": ("FinalImage*WorldDepth*", "ImageDepth*"),
    "coc": ("coc",),
    "houdini": ("Pz", "*.Pz"),
    "hypersim": ("dataset",),
    "nyu-mat": ("rawDepths",),
    "vision-blender": ("depth_map",),
}


def evidence_of(path: Path, reading: DepthReading, info: FileInfo) -> Iterator[str]:
    """Sentences on the formats that a depth file could have."""
    if reading.depth_format is not None:
        return
    names = [name.split(" ")[0] for name in info.names]
    for name, patterns in _TELLING_NAMES.items():
        hits = [n for n in names if any(fnmatchcase(n, pattern) for pattern in patterns)]
        if hits:
            yield f"{hits[-1]}: {name}; say ‹depth-format› {name}"
    if holds_gdepth(path):
        yield "GDepth in its XMP: android-gdepth; say ‹depth-format› android-gdepth"
    elif is_heic(read_head(path)):
        yield "a depth image beside the picture: apple-heic; say ‹depth-format› apple-heic"
    elif (samples := _numbers(path, reading)) is None:
        return
    elif samples.is_of_nuke:
        yield "Nuke wrote it, whose ScanlineRender writes 1/z; say ‹depth-format› nuke-scanline"
    elif samples.type in FLOATS and not reading.says_scale and _grows_downwards(samples):
        yield (
            "greater numbers below than above, as disparity has: of a network say ‹depth-format› "
            "depth-anything ‹depth-range› NEAR FAR, or ‹blur› 20px ‹focus-at› X,Y"
        )


def _numbers(path: Path, reading: DepthReading) -> DepthNumbers | None:
    """The numbers of a depth file; None if another line of the report tells why it has none."""
    with suppress(DefocusError):
        return read_numbers(path, replace(reading, depth_scale=1.0), None)
    return None


def _grows_downwards(samples: DepthNumbers) -> bool:
    """Whether the lower third has clearly greater numbers than the upper: the ground is near."""
    values, height = samples.values, samples.values.shape[0]
    if samples.marks or height < 3:
        return False
    with np.errstate(invalid="ignore"):  # a signalling NaN warns
        above, below = (
            np.asarray(values[rows], np.float64)
            for rows in (slice(height // 3), slice(-(height // 3), None))
        )
    usable = all(np.isfinite(each).all() and each.min() >= 0 for each in (above, below))
    return usable and float(np.median(below)) > _GROWS * float(np.median(above)) + 1e-9

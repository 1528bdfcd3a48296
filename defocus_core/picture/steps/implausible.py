"""Warnings where a depth map, as it was understood, does not fit the lens or the files beside it.

A wrong unit, a swapped near and far, or a disparity taken for a distance render without an error;
what gives them away is a picture that nobody would take. Only strong evidence is told: at most one
warning of the radii, the strongest, and one of the file.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from defocus_core.io.arrays import bands
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.picture.radii import MM_PER_M
from defocus_core.picture.take import Take
from defocus_core.request.lens import Lens
from defocus_core.request.quantities import length_text
from defocus_core.system.text import counted

# Where the sharpest pixel is blurred by more than both, nothing in the picture is in focus.
SHARP_PX = 2.0  # CoC radius
SHARP_SHARE = 0.25  # of the greatest CoC radius
_UNREAL = ("worlddepth", "scenedepth", "imagedepth")  # channels that Unreal writes, in centimetres
_HYPERSIM = "dataset"  # array of its HDF5 files


def radii(take: Take) -> Take:
    """The take with warnings of its depth."""
    declared, depth, own = take.job.reading.says_scale, take.inputs.depth, take.radii
    words = of_radii(depth, own.px, own.limits, take.lens, declared=declared)
    return replace(take, warnings=(*take.warnings, *words, *of_file(depth, declared=declared)))


def of_radii(
    depth: Depth, radius: Any, limits: tuple[float, float], lens: Lens, *, declared: bool
) -> Iterator[str]:
    """The strongest evidence of the signed radii [H, W] px, if there is any."""
    greatest = max(abs(end) for end in limits)
    if depth.is_relative and lens.focus_value is not None:
        number, ends = lens.focus_value, depth.ends
        unsharp = _least_blur(radius, greatest)
        if ends and (unsharp or not ends[0] <= number <= ends[1]):
            numbers = f"numbers go from {ends[0]:.6g} to {ends[1]:.6g}"
            nothing = f"nothing is in focus at the number {number:g}: {numbers}"
            yield f"{', '.join(filter(None, (nothing, unsharp)))}; check ‹focus-value›"
        return
    if lens.foc_dist is None:
        return
    height, width = depth.metres.shape
    remedy = f"check {'the declared format or unit' if declared else '‹depth-unit›'} and ‹focus›"
    near = (depth.metres[rows] * MM_PER_M < lens.foclen for rows in bands(depth.metres.shape))
    nearer = sum(int(np.count_nonzero(band)) for band in near)
    if nearer:
        where = f"nearer than the focal length {length_text(lens.foclen)}"
        yield f"depth is {where} in {counted(nearer, 'pixel')}; {remedy}"
    elif 2 * greatest > max(width, height):
        blur = f"a blur {2 * greatest:.3g} px wide, wider than the picture"
        yield f"depth goes {_range_text(depth)}, which gives {blur}; {remedy}"
    elif unsharp := _least_blur(radius, greatest):
        nothing = f"nothing is in focus at {length_text(lens.foc_dist)}"
        yield f"{nothing}: depth goes {_range_text(depth)}, {unsharp}; {remedy}"


def _least_blur(radius: Any, greatest: float) -> str:
    """The blur of the sharpest pixel, in words, where nothing is in focus; empty elsewhere."""
    if greatest <= SHARP_PX:
        return ""
    sharpest = min(float(np.abs(radius[rows]).min()) for rows in bands(radius.shape))
    is_sharp = sharpest <= max(SHARP_PX, SHARP_SHARE * greatest)
    return "" if is_sharp else f"the sharpest pixel has a CoC radius of {sharpest:.3g} px"


def _range_text(depth: Depth) -> str:
    """The range of the depth that is not sky, like ``from 2m to 40m``."""
    nearest, farthest = math.inf, 0.0
    for rows in bands(depth.metres.shape):
        metres = depth.metres[rows]
        nearest = min(nearest, float(metres.min()))
        farthest = max(farthest, float(np.where(np.isinf(metres), 0, metres).max()))
    if math.isinf(nearest):
        return "nowhere but to the sky"
    near, far = (length_text(float(f"{x * MM_PER_M:.3g}")) for x in (nearest, farthest))
    return f"from {near} to {far}"


def of_file(depth: Depth, *, declared: bool) -> Iterator[str]:
    """Evidence of the file's name, channel and neighbours, of a convention nobody declared."""
    if declared:
        return
    path, channel = depth.path, depth.channel.lower()
    if path.suffix.lower() == ".pfm" and (path.parent / "calib.txt").is_file():
        problem = "calib.txt beside it tells of disparity, but depth is taken as metres"
        yield f"{path}: {problem}; say ‹depth-format› middlebury, or metres"
    if any(word in channel for word in _UNREAL):
        problem = f"channel {depth.channel} is one that Unreal writes in centimetres"
        yield f"{path}: {problem}, but depth is taken as metres; say ‹depth-format› unreal-mrq"
    if "mist" in channel:
        problem = f"channel {depth.channel} is a fog of 0 to 1 by distance, and no depth"
        yield f"{path}: {problem}; render the pass Z, and say ‹depth-channel›"
    if "vrayzdepth" in channel and (depth.ends or (0.0, 2.0))[1] <= 1:
        problem = f"channel {depth.channel} lies within 0 and 1, as V-Ray maps black to white"
        yield f"{path}: {problem}; say ‹depth-format› vray-zdepth with its ‹depth-range›"
    if channel == _HYPERSIM and path.suffix.lower() in (".hdf5", ".h5"):
        problem = "array dataset is that of Hypersim, whose numbers are distances to the point"
        yield f"{path}: {problem}; say ‹depth-format› hypersim, or metres"

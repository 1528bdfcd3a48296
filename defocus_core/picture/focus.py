"""Find the focus of a lens in the depth of its picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from defocus_core.errors import InputError, UsageProblem
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.picture.radii import MM_PER_M, sharp_numbers
from defocus_core.picture.take import Take
from defocus_core.request.lens import LensValues
from defocus_core.request.quantities import Percentile, SideShare, length_text
from defocus_core.request.resolver import refuse_near_focus


def with_focus(lens: LensValues, depth: Depth) -> LensValues:
    """The lens with its focus distance in mm set from the depth at ``focus_at`` or at a percentile.

    With a blur in px, ``focus_value`` is set instead, to the depth number at ``focus_at``.
    """
    lens = in_pixels(lens, depth)
    if lens.blur is not None:
        if lens.focus_at is None:
            return lens
        place = _place_of(lens, lens.focus_at, depth)  # of relative disparity
        return replace(lens, focus_value=float(depth.metres[place][0, 0]))
    if lens.focus_at is not None:
        place, (x, y) = _place_of(lens, lens.focus_at, depth), lens.focus_at
        foc_dist = float(depth.metres[place][0, 0]) * MM_PER_M
        option = lens.focus_source.with_field("focus-at")
        refuse_near_focus(foc_dist, lens.foclen, option, f"{depth.path} at {x},{y}: ")
        return replace(lens, foc_dist=foc_dist)
    if lens.focus_percentile is not None:
        return replace(lens, foc_dist=_at_percentile(lens, depth))
    return lens


def in_pixels(lens: LensValues, depth: Depth) -> LensValues:
    """The lens with its blur in px; a share like ``2%`` is of the longer side of the picture."""
    if not isinstance(lens.blur, SideShare):
        return lens
    return replace(lens, blur=lens.blur.percent / 100 * max(depth.size))


def with_blur_reach(lens: LensValues, depths: Sequence[Depth]) -> LensValues:
    """Set ``blur_reach``, the greatest difference of depth numbers from those in focus.

    Pixels at this difference get the radius ``blur``. `depths` are all depth maps of the scene. A
    lens without ``blur`` is unchanged.
    """
    if lens.blur is None or lens.focus_value is None:
        return lens
    low, high = sharp_numbers(lens)
    ends = [end for depth in depths for end in depth.ends or ()]
    reach = max((max(low - end, end - high, 0.0) for end in ends), default=0.0)
    if not reach and any(depth.ends for depth in depths):
        problem = f"has the number {lens.focus_value:g} everywhere, which is in focus"
        remedy = "give the depth of the picture, or another ‹focus-value›"
        raise InputError("no-valid-depth", problem, remedy, path=depths[0].path)
    return replace(lens, blur_reach=reach or 1.0)


def _place_of(lens: LensValues, pixel: tuple[int, int], depth: Depth) -> tuple[slice, slice]:
    """Index (rows, columns) of a pixel in arrays with overscan; refuses outer and empty pixels."""
    (x, y), (width, height) = pixel, depth.size
    option = lens.focus_source.with_field("focus-at")
    if not (0 <= x < width and 0 <= y < height):
        problem = f"{x},{y} lies outside {depth.path} of {width}x{height} px"
        remedy = f"give X from 0 to {width - 1} and Y from 0 to {height - 1}"
        raise UsageProblem("out-of-range", problem, remedy, path=option)
    row, column = y + depth.overscan.top, x + depth.overscan.left
    place = slice(row, row + 1), slice(column, column + 1)
    if depth.empty is not None and depth.empty[place].any():
        problem = f"{x},{y} has an alpha of 0 in {depth.path}, and nothing to focus on"
        raise UsageProblem("no-valid-depth", problem, "give a pixel of the element", path=option)
    return place


def _at_percentile(lens: LensValues, depth: Depth) -> float:
    """The depth in mm at the percentile ``focus_percentile``; sky and empty pixels do not count.

    It is the depth of a pixel, not interpolated.
    """
    from defocus_core.optics.distributions import percentile_rank

    assert lens.focus_percentile is not None
    solid = depth.metres[np.isfinite(depth.metres) & (depth.metres > 0)]
    if not solid.size:
        remedy = "give the focus as a distance"
        what = "is all sky" if depth.empty is None else "is sky or has an alpha of 0 everywhere"
        problem = f"{what}, with nothing to focus on"
        raise InputError("no-valid-depth", problem, remedy, path=depth.path)
    rank = percentile_rank(lens.focus_percentile, solid.size)
    foc_dist = float(np.partition(solid, rank - 1)[rank - 1]) * MM_PER_M
    if foc_dist <= lens.foclen:
        where, far = Percentile(lens.focus_percentile), length_text(lens.foclen)
        problem = f"has {length_text(foc_dist)} at {where}, not beyond the focal length {far}"
        raise InputError("focus-too-near", problem, "focus farther away", path=depth.path)
    return foc_dist


def find_focus(take: Take) -> Take:
    """Set the focus of the lens from the depth of the picture."""
    inputs, found = take.inputs, take.lens
    if found is take.job.lens:
        found = with_focus(found, inputs.depth)
    below = () if inputs.plate is None else (inputs.plate.depth,)
    of_layers = () if inputs.layers is None else inputs.layers.depths
    return replace(take, lens=with_blur_reach(found, (inputs.depth, *below, *of_layers)))

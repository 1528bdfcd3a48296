"""Ramps of depth at soft edges, and the steps that take their place.

Where the radius changes by more than a pixel or so per pixel, the depth map has smoothed an edge: a
lens would not show a surface so steep, and some pixels of the ramp would be sharp. From each pixel
the paths of steepest descent and ascent lead to both ends of the ramp; the pixel gets the radius of
the end that is closer in radius.

Radii are affine in disparity. An edge that a network of metric depth softened in distance is
asymmetric in radius: steep on its near side, as if a hard edge stood there, and flat on its far
side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.neighbourhoods import (
    exceeding,
    extreme_around,
    flat_nonzero,
    halfway,
    positions_of,
    squares_around,
    steps_beside,
)
from defocus_core.tensors.ties import off_round
from defocus_core.tensors.validation import Scalar

# Slope in px per px, on both sides of a pixel, from which on it is on a ramp in any frame.
STEEP = off_round(1.5)
# No surface spans all radii of a frame within this many px, or within this share of the frame's
# shorter side; and the least slope of a soft edge, in px per px.
WITHIN, WITHIN_FRACTION, MINIMUM = 60, 1 / 4, off_round(0.15)
# Least step of a hard edge, as a multiple of the slope of soft edges; share of a step below which
# slopes beside it, and other steps within 8 px, count as level.
HARD_STEP, LEVEL = off_round(2.0), off_round(0.25)
# Foot of a ramp: the pixels within so many px of a steep one that have this share of its slope.
_FOOT_PX, FOOT_FRACTION = 10, off_round(0.3)
# Longest path to an end of a ramp, in px, unless the width of edges is known; difference of radii
# in px up to which two steps count as equally steep.
_LONGEST, _AS_STEEP = 16, 2.0**-10
# Distance in px up to which a pixel whose path does not leave the ramp takes the ends of others.
_BETWEEN_PATHS = 4
# Longer side in px of the reduced picture in which wide ramps are looked for; least shorter side
# in px of any reduced picture.
_REDUCED, LEAST_SIDE = 640, 32
# Width in px of an edge of averages: depth that was filtered like colours, or resized.
AVERAGED = 3


def longest_ramp(edge_width: float | None) -> int:
    """The length in px of the longest ramp that is an edge; `edge_width` in px, None if unknown."""
    return _LONGEST if edge_width is None else max(1, math.ceil(edge_width))


def around_ramps(edge_width: float | None) -> int:
    """Distance in px up to which other pixels affect the result of `without_ramps` at a pixel."""
    longest = longest_ramp(edge_width)
    return longest + max(_FOOT_PX, longest // 2) + 4


def without_ramps(
    signed_radius: Tensor,  # [H, W] px
    steep: float = STEEP,  # least slope of a ramp in px per px
    edge_width: float | None = None,
    scale: DistanceScale | None = None,
) -> Tensor:
    """Radii [H, W] px in which ramps are replaced by steps.

    Hard edges and slopes of up to `steep` px per px stay, and so do slopes wider than edges are.
    With a scale of distance, far slopes are steep, too, but stay if their radii change slowly.

    `edge_width`: width of the widest edges in px, None for 16 px; `scale`: the scale of distance,
    if the ramps are linear in distance; None if they are linear in disparity.
    """
    found = _ends_of_ramps(signed_radius, steep, edge_width, scale)
    if found is None:
        return signed_radius
    index, near, far = found
    radii = signed_radius.flatten()
    values = radii.detach() if scale is None else scale.distances(radii.detach())
    source = torch.where(values[index] < halfway(values[near], values[far]), near, far)
    return radii.index_copy(0, index, radii[source]).reshape(signed_radius.shape)


def _ends_of_ramps(
    signed_radius: Tensor, steep: float, edge_width: float | None, scale: DistanceScale | None
) -> tuple[Tensor, Tensor, Tensor] | None:
    """Flat indices [n] of pixels on ramps that are edges, and of the near and far ends of these.

    Arguments as for `without_ramps`; None if there is no ramp.
    """
    longest = longest_ramp(edge_width)
    foot_of = max(_FOOT_PX, longest // 2)
    values = signed_radius.detach() if scale is None else scale.distances(signed_radius.detach())
    slope = steepness(values)
    core = torch.where(exceeding(slope, steep), slope, 0.0)
    if not bool(core.any()):
        return None
    greatest = extreme_around(core, foot_of, torch.maximum)
    ramp = slope > FOOT_FRACTION * greatest
    if scale is not None:  # a level of distance is many px of radius near the lens
        ramp |= steepness(signed_radius) > FOOT_FRACTION * steep
    foot, ramp = ramp, core > 0
    for _ in range(foot_of):  # a foot that is not connected to the ramp is another surface
        ramp |= extreme_around(ramp, 1, torch.maximum) & foot
    # without it, the pixel beyond the foot would keep its radius and make a new step
    ramp |= extreme_around(ramp, 1, torch.maximum) & (slope > FOOT_FRACTION / 3 * greatest)
    at, (H, W) = positions_of(ramp), signed_radius.shape
    index = at[:, 0] * W + at[:, 1]
    radii, around = signed_radius.detach().flatten(), squares_around(at, (H, W)).flatten(1)
    flat = values.flatten()
    lowest = extreme_around(values, 1, torch.minimum).flatten()
    near = _least_beside(flat, ramp, _path_end(flat, lowest, around, index, longest))
    if edge_width is None:  # beyond a far end another surface may lie
        far = _path_end(-flat, -flat, around, index, longest)
    else:
        highest = extreme_around(values, 1, torch.maximum).flatten()
        far = _least_beside(-flat, ramp, _path_end(-flat, -highest, around, index, longest))
    found = ~(ramp.flatten()[near] | ramp.flatten()[far])
    near, far = _ends_beside(flat, around, index, torch.where(found, torch.stack([near, far]), -1))
    found = (flat[near] <= flat[index]) & (flat[index] <= flat[far]) & (near != far)
    if scale is not None:
        along = torch.hypot(*(((near - far) // W).double(), (near % W - far % W).double()))
        found &= radii[far] - radii[near] > FOOT_FRACTION * steep * along
    kept = flat_nonzero(found)
    return index[kept], near[kept], far[kept]


def without_wide_ramps(signed_radius: Tensor, steep: float, scale: DistanceScale | None) -> Tensor:
    """Radii [H, W] px in which the ramps that show in the reduced picture are replaced by steps.

    A network sees a small picture, and its depth is enlarged: a ramp over the same share of a
    picture becomes a step at any resolution.
    """
    (H, W), by = signed_radius.shape, reduction(signed_radius.shape)
    coarse = reduced(signed_radius, by)
    ends = torch.full((2, coarse.numel()), torch.inf, dtype=coarse.dtype, device=coarse.device)
    small = None if scale is None else scale.times(1 / by)
    found = _ends_of_ramps(coarse / by, steep, None, small)
    if found is not None:
        flat = coarse.flatten()
        ends[:, found[0]] = torch.stack([flat[found[1]], -flat[found[2]]])
    # a ramp may extend by less than a reduced pixel beyond those found
    ends = extreme_around(ends.view(2, *coarse.shape), 1, torch.minimum)

    places = [
        (torch.arange(size, device=coarse.device) * small_size).div(size, rounding_mode="floor")
        for size, small_size in zip((H, W), coarse.shape, strict=True)
    ]
    near, far = ends[:, places[0]][:, :, places[1]]
    far, own = -far, signed_radius.detach()
    closer = torch.where(own < halfway(near, far), near, far)
    return torch.where((near < own) & (own < far), closer, signed_radius)


def reduction(size: Sequence[int]) -> int:
    """The factor, 1 or more, by which a picture (height, width) is reduced to find wide ramps."""
    return max(1, min(max(size) // _REDUCED, min(size) // LEAST_SIDE))


def reduced(signed_radius: Tensor, by: int) -> Tensor:
    """Every `by`-th row and column of radii [H, W] px, symmetric about the picture's middle."""
    first = [(size - 1) % by // 2 for size in signed_radius.shape]
    return signed_radius[first[0] :: by, first[1] :: by].detach()


def _path_end(values: Tensor, lows: Tensor, around: Tensor, index: Tensor, longest: int) -> Tensor:
    """Flat indices [n] of the pixels where the paths of steepest descent from n pixels end.

    Of equally steep neighbours the one whose path ends lower is taken, so that rounding decides
    nothing. A path ends at a pixel that is not in `index`.

    `values`: [H * W]; `lows`: [H * W], the values by which ends are compared; `around`: [n, 9] flat
    indices of the 3×3 pixels around each pixel; `index`: [n] flat indices of the pixels; `longest`:
    greatest length of a path in px.
    """
    beside = values[around]
    steepest = beside <= beside.amin(1, keepdim=True) + _AS_STEEP
    end = torch.arange(len(values), device=values.device)
    for _ in range(longest):
        limits = end[around]
        lowest = torch.where(steepest, lows[limits], torch.inf).argmin(1, keepdim=True)
        end.index_copy_(0, index, limits.gather(1, lowest)[:, 0])
    return end[index]


def _ends_beside(values: Tensor, around: Tensor, index: Tensor, ends: Tensor) -> Tensor:
    """The ends [2, n] of ramps, with missing ones, -1, taken from neighbouring paths.

    A pixel takes the outermost ends of the paths up to 4 px away; if there are none, it is its own
    end. Arguments are as for `_path_end`.
    """
    missing = ends[0] < 0
    of_pixel = torch.arange(len(values), device=values.device).repeat(2, 1)
    is_known = torch.zeros_like(values, dtype=torch.bool)
    of_pixel[:, index[~missing]], is_known[index[~missing]] = ends[:, ~missing], True
    rest, beside = index[missing], around[missing]
    for _ in range(_BETWEEN_PATHS):
        known = is_known[beside]
        for end, sign in ((of_pixel[0], 1), (of_pixel[1], -1)):
            of_beside = end[beside]
            outermost = torch.where(known, sign * values[of_beside], torch.inf).argmin(1)
            end[rest] = of_beside.gather(1, outermost[:, None])[:, 0]
        is_known[rest] |= known.any(1)
    return of_pixel[:, index]


def _least_beside(values: Tensor, ramp: Tensor, at: Tensor) -> Tensor:
    """Flat indices [n] of the lowest pixels next to the ends `at` [n] of paths.

    They differ from the ends where equal values stop a path too soon. Of equally low pixels, one
    that is not on a ramp [H, W] is preferred.
    """
    row = at.div(ramp.shape[1], rounding_mode="floor")
    size = ramp.shape[0], ramp.shape[1]
    beside = squares_around(torch.stack([row, at - row * size[1]], 1), size).flatten(1)
    around = values[beside] + _AS_STEEP * ramp.flatten()[beside]
    return beside.gather(1, around.argmin(1, keepdim=True))[:, 0]


def softness(slope: Tensor) -> Tensor:
    """The slope [H, W] at inner pixels of ramps that are several px wide and long; 0 elsewhere.

    `slope`: [H, W] px per px, of all ramps, from `steepness`.
    """
    return extreme_around(slope, 1, torch.minimum)


def slope_of_soft_edges(minimum: float, maximum: float, size: Sequence[int]) -> float:
    """The least slope in px per px of a soft edge in a frame.

    `minimum`, `maximum`: least and greatest radius of the frame in px; `size`: its (height, width).
    """
    within = min(WITHIN, WITHIN_FRACTION * min(size))
    return min(STEEP, max(MINIMUM, (maximum - minimum) / within))


def hard_steps(signed_radius: Tensor, steep: float, scale: DistanceScale | None = None) -> Tensor:
    """The number of hard edges: large steps from one pixel to the next between level surfaces.

    `signed_radius`: [H, W] px; `steep`: least slope of a soft edge in px per px; `scale`: the scale
    of distance, in which a step must then be large, too.
    """
    count = torch.zeros((), dtype=torch.long, device=signed_radius.device)
    for dim in (-1, -2):
        before, step, after = steps_beside(signed_radius, dim)
        high = step > HARD_STEP * steep
        if scale is not None:
            before, step, after = steps_beside(scale.distances(signed_radius), dim)
            high &= step > HARD_STEP * steep
        level = torch.maximum(before, after) < LEVEL * step
        count += (high & level).sum()
    return count


def steepness(signed_radius: Tensor) -> Tensor:
    """The slope of ramps at pixels [H, W] in px per px; 0 where there is no ramp.

    Along each axis it is the smaller of the slopes before and after the pixel if both rise or both
    fall, else 0, as beside a hard edge; the greater of both axes counts.
    """
    r = signed_radius.detach()
    slope = torch.zeros_like(r)
    for dim in (-1, -2):
        if r.shape[dim] > 2:
            step = r.diff(dim=dim)
            n = step.shape[dim] - 1
            first, second = step.narrow(dim, 0, n), step.narrow(dim, 1, n)
            inner = slope.narrow(dim, 1, n)
            for minimum in (torch.minimum(first, second), -torch.maximum(first, second)):
                torch.maximum(inner, minimum, out=inner)
    return slope


# Radii within this many px of the radius at infinity count as infinitely far.
INFINITE = 2.0**-12


class DistanceScale(NamedTuple):
    """A conversion of radii to distances in px, which span the same range as the frame's radii."""

    infinity: float  # signed radius in px at infinity
    nearest: float  # px of radius between infinity and the nearest surface of the frame
    farthest: float  # px of radius between infinity and the farthest surface of the frame

    def distances(self, radii: Tensor) -> Tensor:
        """Distances [H, W] in px of radii [H, W] px; 0 px for the nearest surface."""
        by_distance = self.nearest * self.farthest
        distance = distance_of(radii, self.infinity)
        return distance * by_distance - self.farthest

    def times(self, factor: float) -> DistanceScale:
        """The scale of the same distances if all radii are multiplied by a factor."""
        return DistanceScale(*(px * factor for px in self))

    def rescaled(self, scale: float, infinity: float) -> DistanceScale:
        """The scale of the same distances through another lens.

        `scale`: factor on the differences of radii; `infinity`: that lens's signed radius in px at
        infinity.
        """
        return DistanceScale(infinity, self.nearest * scale, self.farthest * scale)


def distance_scale(minimum: float, maximum: float, infinity: float | None) -> DistanceScale | None:
    """The scale of distance of a frame; None if its distances are unknown, infinite or all equal.

    `minimum`: least radius in px; `maximum`: greatest radius in px; `infinity`: signed radius in px
    at infinity; None if that is not known.
    """
    if infinity is None or not INFINITE < infinity - maximum < infinity - minimum:
        return None
    return DistanceScale(infinity, infinity - minimum, infinity - maximum)


def distance_of(radii: Tensor, infinity: Scalar) -> Tensor:
    """Distances of radii in px, up to a factor: 1 / (infinity - radius), in 1/px."""
    return (infinity - radii).clamp(min=INFINITE).reciprocal()


def radius_from_relative_disparity(
    disparity: Tensor, focus: float, max_radius: float, reach: float | None = None
) -> Tensor:
    """Signed radius of the circle of confusion from disparity of unknown scale and offset.

    The radius of a thin lens is linear in disparity: r = R (d_f − d) / max |d_f − d|.

    Args:
        disparity: d, any shape, greater nearer; of any scale, with any offset.
        focus: d_f, the disparity in focus.
        max_radius: R, radius in px of the most blurred pixel.
        reach: max |d_f − d|; None for that of `disparity`.

    Returns:
        Radii of the same shape in px, negative nearer than the focus; 0 where all are in focus.
    """
    apart = focus - disparity
    maximum = float(apart.detach().abs().amax()) if reach is None else reach
    return apart * (max_radius / maximum if maximum else 0.0) + 0.0  # and no -0.0

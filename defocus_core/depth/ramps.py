"""Ramps of depth at soft edges, and the steps that take their place.

Where the radius changes by more than a pixel or so per pixel, the depth map has smoothed an edge:
the lens would not see so steep a surface as one, and some of its pixels would be sharp. From each
pixel the paths of steepest descent and ascent lead to both ends of the ramp; it gets the radius of
the closer end.

Radii are affine in disparity. An edge that a network of metric depth softened in distance is
lopsided in radius: steep on its near side, as if a hard edge stood there, and flat on its far side.
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

# Least slope of a ramp in px per px, on both sides of a pixel, whatever else the frame shows.
STEEP = off_round(1.5)
# No surface goes through the range of radii of a frame within so many px, or within such a share of
# the frame's shorter side; and the least slope of a soft edge, in px per px.
WITHIN, WITHIN_FRACTION, MINIMUM = 60, 1 / 4, off_round(0.15)
# Least step of a hard edge, as a multiple of this slope; the greatest slope beside it, and the
# least step within 8 px of it that is no foot of a ramp, as a share of the step.
HARD_STEP, LEVEL = off_round(2.0), off_round(0.25)
# Foot of a ramp: the pixels within so many px of a steep one that have this share of its slope.
_FOOT_PX, FOOT_FRACTION = 10, off_round(0.3)
# Longest path to an end of a ramp, in px, unless the width of edges is known; difference of radii
# in px by which steps are as steep.
_LONGEST, _AS_STEEP = 16, 2.0**-10
# Px from which a pixel whose path does not leave the ramp takes the ends of other paths.
_BETWEEN_PATHS = 4
# Longer side in px of a picture in which wide ramps are looked for; least shorter one of any level.
_REDUCED, LEAST_SIDE = 640, 32
# Width in px of an edge of averages: depth that was filtered like colours, or resized.
AVERAGED = 3


def longest_ramp(edge_width: float | None) -> int:
    """Px of the longest ramp that is an edge, given the width of edges if it is known."""
    return _LONGEST if edge_width is None else max(1, math.ceil(edge_width))


def around_ramps(edge_width: float | None) -> int:
    """Distance in px up to which pixels change the result of `without_ramps` at a pixel."""
    longest = longest_ramp(edge_width)
    return longest + max(_FOOT_PX, longest // 2) + 4


def without_ramps(
    signed_radius: Tensor,  # [H, W] px
    steep: float = STEEP,  # least slope of a ramp in px per px
    edge_width: float | None = None,
    scale: DistanceScale | None = None,
) -> Tensor:
    """Radii [H, W] px with steps in the place of ramps.

    Hard edges and slopes of up to `steep` px per px stay, and so do slopes wider than edges are.
    In distance, far slopes are steep, too; far slopes stay if their radii change slowly.

    `edge_width`: width of the widest edges in px; None if it is not known, for 16 px; `scale`: of
    distance, if ramps are ramps of distance; None if they are of disparity.
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
    for _ in range(foot_of):  # what lies beside it without a link is another surface
        ramp |= extreme_around(ramp, 1, torch.maximum) & foot
    # left as it is, the pixel beyond the foot would stand beside a step that there was not
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
    """Radii [H, W] px with steps in the place of the ramps that a reduced picture shows.

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
    # beside the pixels of a ramp it ends between two pixels of the reduced picture
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
    """The ratio of the size of a picture (height, width) to one in which all ramps are examined."""
    return max(1, min(max(size) // _REDUCED, min(size) // LEAST_SIDE))


def reduced(signed_radius: Tensor, by: int) -> Tensor:
    """Radii [H, W] px sampled at a regular step, symmetric about the middle of the picture."""
    first = [(size - 1) % by // 2 for size in signed_radius.shape]
    return signed_radius[first[0] :: by, first[1] :: by].detach()


def _path_end(values: Tensor, lows: Tensor, around: Tensor, index: Tensor, longest: int) -> Tensor:
    """The pixels [n] at the lower ends of the paths of steepest descent from n pixels.

    Of equally steep neighbours the one with the lower end is taken, so that rounding decides
    nothing. A path ends at a pixel that is not in `index`.

    `values`: [H * W]; `lows`: the least value around each, by which ends are lower; `around`:
    [n, 9] numbers of the pixels and of their neighbours; `index`: [n] numbers of the pixels;
    `longest`: most px of a path.
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
    """The ends [2, n] of ramps, those of -1 replaced by the outermost ends of the paths beside.

    A pixel without ends, beside no path with ends, is its own end. Arguments as for `_path_end`.
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
    """The lowest pixels [n] around the ends [n] of paths, as levels may end a path too soon.

    Of equally low pixels, one that is on no ramp [H, W] is taken.
    """
    row = at.div(ramp.shape[1], rounding_mode="floor")
    size = ramp.shape[0], ramp.shape[1]
    beside = squares_around(torch.stack([row, at - row * size[1]], 1), size).flatten(1)
    around = values[beside] + _AS_STEEP * ramp.flatten()[beside]
    return beside.gather(1, around.argmin(1, keepdim=True))[:, 0]


def softness(slope: Tensor) -> Tensor:
    """The slope [H, W] in the middle of ramps that are several px wide and long; 0 elsewhere.

    `slope`: [H, W] px per px, of all ramps, from `steepness`.
    """
    return extreme_around(slope, 1, torch.minimum)


def slope_of_soft_edges(minimum: float, maximum: float, size: Sequence[int]) -> float:
    """The least slope in px per px of a soft edge in a frame with radii from least to most px.

    `minimum`: least radius in px; `maximum`: greatest radius in px; `size`: (height, width) of the
    frame.
    """
    within = min(WITHIN, WITHIN_FRACTION * min(size))
    return min(STEEP, max(MINIMUM, (maximum - minimum) / within))


def hard_steps(signed_radius: Tensor, steep: float, scale: DistanceScale | None = None) -> Tensor:
    """The number of steps of radii [H, W] px, from one pixel to the next, that are hard edges.

    `signed_radius`: [H, W] px; `steep`: least slope of a soft edge in px per px.
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

    The lesser slope of both sides of a pixel, where both go up or both go down, along the steeper
    axis: 0 beside a hard edge.
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


# Radii less than this many px from the radius of infinity count as infinitely far.
INFINITE = 2.0**-12


class DistanceScale(NamedTuple):
    """The distances of a frame, as px that span the same range as its radii."""

    infinity: float  # signed radius in px at infinity
    nearest: float  # px of radius between infinity and the nearest surface of the frame
    farthest: float  # px of radius between infinity and the farthest surface of the frame

    def distances(self, radii: Tensor) -> Tensor:
        """Distances of radii [H, W] px; 0 px for the nearest surface."""
        by_distance = self.nearest * self.farthest
        distance = distance_of(radii, self.infinity)
        return distance * by_distance - self.farthest

    def times(self, factor: float) -> DistanceScale:
        """The scale of the same distances if all radii are multiplied by a factor."""
        return DistanceScale(*(px * factor for px in self))

    def rescaled(self, scale: float, infinity: float) -> DistanceScale:
        """The scale of the same distances for radii `scale` times as far from another infinity."""
        return DistanceScale(infinity, self.nearest * scale, self.farthest * scale)


def distance_scale(minimum: float, maximum: float, infinity: float | None) -> DistanceScale | None:
    """The scale of distance of a frame.

    `minimum`: least radius in px; `maximum`: greatest radius in px; `infinity`: signed radius in px
    at infinity; None if that is not known. Returns None if distance is not known,
    infinite somewhere, or the same everywhere.
    """
    if infinity is None or not INFINITE < infinity - maximum < infinity - minimum:
        return None
    return DistanceScale(infinity, infinity - minimum, infinity - maximum)


def distance_of(radii: Tensor, infinity: Scalar) -> Tensor:
    """Distances of radii in px: 1 / (infinity - radius), in 1/px."""
    return (infinity - radii).clamp(min=INFINITE).reciprocal()


def radius_from_relative_disparity(
    disparity: Tensor, focus: float, max_radius: float, reach: float | None = None
) -> Tensor:
    """Signed radius of the circle of confusion by disparity of unknown scale and offset.

    The radius of a thin lens is linear in disparity: r = R (d_f − d) / max |d_f − d|.

    Args:
        disparity: d, any shape, greater nearer; of any scale, with any offset.
        focus: d_f, what is in focus.
        max_radius: R, of the most blurred pixel, px.
        reach: max |d_f − d|; None for that of `disparity`.

    Returns:
        Radii of the same shape in px, negative nearer than the focus; 0 where all are in focus.
    """
    apart = focus - disparity
    maximum = float(apart.detach().abs().amax()) if reach is None else reach
    return apart * (max_radius / maximum if maximum else 0.0) + 0.0  # and no -0.0

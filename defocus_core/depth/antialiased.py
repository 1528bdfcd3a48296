"""Anti-aliased depth: how many pixels on edges are averages of both surfaces.

A depth map that was filtered like colours, or resized, holds depths at which there is no surface.
Averages are spread evenly over an edge, so the mean of their places tells which quantity was
averaged, distance or disparity.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from defocus_core.depth.distance_scale import distance_of
from defocus_core.tensors.source import Scalar
from defocus_core.tensors.sparse_masks import exceeding, flat_nonzero, sums_of_each

# Range of radius in px, within 3 px of each other, that matters.
_MATTERS = 1.013
# Px around an edge in which both surfaces are seen.
_BESIDE = 3
# The share that 3 px span on an edge; the place on an edge, from either end, from which
# a pixel is an average; and the greatest slope beside a hard step, as a share of the step.
_ABRUPT, _AVERAGE, _LEVEL = 0.5, 0.1, 0.1
# Least number of averages: at all, for each hard step, for each pixel on a wide edge, and for each
# pixel on a soft one.
_MINIMUM, _EACH, _WIDER, _SOFTER = 64, 2, 0.25, 2


def averages(
    band: Tensor, sizes: list[Tensor], rows: tuple[int, int], infinity: Scalar | None
) -> Tensor:
    """Counts of averages on edges along rows and columns, for each picture: [..., 2, 4].

    The first row of the result counts averages of disparity, the second averages of distance: the
    averages on narrow edges, the sum of their places on these edges from 0 to 1, the pixels on wide
    edges, and the hard steps.

    `band`: [..., h, W] px, the counted rows and the three rows of the frame above and below, of a
    picture or of each of a batch; `sizes`: of steps in px from each pixel to the next, down and
    across; `infinity`: signed radius in px of what is infinitely far, or [B] for each picture; None
    if that is not known.
    """
    counts = band.new_zeros((*band.shape[:-2], 2, 4), dtype=torch.float64)
    long = [dim for dim in (-2, -1) if band.shape[dim] > 2 * _BESIDE]
    ranges, inner = [], []
    for dim in long:
        n = band.shape[dim] - 2 * _BESIDE
        ranges.append((band.narrow(dim, 2 * _BESIDE, n) - band.narrow(dim, 0, n)).abs_())
        inner.append(sizes[dim].narrow(dim, 1, band.shape[dim] - 3))  # steps between two others
    if not long:
        return counts
    radii = _around(band, dict(zip(long, ranges, strict=True)), rows, _BESIDE, 2 * _BESIDE + 1)
    steps = _around(band, dict(zip(long, inner, strict=True)), rows, 1, 4)
    for quantity, limit in enumerate((math.inf, infinity)):
        if limit is not None:
            of_steps, of_radii = (
                _as_averaged(values, limit[of, None] if isinstance(limit, Tensor) else limit)
                for values, of in (steps, radii)
            )
            before, step, after = of_steps.diff(dim=1).abs().unbind(1)
            hard = torch.maximum(before, after) < _LEVEL * step
            position, average, wide = _on_edges(of_radii)
            each = torch.stack([average.to(position), position * average, wide.to(position)], 1)
            of_quantity = counts[..., quantity, :].view(-1, 4)
            of_quantity[:, :3] = sums_of_each(each, radii[1], len(of_quantity))
            of_quantity[:, 3:] = sums_of_each(hard[:, None], steps[1], len(of_quantity))
    return counts


def averaged_from(counts: list[list[float]], infinity: float | None, soft: int) -> float | None:
    """The quantity that was averaged on the edges of a frame.

    `counts`: [2, 4], the sum of `averages` over the frame; `infinity`: signed radius in px of what
    is infinitely far; None if that is not known; `soft`: number of pixels of the frame on edges
    that are several px wide. Returns `infinity` for distance, math.inf for disparity, None if edges
    are mostly hard or soft.
    """
    maximum, _, wide, _ = max(counts)
    if maximum <= max(_WIDER * wide, _MINIMUM, _SOFTER * soft):
        return None
    off_middle = [
        (abs(position / count - 0.5), limit)
        for (count, position, _, hard), limit in zip(counts, (math.inf, infinity), strict=True)
        if count > _EACH * hard
    ]
    return min(off_middle, key=lambda candidate: candidate[0])[1] if off_middle else None


def _as_averaged(radii: Tensor, infinity: Scalar) -> Tensor:
    """Radii as disparity, or as distance if the radius of infinity is finite, in any unit."""
    if not isinstance(infinity, Tensor) and math.isinf(infinity):
        return radii
    return distance_of(radii, infinity)


def _around(
    band: Tensor, ranges: dict[int, Tensor], rows: tuple[int, int], before: int, width: int
) -> tuple[Tensor, Tensor]:
    """The radii [m, width] along both axes around the pixels of a band whose range matters.

    `band`: [..., h, W] px; `ranges`: [..., h, W] px by axis, along it only of pixels that have so
    many around. Returns the radii, and the number [m] of the picture that each pixel is of.
    """
    (h, W), masks, begins = band.shape[-2:], [], []
    for dim, values in ranges.items():
        shift = before if dim == -2 else 0
        begins.append(max(rows[0] - shift, 0))
        own = values[..., begins[-1] : max(rows[1] - shift, begins[-1]), :]
        masks.append(exceeding(own, _MATTERS))
    every = torch.cat([mask.flatten(-2) for mask in masks], -1)
    number = flat_nonzero(every)
    of = number.div(every.shape[-1], rounding_mode="floor")
    number = number - of * every.shape[-1]
    start, stride, passed = torch.zeros_like(number), torch.ones_like(number), 0
    for dim, mask, begin in zip(ranges, masks, begins, strict=True):
        own = number - passed
        row = own.div(mask.shape[-1], rounding_mode="floor")
        at = own + row * (W - mask.shape[-1]) + begin * W
        start = torch.where(own >= 0, at, start)
        stride = torch.where(own >= 0, W if dim == -2 else 1, stride)
        passed += mask.shape[-2] * mask.shape[-1]
    start = start + of * (h * W)
    along = torch.arange(width, device=band.device) * stride[:, None]
    return band.contiguous().flatten()[start[:, None] + along], of


def _on_edges(values: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The places of the middle ones of 7 values [m, 7] on an edge.

    On an edge the values go up only or down only, and level off at an end.

    Returns [m] places from 0 to 1; [m] bool, on a narrow edge; [m] bool, on a wide edge.
    """
    close, near, all_seven = (
        torch.aminmax(values[:, _BESIDE - by : _BESIDE + by + 1], dim=1) for by in (1, 2, _BESIDE)
    )
    within, size, whole = (limits.max - limits.min for limits in (close, near, all_seven))
    position = (values[:, _BESIDE] - near.min) / torch.where(size > 0, size, 1.0)
    step, level = values.diff(dim=1), _LEVEL * whole
    minimum, maximum = torch.aminmax(step[:, 1:-1], dim=1)
    on_edge = (position > _AVERAGE) & (position < 1 - _AVERAGE)
    on_edge &= (minimum >= -level) | (maximum <= level)
    on_edge &= torch.minimum(step[:, 0].abs(), step[:, -1].abs()) < level
    abrupt = within > _ABRUPT * whole
    return position, on_edge & abrupt, on_edge & ~abrupt

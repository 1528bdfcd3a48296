"""Disocclusion: the regions behind depth edges that the aperture sees.

The aperture sees a far surface behind an edge as long as its radius, less the distance from the
edge, exceeds the radius of the near surface. The maximum of r_far - |q - far| over all edges (a
dilation by a cone) bounds the region. But the lens sees the next surface first: behind a wire in
front of a sign, it sees the sign, even where the cone of the sky beside the sign is higher. So the
closest edge is stored, too, and its surface is continued if it is the sharper one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import pieces
from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.pyramid import Axis, AxisHalving, halves, spread_out

# Edges of radius, in px per pixel, above which one surface hides another.
EDGE = 1.013
# Distance in px from which a colour from one side alone has no weight; and the one around a region
# from which hidden content is continued.
FARTHEST = 24
PX_AROUND = FARTHEST + 2
# How much farther, in px of radius, than the surface in front of it hidden content must be; no
# round number, so that rounding decides nothing.
STEP = 0.513
# Decay of the reach per px of |dx| + |dy|: 1 / √2 reaches as far on diagonals as it must.
DECAY = 0.70710678
# Where between the radii of the surface that is continued and of the farthest one the ceiling is.
CEILING = 0.497
# Cones are compared in grains of 1 / 16 px, or more where more than 2^13 of them make a radius.
_FINEST = -4
LEVELS = 13
BITS = 16
RADIUS = (1 << BITS) - 1
NOWHERE = -2 << LEVELS << BITS
# Rounding to grains is shifted by this share of a grain: many radii from half-precision depth lie
# in the middle between two grains.
BETWEEN = 0.013
# Radii of more px count as this one; no frame is as wide.
MAXIMUM = 4096.0
# Number of coarse pixels dilated at once on a CPU, and bytes that each takes elsewhere.
_PIXELS, _BYTES_EACH = 1 << 20, 8


class Revealed(NamedTuple):
    """The surface that may show behind each coarse pixel."""

    # [h, w] px, the surface shows behind surfaces with a smaller radius than this; below all radii
    # where no surface shows
    shown: Tensor
    source: Tensor  # [h, w] px, the radius of the edge from which the surface is continued
    # [h, w] px, the radius of the surface in front of that: the visible surface, or that of the
    # closest edge where this is more blurred and so not continued
    front: Tensor
    # [h, w] px, surfaces of this radius or more lie behind the continued one; infinite where the
    # continued one is the farthest
    ceiling: Tensor


class Reach(NamedTuple):
    """How far behind depth edges farther surfaces are seen, on coarse pixels of half resolution.

    Radii are integers, in units of `grain` px.
    """

    # [h, w], the greatest cone in the upper bits, and the radius of its edge in the lower ones
    farthest: Tensor
    closest: Tensor  # [h, w], the same with minus the px to the closest edge, and its radius
    grain: float  # px of one grain
    fine: tuple[Axis, Axis]  # where the middle of the frame is at full resolution

    def revealed(
        self, near: Tensor, coarse: Box, middle: tuple[Axis, Axis], level: int
    ) -> Revealed:
        """The surface that may show behind each coarse pixel.

        `near`: [height, width] px, radii of the surface in front; `coarse`: the box of the coarse
        pixels; `middle`: the middle of the frame, as an index of coarse pixels; `level`: 1 for half
        resolution, 0 for full resolution.
        """
        cone, far = self._read(self.farthest, coarse, middle, level)
        # two pixels of neighbouring coarse pixels may be a px apart, and not two
        cone = torch.minimum(cone + math.floor(DECAY / self.grain), far)
        shown, source = cone.to(near.dtype) * self.grain, far.to(near.dtype) * self.grain
        away, radius = self._read(self.closest, coarse, middle, level)
        spent, closest = -DECAY * away.to(near.dtype), radius.to(near.dtype) * self.grain
        comes_next = (closest - spent > near + STEP) & (source > closest + STEP)
        # a gap in the more blurred one of two surfaces is hardly seen
        sharper = closest.abs() <= source.abs()
        front = torch.where(comes_next & ~sharper, closest, near)
        comes_next = comes_next & sharper
        return Revealed(
            torch.where(comes_next, closest - spent, shown),
            torch.where(comes_next, closest, source),
            front,
            torch.where(comes_next, torch.lerp(closest, source, CEILING), torch.inf),
        )

    def _read(
        self, edges: Tensor, coarse: Box, middle: tuple[Axis, Axis], level: int
    ) -> tuple[Tensor, Tensor]:
        """The upper bits of `edges` (heights of cones, or distances) and the lower bits (radii).

        Both are given at each coarse pixel of the box `coarse`, as integers.
        """
        cuts = []
        for d, axis in enumerate(middle):
            fine, start, length = self.fine[d].middle, coarse[d] - axis.middle, coarse[d + 2]
            # the middle is an even number of pixels after the beginning of the first coarse pixel
            origin = (fine + fine % 2) // 2
            if level:
                first, last = start + origin, start + origin + length - 1
            else:
                start += 2 * origin
                first, last = start // 2, (start + length - 1 + axis.odd) // 2
                cuts.append(slice(start - 2 * first, start - 2 * first + length))
            edges = edges.narrow(d - 2, first, last + 1 - first)
        if not level:
            edges = spread_out(edges, (middle[0].odd, middle[1].odd))[..., cuts[0], cuts[1]]
        return edges >> BITS, (edges & RADIUS) - (1 << LEVELS)


def grain_of(minimum: float, maximum: float) -> float:
    """The grain in px, the unit of integer radii, for radii from `minimum` to `maximum` px."""
    largest = min(max(-minimum, maximum, 1.0), MAXIMUM)
    return 2.0 ** max(_FINEST, math.ceil(math.log2(largest)) - LEVELS)


def coarse_edges(r: Tensor, farther: Tensor, grain: float, middle: tuple[Axis, Axis]) -> Tensor:
    """The cones [h, w] int32 of the farther pixels at edges before dilation, at half resolution.

    `r`: radii [H, W] px; `farther`: flat indices of the farther pixels; `middle`: the middle of the
    frame.
    """
    grains = r.flatten()[farther].clamp(-MAXIMUM, MAXIMUM) / grain
    radii = (grains + BETWEEN).round().to(torch.int32)
    row = farther.div(r.shape[-1], rounding_mode="floor")
    column = farther - row * r.shape[-1]
    source = (radii << BITS) + (radii + (1 << LEVELS))
    down, across = (halves(n, axis) for n, axis in zip(r.shape, middle, strict=True))
    cone = source.new_full((down.length, across.length), NOWHERE)
    for coarse_row in _coarse_indices(row, down):
        for coarse_column in _coarse_indices(column, across):
            at = coarse_row * across.length + coarse_column
            cone.view(-1).scatter_reduce_(0, at, source, "amax")
    return cone


def reach_of(edges: Tensor, grain: float, span: float, fine: tuple[Axis, Axis]) -> Reach:
    """How far behind depth edges the surfaces beyond them are seen.

    `edges`: [h, w] of `coarse_edges`, overwritten; `grain`: in px; `span`: greatest difference
    between radii, in px; `fine`: the middle of the frame at full resolution.
    """
    closest = torch.where(edges == NOWHERE, NOWHERE, edges & RADIUS)
    return Reach(
        _dilated(edges, math.floor(DECAY / grain), span / grain),
        _dilated(closest, 1, span),
        grain,
        fine,
    )


def _coarse_indices(position: Tensor, axis: AxisHalving) -> list[Tensor]:
    """The one or two coarse pixels of half resolution that contain each pixel, along an axis."""
    position = position + axis.before
    if not axis.axis.odd:
        return [position.div(2, rounding_mode="floor")]
    return [position.div(2, rounding_mode="floor"), (position + 1).div(2, rounding_mode="floor")]


def _dilated(edges: Tensor, decay: int, span: float) -> Tensor:
    """Edges [h, w] dilated in place by a cone whose upper bits fall by `decay` per px.

    `span`: greatest fall that matters.
    """
    reached, stride, coarse = 0, 1, pieces(edges.device, _BYTES_EACH, _PIXELS)
    while 2 * reached * decay < span:
        fall = (2 * decay * stride) << BITS
        for dim in (-2, -1):
            n = edges.shape[dim] - stride
            if n < 1:
                continue
            for lines in torch.split(edges, max(1, coarse // edges.shape[dim]), -3 - dim):
                fallen = lines - fall
                for target, source in ((0, stride), (stride, 0)):
                    side = lines.narrow(dim, target, n)
                    torch.maximum(side, fallen.narrow(dim, source, n), out=side)
        reached, stride = reached + stride, 2 * stride
    return edges

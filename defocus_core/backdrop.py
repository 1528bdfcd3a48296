"""A picture seen coarsely: how far each edge of depth lets the aperture look, and onto what.

What lies deep behind an edge comes from far away. It is continued from a picture of a quarter of
the resolution, made once for the whole frame. So is the map of what the edges reveal.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.halving import (
    Axis,
    Coarse,
    axes,
    coarser,
    extended,
    greatest,
    halved,
    halves,
    spread_out,
)
from defocus_core.source import Pixels, banded
from defocus_core.threads import threaded
from defocus_core.tiling import Box

# Edges of radius, in px per pixel, above which one surface hides another.
_EDGE = 1.0
# Decay of the reach per px of |dx| + |dy|: 1 / √2 reaches as far on diagonals as it must.
DECAY = 0.70710678
# How many times the picture is halved.
COARSE = 2
# What is shown of a surface at all, as a share of the distance to which it may be.
_REACHED = 0.9
# Levels of a deep continuation at most: it begins at as low a resolution as that allows.
_LEVELS_AT_ONCE = 5
# Rows of a quarter of the resolution, and pixels of the whole one, that are made at once at most.
_BAND, _PIXELS = 32, 1 << 20
# Cones are compared in grains of 1 / 16 px, or more where more than 2^13 of them make a radius.
_FINEST = -4
_LEVELS = 13
_BITS = 16
_NOWHERE = -2 << _LEVELS << _BITS
# Radii beyond this count as this: no frame is as wide.
_MOST = 4096.0


class Backdrop(NamedTuple):
    """What regions need to know of the frame around them.

    Attributes:
        pictures: Colour and radius in px of a quarter of the resolution, an eighth, and so on.
            Their ranks are those of the pixels beside, too.
        cone: [h, w] integers, half as large, see `_edges`.
        grain: Px that are 1 in a cone.
        fine: Where the middle of the frame is at full resolution.
    """

    pictures: list[Coarse]
    cone: Tensor
    grain: float
    fine: tuple[Axis, Axis]

    def revealed(self, box: Box) -> tuple[Tensor, Tensor]:
        """What the aperture may show at each pixel: the farthest radius, and that of its source.

        A far pixel beside an edge shows until its radius, less the distance, falls to the near
        one's: the greatest of r_far - |q - far| over all of them (a dilation by a cone).

        Returns:
            Both [height, width] px: the greatest such difference, below all radii where there is
            none, and its r_far.
        """
        odd = (self.fine[0].odd, self.fine[1].odd)
        cone = self.cone
        cuts = []
        for d, (start, length) in enumerate(((box.top, box.height), (box.left, box.width))):
            start += self.fine[d].middle % 2
            first, last = start // 2, (start + length - 1 + odd[d]) // 2
            cone = cone.narrow(d, first, last + 1 - first)
            cuts.append(slice(start - 2 * first, start - 2 * first + length))
        cone = spread_out(cone, odd)[cuts[0], cuts[1]]
        source = (cone & ((1 << _BITS) - 1)) - (1 << _LEVELS)
        # two pixels of neighbouring cells may be a px apart, and not two
        shown = torch.minimum((cone >> _BITS) + math.floor(DECAY / self.grain), source)
        dtype = self.pictures[0].rank.dtype
        return shown.to(dtype) * self.grain, source.to(dtype) * self.grain


def backdrop(
    pixels: Pixels,
    signed_radius: Pixels,
    limit: float = math.inf,
    dtype: torch.dtype | None = None,
    threads: int = 1,
    ends: tuple[float, float] | None = None,
) -> Backdrop:
    """Look at a picture coarsely.

    Args:
        pixels: [C, H, W] linear.
        signed_radius: [H, W] px.
        limit: What is brighter is a highlight, and not continued.
        dtype: To compute in; None for that of the pixels.
        threads: Bands of rows looked at at once.
        ends: Least and greatest radius in px, if they are known.
    """
    H, W = signed_radius.shape
    dtype = dtype or pixels.dtype
    if ends is None:
        of_bands = torch.stack([torch.stack(torch.aminmax(b)) for b in banded(signed_radius)])
        ends = (float(of_bands.amin()), float(of_bands.amax()))
    least, most = ends
    largest = min(max(-least, most, 1.0), _MOST)
    grain = 2.0 ** max(_FINEST, math.ceil(math.log2(largest)) - _LEVELS)
    fine = axes((H, W))
    half, across = halves(H, fine[0]), halves(W, fine[1])
    quarter = halves(half.length, half.axis)
    of_width = halves(across.length, across.axis)
    middle, width = (quarter.axis, of_width.axis), of_width.length

    def looked_at(rows: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
        """Sums, ranks and cones of rows from one to another of a quarter of the resolution."""
        first, last = (row - quarter.axis.middle for row in rows)
        top = max(0, fine[0].middle + 4 * (first - 1))
        below = min(H, fine[0].middle + 4 * (last + 1) + fine[0].odd)
        band = Box(top, 0, below - top, W)
        sums, rank, cone, halved_rows, rows_now = _coarsely(
            band.of(pixels).to(dtype),
            band.of(signed_radius).to(dtype),
            limit,
            grain,
            axes((H, W), top),
        )
        here = slice(first + rows_now, last + rows_now)
        start = 0 if rows[0] == 0 else 2 * first + halved_rows
        end = cone.shape[0] if rows[1] == quarter.length else 2 * last + halved_rows
        return sums[:, here], rank[here], cone[start:end]

    step = max(1, min(_BAND, _PIXELS // (W << COARSE)))
    cuts = [*range(0, quarter.length, step), quarter.length]
    found = threaded(looked_at, list(pairwise(cuts)), threads)
    sums, rank, cone = _put_together(found, (quarter.length, quarter.length, half.length))
    some = sums[-1] > 0
    values = sums[:-1] / torch.where(some, sums[-1], 1.0)
    pictures = [Coarse(values, torch.where(some, rank, -torch.inf), middle, COARSE)]
    deepest = int(level_of(torch.tensor(max(most - least, 1.0))))
    for _ in range(COARSE, halvings_for(min(deepest, levels_of(quarter.length, width)))):
        pictures.append(coarser(pictures[-1], halved))
    return Backdrop(pictures, _dilated(cone, grain, most - least), grain, fine)


def level_of(apart: Tensor) -> Tensor:
    """The level of a continuation across radii so many px apart: [n] integers.

    It reaches twice as far as it must: of what is hidden deep, the mean of more is a better guess.
    """
    return (apart * _REACHED).log2().floor().long().add(2)


def levels_of(height: int, width: int) -> int:
    """The level at which nothing is left to halve, of a frame a quarter of which is given."""
    return COARSE + max(height, width).bit_length() - 1


def halvings_for(level: int) -> int:
    """At which resolution a deep continuation of some level begins."""
    return max(COARSE, level - _LEVELS_AT_ONCE)


def _put_together(parts: Iterable[tuple[Tensor, ...]], heights: tuple[int, ...]) -> list[Tensor]:
    """Pictures [..., h, w] from their rows, some at a time."""
    if torch.is_grad_enabled():
        return [torch.cat(rows, -2) for rows in zip(*parts, strict=True)]
    whole: list[Tensor] = []
    first = [0] * len(heights)
    for rows in parts:
        for i, some in enumerate(rows):
            if len(whole) == i:
                whole.append(some.new_empty(*some.shape[:-2], heights[i], some.shape[-1]))
            whole[i].narrow(-2, first[i], some.shape[-2]).copy_(some)
            first[i] += some.shape[-2]
    return whole


def _coarsely(
    pixels: Tensor,
    signed_radius: Tensor,
    limit: float,
    grain: float,
    middle: tuple[Axis, Axis],
) -> tuple[Tensor, Tensor, Tensor, int, int]:
    """Sums [C + 2, h, w] and ranks [h, w] of a quarter of the resolution, and cones of half.

    The last two are the rows of the middle in half and in a quarter of the resolution.
    """
    r = signed_radius.detach()
    cone = greatest(_edges(r, grain), middle, _NOWHERE)
    weight = (pixels.detach().amax(0) <= limit).to(r.dtype)
    sums = torch.stack([*pixels, signed_radius, torch.ones_like(r)]) * weight
    rank = -r
    for dim in (0, 1):  # an anti-aliased pixel beside an edge may have a share of the nearer one
        rank = _greatest_of_three(rank, dim)
    rows = []
    for _ in range(COARSE):
        down, across = (halves(n, axis) for n, axis in zip(rank.shape, middle, strict=True))
        sums = halved(extended(sums, down, across, 0.0), (down.axis.odd, across.axis.odd))
        rank = greatest(rank, middle, -torch.inf)
        middle = (down.axis, across.axis)
        rows.append(down.axis.middle)
    return sums, -rank, cone, rows[0], rows[1]


def _greatest_of_three(values: Tensor, dim: int) -> Tensor:
    """The greatest of each value [H, W] and those beside it."""
    n = values.shape[dim] - 1
    if n < 1:
        return values
    result = values.clone()
    for target, source in ((0, 1), (1, 0)):
        side = result.narrow(dim, target, n)
        torch.maximum(side, values.narrow(dim, source, n), out=side)
    return result


def _edges(r: Tensor, grain: float) -> Tensor:
    """The radii of the farther pixels at edges, [H, W] twice in an integer, in units of a grain.

    In the upper bits, and again in the lower ones: the greatest cone brings its source along.
    """
    radii = (r.clamp(-_MOST, _MOST) / grain).round().to(torch.int32)
    source = (radii << _BITS) + (radii + (1 << _LEVELS))
    cone = torch.full_like(source, _NOWHERE)
    for dim in (0, 1):
        n = r.shape[dim] - 1
        if n < 1:
            continue
        step = r.diff(dim=dim)
        before, after = source.narrow(dim, 0, n), source.narrow(dim, 1, n)
        first, second = cone.narrow(dim, 0, n), cone.narrow(dim, 1, n)
        first.copy_(torch.where(step < -_EDGE, torch.maximum(first, before), first))
        second.copy_(torch.where(step > _EDGE, torch.maximum(second, after), second))
    return cone


def _dilated(cone: Tensor, grain: float, span: float) -> Tensor:
    """Cones [h, w] of half resolution spread over as many px as radii differ at most; in place."""
    decay = math.floor(DECAY / grain)
    reached, stride = 0, 1
    while 2 * reached * decay * grain < span:
        fall = (2 * decay * stride) << _BITS
        for dim in (0, 1):
            n = cone.shape[dim] - stride
            if n < 1:
                continue
            for some in torch.split(cone, max(1, _PIXELS // cone.shape[dim]), 1 - dim):
                fallen = some - fall
                for target, source in ((0, stride), (stride, 0)):
                    side = some.narrow(dim, target, n)
                    torch.maximum(side, fallen.narrow(dim, source, n), out=side)
        reached, stride = reached + stride, 2 * stride
    return cone

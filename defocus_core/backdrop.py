"""A picture seen coarsely: how far each edge of depth lets the aperture look, and onto what.

What lies behind an edge is continued from pictures of a quarter of the resolution and less, made
once for the whole frame. So is the map of what the edges reveal.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.halving import Axis, Halves, axes, halves, spread_out
from defocus_core.sheets import Level, coarser, pixels_of, stacked
from defocus_core.source import Pixels, banded
from defocus_core.threads import threaded
from defocus_core.tiling import Box
from defocus_core.transport import structure

# Edges of radius, in px per pixel, above which one surface hides another.
_EDGE = 1.0
# By how much a pixel beside a nearer one counts: it may show a part of that.
_MIXED = 0.25
# Decay of the reach per px of |dx| + |dy|: 1 / √2 reaches as far on diagonals as it must.
DECAY = 0.70710678
# Rows of a quarter of the resolution, and pixels of the whole one, that are made at once at most;
# and rows around them that these depend on.
_BAND, _PIXELS, _AROUND = 32, 1 << 20, 2
# Levels are made until a cell is this many times as wide as radii differ.
_WIDER = 2.0
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
        levels: Of a quarter of the resolution, an eighth, and so on: colour, radius in px, and the
            structure tensor.
        cone: [h, w] integers, half as large, see `_edges`.
        grain: Px that are 1 in a cone.
        fine: Where the middle of the frame is at full resolution.
    """

    levels: list[Level]
    cone: Tensor
    grain: float
    fine: tuple[Axis, Axis]

    def revealed(
        self, cells: Box, middle: tuple[Axis, Axis], halvings: int
    ) -> tuple[Tensor, Tensor]:
        """What the aperture may show in each cell: the farthest radius, and that of its source.

        A far pixel beside an edge shows until its radius, less the distance, falls to the near
        one's: the greatest of r_far - |q - far| over all of them (a dilation by a cone).

        Args:
            cells: Of the frame at full (0) or half (1) of its resolution, from some corner.
            middle: Where the middle of the frame is from there.
            halvings: 0 or 1.

        Returns:
            Both [height, width] px: the greatest such difference, below all radii where there is
            none, and its r_far.
        """
        cone, cuts = self.cone, []
        for d, axis in enumerate(middle):
            fine, start, length = self.fine[d].middle, cells[d] - axis.middle, cells[d + 2]
            # the middle is an even number of pixels after the beginning of the first cell
            origin = (fine + fine % 2) // 2
            if halvings:
                first, last = start + origin, start + origin + length - 1
            else:
                start += 2 * origin
                first, last = start // 2, (start + length - 1 + axis.odd) // 2
                cuts.append(slice(start - 2 * first, start - 2 * first + length))
            cone = cone.narrow(d, first, last + 1 - first)
        if not halvings:
            cone = spread_out(cone, (middle[0].odd, middle[1].odd))[cuts[0], cuts[1]]
        source = (cone & ((1 << _BITS) - 1)) - (1 << _LEVELS)
        # two pixels of neighbouring cells may be a px apart, and not two
        shown = torch.minimum((cone >> _BITS) + math.floor(DECAY / self.grain), source)
        dtype = self.levels[0].first.least.dtype
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
    device = signed_radius.device
    dtype = dtype or pixels.dtype
    if ends is None:
        of_bands = torch.stack([torch.stack(torch.aminmax(b)) for b in banded(signed_radius)])
        ends = (float(of_bands.amin()), float(of_bands.amax()))
    least, most = ends
    largest = min(max(-least, most, 1.0), _MOST)
    grain = 2.0 ** max(_FINEST, math.ceil(math.log2(largest)) - _LEVELS)
    fine = axes((H, W))
    half = halves(H, fine[0])
    quarter = halves(half.length, half.axis)

    def looked_at(rows: tuple[int, int]) -> tuple[Level, Tensor, int, int]:
        """From some row to another of a quarter of the resolution: these, cones, and both ends."""
        first, last = (row - quarter.axis.middle for row in rows)
        top = max(0, fine[0].middle + 4 * (first - _AROUND))
        below = min(H, fine[0].middle + 4 * (last + _AROUND) + fine[0].odd)
        band = Box(top, 0, below - top, W)
        level, cone, halved_rows = _coarsely(
            band.of(pixels).to(dtype),
            band.of(signed_radius).to(dtype),
            limit,
            grain,
            axes((H, W), top),
        )
        start = 0 if rows[0] == 0 else 2 * first + halved_rows
        end = cone.shape[0] if rows[1] == quarter.length else 2 * last + halved_rows
        middle = level.middle[0].middle
        return level, cone[start:end], first + middle, last + middle

    step = max(1, min(_BAND, _PIXELS // (W << 2)))
    cuts = [*range(0, quarter.length, step), quarter.length]
    cone = torch.empty(half.length, halves(W, fine[1]).length, dtype=torch.int32, device=device)

    def put_together() -> Iterator[tuple[Level, int, int]]:
        done = 0
        for level, some, first, end in threaded(looked_at, list(pairwise(cuts)), threads):
            cone[done : done + len(some)] = some
            done += len(some)
            yield level, first, end

    levels = [stacked(put_together(), quarter.length, quarter.axis)]
    while max(levels[-1].size) > 1 and 1 << levels[-1].halvings < _WIDER * (most - least):
        levels.append(coarser(levels[-1]))
    return Backdrop(levels, _dilated(cone, grain, most - least), grain, fine)


def _coarsely(
    pixels: Tensor,
    signed_radius: Tensor,
    limit: float,
    grain: float,
    middle: tuple[Axis, Axis],
) -> tuple[Level, Tensor, int]:
    """A quarter of the resolution, cones of half of it, and the row of the middle in these."""
    r = signed_radius.detach()
    farther = _beside_edges(r)
    weight = (pixels.detach().amax(0) <= limit).to(r.dtype)
    weight.flatten()[farther] *= _MIXED
    picture = torch.cat([pixels, signed_radius[None]])
    half = coarser(pixels_of(picture, signed_radius, middle, weight))
    cone = _edges(r, farther, grain, middle)
    return coarser(structure(half)), cone, half.middle[0].middle


def _beside_edges(r: Tensor) -> Tensor:
    """The numbers of the farther pixels at edges of radii [H, W] px."""
    found = []
    for dim, stride in ((0, r.shape[1]), (1, 1)):
        step = r.diff(dim=dim)
        row, column = torch.nonzero(step.abs() > _EDGE).unbind(1)
        found.append(row * r.shape[1] + column + stride * (step[row, column] > 0))
    return torch.cat(found)


def _edges(r: Tensor, farther: Tensor, grain: float, middle: tuple[Axis, Axis]) -> Tensor:
    """The radii of the farther pixels at edges, at half resolution, in units of a grain.

    In the upper bits, and again in the lower ones: the greatest cone brings its source along.

    Args:
        r: [H, W] px.
        farther: Numbers of these pixels.
        grain: Px.
        middle: Of the frame.
    """
    radii = (r.flatten()[farther].clamp(-_MOST, _MOST) / grain).round().to(torch.int32)
    row = farther.div(r.shape[1], rounding_mode="floor")
    column = farther - row * r.shape[1]
    source = (radii << _BITS) + (radii + (1 << _LEVELS))
    down, across = (halves(n, axis) for n, axis in zip(r.shape, middle, strict=True))
    cone = source.new_full((down.length * across.length,), _NOWHERE)
    for cell_down in _cells(row, down):
        for cell_across in _cells(column, across):
            cone.scatter_reduce_(0, cell_down * across.length + cell_across, source, "amax")
    return cone.reshape(down.length, across.length)


def _cells(place: Tensor, axis: Halves) -> list[Tensor]:
    """The one or two cells of half resolution that pixels are part of, along an axis."""
    place = place + axis.before
    if not axis.axis.odd:
        return [place.div(2, rounding_mode="floor")]
    return [place.div(2, rounding_mode="floor"), (place + 1).div(2, rounding_mode="floor")]


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

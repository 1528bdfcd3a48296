"""A smooth continuation of a picture to pixels that have no value: push and pull.

Values are averaged to half resolution again and again, by the weight they have; then each level
fills from the next coarser one what it lacks (Gortler et al. 1996). The averages overlap: a pixel
is continued alike wherever it lies among the cells. Only blocks around the pixels that ask are
computed, and only as many levels as they ask for.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import interpolate, pad

from defocus_core.halving import Axis, pulled

# Cells of the coarsest level on a side of a block, and those around it from which light comes.
_CELLS = 8
_AROUND = 3
# Values come from this many px times 2^level away at most.
REACH = 4
# Samples continued at once: bounds memory.
_SAMPLES = 1 << 18


def continued(
    values: Sequence[Tensor],
    rank: Tensor,
    at: Tensor,
    border: Tensor,
    *,
    level: int,
    middle: tuple[Axis, Axis],
) -> tuple[Tensor, Tensor]:
    """Values continued to some pixels, to each from those whose rank is beyond its border.

    Args:
        values: Pictures [k, H, W], K channels in all.
        rank: [H, W], of the dtype of the values.
        at: [n, 2] rows and columns to continue to, in between pixels too.
        border: [n] few different ones.
        level: How many times resolution is halved, at least 1: values come from up to
            1.5 · 2^level px away, whatever lies there, and never from more than REACH · 2^level.
        middle: Of the frame.

    Returns:
        [n, K], and [n] bool whether there was something to continue.
    """
    cuts = [_cut_up(n, axis, level) for n, axis in zip(rank.shape, middle, strict=True)]
    row, column = (cut.number(at[:, d], middle[d]) for d, cut in enumerate(cuts))
    size = (cuts[0].length, cuts[1].length)
    borders, which = torch.unique(border, return_inverse=True)
    corner = (row - row.min()) * (column.max() - column.min() + 1) + column - column.min()
    keys, of = torch.unique(corner * len(borders) + which, return_inverse=True)
    order = of.argsort(stable=True)
    ends = torch.bincount(of, minlength=len(keys)).cumsum(0).tolist()
    first_of = order[torch.tensor([0, *ends[:-1]], device=at.device)]
    rows, columns, limits = row[first_of], column[first_of], border[first_of]
    picture = torch.cat([*values, torch.ones_like(rank)[None]])
    found = picture.new_zeros(len(at), len(picture) - 1)
    weight = picture.new_zeros(len(at))
    start = 0
    for first, last in _batches(len(ends), size[0] * size[1]):
        some = order[start : ends[last - 1]]
        start = ends[last - 1]
        origin = [
            cut.first + number[first:last] * cut.side
            for cut, number in zip(cuts, (rows, columns), strict=True)
        ]
        result = _blocks(picture, rank, origin, size, limits[first:last], level, middle)
        number = of[some] - first
        places = [at[some, d] - origin[d][number] for d in (0, 1)]
        sampled = _sampled(result, number, places, middle)
        share = sampled[:, -1:].detach()
        found = found.index_copy(0, some, sampled[:, :-1] / torch.where(share > 0, share, 1.0))
        weight = weight.index_copy(0, some, share[:, 0])
    return found, weight > 0


class _Cut(NamedTuple):
    """How an axis is cut into blocks.

    Attributes:
        first: The first pixel of the first block, with those around it.
        side: Pixels from block to block; 0 if there is one.
        length: Pixels of a block, with those around it.
    """

    first: int
    side: int
    length: int

    def number(self, at: Tensor, axis: Axis) -> Tensor:
        """Of the blocks that hold pixels [n]."""
        if not self.side:
            return torch.zeros_like(at, dtype=torch.long)
        place = at - axis.middle + (0.0 if axis.odd else 0.5)
        return (place / self.side).floor().long()


def _cut_up(length: int, axis: Axis, level: int) -> _Cut:
    """Blocks of an axis of some pixels: one where it is short."""
    first, last = -axis.middle >> level, -(axis.middle - length >> level)
    around = _AROUND << level
    if last - first <= _CELLS:
        start, side, cells = (first << level) + axis.middle, 0, last - first
    else:
        start, side, cells = axis.middle, _CELLS << level, _CELLS
    return _Cut(start - around, side, ((cells + 2 * _AROUND) << level) + axis.odd)


def _batches(count: int, samples: int) -> Iterator[tuple[int, int]]:
    step = max(1, _SAMPLES // samples)
    for first in range(0, count, step):
        yield first, min(first + step, count)


def _blocks(
    picture: Tensor,
    rank: Tensor,
    origin: list[Tensor],
    size: tuple[int, int],
    border: Tensor,
    level: int,
    middle: tuple[Axis, Axis],
) -> Tensor:
    """Continued values and whether there were some, of m blocks at half resolution.

    Args:
        picture: [K + 1, H, W], the last channel is 1.
        rank: [H, W].
        origin: First row and first column of each block, [m] both.
        size: (height, width) of all.
        border: [m].
        level: Of the coarsest resolution.
        middle: Of the frame.

    Returns:
        [m, K + 1, h, w].
    """
    corners = list(zip(*(corner.tolist() for corner in origin), strict=True))
    ranks = torch.stack([_cut(rank, corner, size, -torch.inf) for corner in corners])
    pixels = torch.stack([_cut(picture, corner, size, 0.0) for corner in corners])
    pixels = pixels.mul_((ranks > border[:, None, None])[:, None])
    odd = (middle[0].odd, middle[1].odd)
    levels: list[Tensor] = []
    for _ in range(level):
        pixels = pulled(pixels, odd)
        pixels = pixels / pixels[:, -1:].clamp(min=1)
        levels.append(pixels)
    found = _averaged(levels.pop())
    for finer in reversed(levels):
        found = torch.addcmul(finer, 1 - finer[:, -1:], _doubled(found, odd))
    return found


def _cut(picture: Tensor, corner: tuple[int, int], size: tuple[int, int], missing: float) -> Tensor:
    """A rectangle [..., height, width] of a picture [..., H, W], with a value where it has none."""
    edges: list[int] = []
    for dim in (-2, -1):
        start, length = corner[dim], size[dim]
        n = picture.shape[dim]
        first, last = min(max(start, 0), n), max(min(start + length, n), 0)
        last = max(first, last)
        picture = picture.narrow(dim, first, last - first)
        before = min(max(-start, 0), length)
        edges = [before, length - before - (last - first), *edges]
    return pad(picture, edges, value=missing) if any(edges) else picture


def _doubled(values: Tensor, odd: tuple[bool, bool]) -> Tensor:
    """The same field [..., h, w] at twice the resolution, linear between samples."""
    h, w = values.shape[-2:]
    height, width = 2 * h - odd[0], 2 * w - odd[1]
    if odd[0] == odd[1]:
        return interpolate(values, (height, width), mode="bilinear", align_corners=odd[0])
    values = interpolate(values, (height, w), mode="bilinear", align_corners=odd[0])
    return interpolate(values, (height, width), mode="bilinear", align_corners=odd[1])


def _averaged(values: Tensor) -> Tensor:
    """Values [m, K + 1, h, w] smoothed by tents of three cells, by their weight; 0 where none is.

    The last channel becomes 1 or 0.
    """
    for dim in (-1, -2):
        n = values.shape[dim]
        edge = (1, 1) if dim == -1 else (0, 0, 1, 1)
        wide = pad(values, edge)
        values = 2 * values + wide.narrow(dim, 0, n) + wide.narrow(dim, 2, n)
    weight = values[:, -1:]
    some = weight > 0
    return torch.where(some, values / torch.where(some, weight, 1.0), 0.0)


def _sampled(
    half: Tensor, number: Tensor, places: list[Tensor], middle: tuple[Axis, Axis]
) -> Tensor:
    """Fields [m, K, h, w] of half resolution at pixels [n] of block `number`: [n, K]."""
    (y0, y1, fy), (x0, x1, fx) = (
        _neighbours(places[d], half.shape[d + 2], half.dtype, middle[d].odd) for d in (0, 1)
    )
    h, w = half.shape[-2:]
    rows = half.movedim(1, -1).reshape(-1, half.shape[1])
    above, below = number * (h * w) + y0 * w, number * (h * w) + y1 * w

    def at(row: Tensor) -> Tensor:
        return rows.index_select(0, row + x0) * (1 - fx) + rows.index_select(0, row + x1) * fx

    return at(above) * (1 - fy) + at(below) * fy


def _neighbours(
    index: Tensor, length: int, dtype: torch.dtype, odd: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """The two coarse samples beside a pixel, and the share of the second."""
    place = index.to(dtype) / 2 if odd else (index.to(dtype) - 0.5) / 2
    first = place.floor().clamp(0, length - 1)
    share = (place - first).clamp(0, 1)[:, None]
    return first.long(), (first.long() + 1).clamp(max=length - 1), share

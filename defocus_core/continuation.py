"""A smooth continuation of a picture to pixels that have no value: push and pull.

Values are averaged to half resolution again and again, by the weight they have; then each level
fills from the next coarser one what it lacks (Gortler et al. 1996). The averages overlap: a pixel
is continued alike wherever it lies among the cells. Only blocks around the pixels that ask are
computed, and only as many levels as they ask for.
"""

from __future__ import annotations

from collections.abc import Iterator
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
    values: Tensor,
    rank: Tensor,
    at: Tensor,
    border: Tensor,
    *,
    level: int,
    middle: tuple[Axis, Axis],
) -> tuple[Tensor, Tensor]:
    """Values continued to some pixels, to each from those whose rank is beyond its border.

    Args:
        values: [K, H, W].
        rank: [H, W], of the dtype of the values.
        at: [n, 2] rows and columns to continue to, in between pixels too.
        border: [n] few different ones.
        level: How many times resolution is halved, at least 1: values come from up to
            1.5 · 2^level px away, whatever lies there, and never from more than REACH · 2^level.
        middle: Of the frame.

    Returns:
        [n, K], and [n] bool whether there was something to continue.
    """
    axes = list(zip(rank.shape, middle, strict=True))
    borders, which = torch.unique(border, return_inverse=True)
    cells = [_cell(at[:, d], axis, level) for d, axis in enumerate(middle)]
    pieces, of = _pieces(cells, which, len(borders), [_span(n, axis, level) for n, axis in axes])
    order = of.argsort(stable=True)
    ends = [0, *torch.bincount(of, minlength=len(pieces)).cumsum(0).tolist()]
    picture = torch.cat([values, torch.ones_like(rank)[None]])
    found = picture.new_zeros(len(at), len(picture) - 1)
    weight = picture.new_zeros(len(at))
    for first, last in _batches(pieces, level):
        some = order[ends[first] : ends[last]]
        corners = [
            (
                (piece.first[0] << level) + middle[0].middle,
                (piece.first[1] << level) + middle[1].middle,
            )
            for piece in pieces[first:last]
        ]
        size = [
            (n << level) + axis.odd for n, axis in zip(pieces[first].cells, middle, strict=True)
        ]
        limits = borders[[piece.border for piece in pieces[first:last]]]
        result = _filled(picture, rank, corners, (size[0], size[1]), limits, level, middle)
        number = of[some] - first
        places = at[some] - torch.tensor(corners, device=at.device)[number]
        sampled = _sampled(result, number, places)
        share = sampled[:, -1:].detach()
        found = found.index_copy(0, some, sampled[:, :-1] / torch.where(share > 0, share, 1.0))
        weight = weight.index_copy(0, some, share[:, 0])
    return found, weight > 0


class _Piece(NamedTuple):
    """What is continued at once for pixels of one border, in cells of the coarsest level.

    Attributes:
        first: Row and column of the first cell, counted from the middle of the frame.
        cells: Rows and columns.
        border: Its number.
    """

    first: tuple[int, int]
    cells: tuple[int, int]
    border: int


def _cell(at: Tensor, axis: Axis, level: int) -> Tensor:
    """Cells [n] of 2^level px, counted from the middle, that hold pixels [n]."""
    place = at - axis.middle + (0.0 if axis.odd else 0.5)
    return (place / (1 << level)).floor().long()


def _span(length: int, axis: Axis, level: int) -> tuple[int, int]:
    """The first cell of an axis of some pixels and the end of the last, and one more each."""
    return (-axis.middle >> level) - 1, -((axis.middle - length) >> level) + 1


def _pieces(
    cells: list[Tensor], which: Tensor, borders: int, spans: list[tuple[int, int]]
) -> tuple[list[_Piece], Tensor]:
    """What is to be continued, and in which piece of it each pixel is.

    Of each border either the rectangle around all that ask, or blocks that are asked, whichever are
    fewer cells.

    Args:
        cells: Row and column of n pixels, [n] both.
        which: [n] number of the border of each.
        borders: How many there are.
        spans: Cells that hold anything.
    """
    blocks = [cell.div(_CELLS, rounding_mode="floor") for cell in cells]
    firsts = [int(block.min()) for block in blocks]
    rows, columns = (
        int(block.max()) - first + 1 for block, first in zip(blocks, firsts, strict=True)
    )
    key = (which * rows + blocks[0] - firsts[0]) * columns + blocks[1] - firsts[1]
    keys, of = torch.unique(key, return_inverse=True)
    border = keys.div(rows * columns, rounding_mode="floor")
    ends = []
    for cell, (first, end) in zip(cells, spans, strict=True):
        low, high = (
            cell.new_zeros(borders).scatter_reduce(0, which, cell, how, include_self=False)
            for how in ("amin", "amax")
        )
        low, high = (low - _AROUND).clamp(min=first), (high + 1 + _AROUND).clamp(max=end)
        ends.append((low, high - low))
    block = _CELLS + 2 * _AROUND
    around = ends[0][1] * ends[1][1] <= torch.bincount(border, minlength=borders) * block**2
    starts = ~around[border]
    starts[0] = True
    starts[1:] |= border.diff() > 0
    number = starts.cumsum(0) - 1
    keys, border = keys[starts], border[starts]
    places = (
        keys.div(columns, rounding_mode="floor") % rows + firsts[0],
        keys % columns + firsts[1],
    )
    single = around[border]
    corner, size = (
        [
            torch.where(single, end[i][border], other).tolist()
            for end, other in zip(ends, others, strict=True)
        ]
        for i, others in enumerate(
            ([place * _CELLS - _AROUND for place in places], [torch.full_like(keys, block)] * 2)
        )
    )
    found = [
        _Piece(*some)
        for some in zip(
            zip(*corner, strict=True), zip(*size, strict=True), border.tolist(), strict=True
        )
    ]
    return found, number[of]


def _batches(pieces: list[_Piece], level: int) -> Iterator[tuple[int, int]]:
    """The first and the end of pieces that are alike, as many as are continued at once."""
    first = 0
    while first < len(pieces):
        rows, columns = pieces[first].cells
        most = first + max(1, _SAMPLES // (rows * columns << 2 * level))
        last = first + 1
        while last < min(most, len(pieces)) and pieces[last].cells == (rows, columns):
            last += 1
        yield first, last
        first = last


def _filled(
    picture: Tensor,
    rank: Tensor,
    corners: list[tuple[int, int]],
    size: tuple[int, int],
    border: Tensor,
    level: int,
    middle: tuple[Axis, Axis],
) -> Tensor:
    """Continued values and whether there were some, of m rectangles.

    Args:
        picture: [K + 1, H, W], the last channel is 1.
        rank: [H, W].
        corners: First row and first column of each.
        size: (height, width) of all.
        border: [m].
        level: Of the coarsest resolution.
        middle: Of the frame.

    Returns:
        [m, K + 1, h, w].
    """
    ranks = torch.stack([_cut(rank, corner, size, -torch.inf) for corner in corners])
    pixels = torch.stack([_cut(picture, corner, size, 0.0) for corner in corners])
    pixels = pixels.mul_((ranks > border[:, None, None])[:, None])
    odd = (middle[0].odd, middle[1].odd)
    levels = [_grown(pixels)]
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


def _grown(values: Tensor) -> Tensor:
    """Values [m, K + 1, h, w] times their weight, and what lies next to them where there are none.

    Those count by tents of three cells, but twice: beside an edge by a half.
    """
    tents = values
    for dim in (-1, -2):
        n = values.shape[dim] - 1
        wide = 2 * tents
        wide.narrow(dim, 1, n).add_(tents.narrow(dim, 0, n))
        wide.narrow(dim, 0, n).add_(tents.narrow(dim, 1, n))
        tents = wide
    weight = tents[:, -1:]
    share = (1 - values[:, -1:]) * (weight / 8).clamp(max=1) / weight.clamp(min=1)
    return torch.addcmul(values, share, tents)


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


def _sampled(fields: Tensor, number: Tensor, places: Tensor) -> Tensor:
    """Fields [m, K, h, w] between the pixels, at [n, 2] of rectangle `number`: [n, K]."""
    (y0, y1, fy), (x0, x1, fx) = (
        _neighbours(places[:, d], fields.shape[d + 2], fields.dtype) for d in (0, 1)
    )
    h, w = fields.shape[-2:]
    rows = fields.movedim(1, -1).reshape(-1, fields.shape[1])
    above, below = number * (h * w) + y0 * w, number * (h * w) + y1 * w

    def at(row: Tensor) -> Tensor:
        return rows.index_select(0, row + x0) * (1 - fx) + rows.index_select(0, row + x1) * fx

    return at(above) * (1 - fy) + at(below) * fy


def _neighbours(place: Tensor, length: int, dtype: torch.dtype) -> tuple[Tensor, Tensor, Tensor]:
    """The two pixels beside each place [n], and the share of the second."""
    place = place.to(dtype)
    first = place.floor().clamp(0, length - 1)
    share = (place - first).clamp(0, 1)[:, None]
    return first.long(), (first.long() + 1).clamp(max=length - 1), share

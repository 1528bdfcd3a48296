"""A pyramid of two layers: in each cell the farthest surface, and the next one in front of it.

A cell on a depth edge holds two surfaces. Their mean is neither, and hidden content is continued
from the farther one alone. So each cell keeps two sheets, each the mean of pixels of like radii.
From the second halving on cells overlap (Burt 1981), so that their values hardly depend on where an
edge lies among them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.tensors.pyramid import Axis, AxisHalving, extended, halved, halves, pulled
from defocus_core.tensors.sparse_masks import numbers_of

# Range of radii in px that counts as one surface in a cell of two by two pixels; and the factor by
# which the range grows at each further level.
_ALIKE, _GROWTH = 1.013, 1.5
# Cells on edges that are split into two sheets at once: bounds memory.
_CELLS = 1 << 12


class CellSurface(NamedTuple):
    """A surface in each of n cells.

    Attributes:
        values: [K, n] means over the surface; 0 where there is none.
        weight: [n] in [0, 1], the share of the cell that the surface takes.
        least: [n] px, its least radius; infinite where there is none.
        most: [n] px, its greatest radius; -infinite where there is none.
    """

    values: Tensor
    weight: Tensor
    least: Tensor
    most: Tensor


class PyramidLevel(NamedTuple):
    """A picture, or a part of one, at some resolution.

    Attributes:
        size: (height, width) in cells.
        first: The farthest surface in each cell, row by row.
        second: The surface in front of the first, for the cells that hold two.
        number: [height * width] the index of each cell in `second`, or -1; None if all are -1.
        middle: The middle of the frame, in cells.
        halvings: How many times resolution is halved.
        edges: Numbers of the cells that hold a depth edge or pixels without weight.
        whole: Whether all weights are 1.
    """

    size: tuple[int, int]
    first: CellSurface
    second: CellSurface | None
    number: Tensor | None
    middle: tuple[Axis, Axis]
    halvings: int
    edges: Tensor
    whole: bool = False

    def channels(self, channels: slice) -> PyramidLevel:
        """The level with a range of its channels."""
        first = self.first._replace(values=self.first.values[channels])
        second = self.second
        if second is not None:
            second = second._replace(values=second.values[channels])
        return self._replace(first=first, second=second)


def pixels_of(
    values: Tensor,
    signed_radius: Tensor,
    middle: tuple[Axis, Axis],
    weight: Tensor | None = None,
) -> PyramidLevel:
    """A picture at full resolution.

    Args:
        values: [K, H, W].
        signed_radius: [H, W] px.
        middle: The middle of the frame.
        weight: [H, W] in [0, 1], weights of pixels; None if all are 1.
    """
    r = signed_radius.detach()
    size = (r.shape[0], r.shape[1])
    least = most = r = r.flatten()
    whole = weight is None
    weight = torch.ones_like(r) if weight is None else weight.flatten()
    if not whole and not bool((counted := weight.bool()).all()):
        least, most = torch.where(counted, r, torch.inf), torch.where(counted, r, -torch.inf)
    none = torch.zeros(0, dtype=torch.long, device=r.device)
    first = CellSurface(values.flatten(1), weight, least, most)
    return PyramidLevel(size, first, None, None, middle, 0, none, whole)


def coarser(level: PyramidLevel) -> PyramidLevel:
    """The next coarser level, at half the resolution."""
    H, W = level.size
    down, across = (halves(n, axis) for n, axis in zip(level.size, level.middle, strict=True))
    odd = (down.axis.odd, across.axis.odd)
    overlapping = level.halvings > 0
    sums = pulled if overlapping else halved
    first, alike = level.first, _ALIKE * _GROWTH ** max(level.halvings - 1, 0)
    least = first.least
    if level.number is not None:
        least = torch.where(level.number < 0, least, -torch.inf)

    def cells(values: Tensor, outside: float) -> Tensor:
        return extended(values.reshape(*values.shape[:-1], H, W), down, across, outside)

    weight = sums(cells(first.weight, 0.0), odd)
    values = first.values if level.whole else first.values * first.weight
    values = sums(cells(values, 0.0), odd) / torch.where(weight > 0, weight, 1.0)
    most, least = (
        _greatest_of(cells(each, -torch.inf), odd, overlapping).flatten()
        for each in (first.most, -least)
    )
    edges = numbers_of((most > -torch.inf) & ~(most + least < alike))
    dense = CellSurface(values.flatten(1), weight.flatten().clamp_(max=1), least.neg_(), most)
    middle, size = (down.axis, across.axis), (down.length, across.length)
    result = PyramidLevel(size, dense, None, None, middle, level.halvings + 1, edges)
    if not len(edges):
        return result
    pairs = [
        _split(level, chunk, (down, across), overlapping, alike)
        for chunk in torch.split(edges, _CELLS)
    ]
    far, near = (_joined([pair[i] for pair in pairs]) for i in (0, 1))
    for whole, split in zip(dense, far, strict=True):
        whole.index_copy_(-1, edges, split)
    held = torch.nonzero(near.most > -torch.inf)[:, 0]
    if not len(held):
        return result
    number = torch.full((size[0] * size[1],), -1, dtype=torch.int32, device=edges.device)
    number[edges.index_select(0, held)] = torch.arange(
        len(held), dtype=torch.int32, device=edges.device
    )
    second = CellSurface(*(each.index_select(-1, held) for each in near))
    return result._replace(second=second, number=number)


def _greatest_of(values: Tensor, odd: tuple[bool, bool], overlapping: bool) -> Tensor:
    """The greatest value [h, w] among the pixels [H, W] that have a share in each cell."""
    for dim in (0, 1):
        even, other = (values[i::2] if dim == 0 else values[:, i::2] for i in (0, 1))
        values = even.clone() if odd[dim] else torch.maximum(even, other)
        n = other.shape[dim] - (not odd[dim])
        beside = [(values.narrow(dim, 1, n), other.narrow(dim, 0, n))]
        if odd[dim]:
            beside.append((values.narrow(dim, 0, n), other))
        elif overlapping:
            beside.append((values.narrow(dim, 0, n), even.narrow(dim, 1, n)))
        else:
            beside = []
        for target, more in beside:
            torch.maximum(target, more, out=target)
    return values


def _taps(axis: AxisHalving, overlapping: bool) -> list[tuple[int, float]]:
    """The pixels that have a share in cell i, counted from 2 i, and their shares."""
    if axis.axis.odd:
        return [(-1, 0.5), (0, 1.0), (1, 0.5)]
    if overlapping:
        return [(-1, 0.25), (0, 0.75), (1, 0.75), (2, 0.25)]
    return [(0, 1.0), (1, 1.0)]


def _split(
    level: PyramidLevel,
    cells: Tensor,
    axes: tuple[AxisHalving, AxisHalving],
    overlapping: bool,
    alike: float,
) -> tuple[CellSurface, CellSurface]:
    """The farthest surface and the next one in cells [n] of half resolution.

    Args:
        level: The level whose resolution is halved.
        cells: Numbers of the cells.
        axes: How rows and columns are halved.
        overlapping: Whether cells share pixels.
        alike: Range of radii in px that counts as one surface.
    """
    row = cells.div(axes[1].length, rounding_mode="floor")
    places, shares = [], []
    for number, axis, length in zip(
        (row, cells - row * axes[1].length), axes, level.size, strict=True
    ):
        taps = _taps(axis, overlapping)
        offset = torch.tensor([tap for tap, _ in taps], device=cells.device)
        share = level.first.least.new_tensor([share for _, share in taps])
        place = 2 * number - axis.before + offset[:, None]
        inside = (place >= 0) & (place < length)
        places.append(place.clamp_(0, length - 1))
        shares.append(share[:, None] * inside)
    index = (places[0][:, None] * level.size[1] + places[1]).flatten()
    share = (shares[0][:, None] * shares[1]).flatten()
    sheet = CellSurface(*(each.index_select(-1, index) for each in level.first))
    if level.second is not None and level.number is not None:
        number = level.number.index_select(0, index)
        held = torch.nonzero(number >= 0)[:, 0]
        chosen = number.index_select(0, held)
        nearer = (
            torch.full_like(far, missing).index_copy(-1, held, each.index_select(-1, chosen))
            for far, each, missing in zip(
                sheet, level.second, (0.0, 0.0, torch.inf, -torch.inf), strict=True
            )
        )
        sheet, share = _joined([sheet, CellSurface(*nearer)]), share.repeat(2)
    values, weight, least, most, share = (
        each.reshape(*each.shape[:-1], -1, len(cells)) for each in (*sheet, share)
    )
    weight = weight * share
    remaining, sheets = weight > 0, []
    for _ in range(2):
        top = torch.where(remaining, most, -torch.inf).amax(0)
        chosen = remaining & (least > top - alike)
        remaining = remaining & ~chosen
        part = weight * chosen
        total = part.sum(0)
        mean = (values * part).sum(1) / torch.where(total > 0, total, 1.0)
        lowest = torch.where(chosen, least, torch.inf).amin(0)
        sheets.append(CellSurface(mean, total.clamp(max=1), lowest, top))
    return sheets[0], sheets[1]


def _joined(sheets: list[CellSurface]) -> CellSurface:
    """Sheets joined along their cells."""
    if len(sheets) == 1:
        return sheets[0]
    return CellSurface(*(torch.cat(each, -1) for each in zip(*sheets, strict=True)))


def stacked(
    bands: Iterable[tuple[PyramidLevel, int, int]], height: int, axis: Axis
) -> PyramidLevel:
    """A level joined from bands of rows.

    Args:
        bands: From top to bottom: a level, and its rows to take, first and end.
        height: Rows of the result.
        axis: The middle of the frame among these rows.
    """
    whole: PyramidLevel | None = None
    seconds: list[CellSurface] = []
    done = held = 0
    for band, first, end in bands:
        width = band.size[1]
        if whole is None:
            blank = (each.new_empty(*each.shape[:-1], height * width) for each in band.first)
            number = torch.full_like(band.first.least[:1], -1, dtype=torch.int32)
            number = number.repeat(height * width)
            middle = (axis, band.middle[1])
            whole = PyramidLevel(
                (height, width),
                CellSurface(*blank),
                None,
                number,
                middle,
                band.halvings,
                band.edges[:0],
            )
        rows, cells = slice(first * width, end * width), (end - first) * width
        for into, values in zip(whole.first, band.first, strict=True):
            into.narrow(-1, done, cells).copy_(values[..., rows])
        if band.second is not None and band.number is not None and whole.number is not None:
            number = band.number[rows]
            kept = torch.nonzero(number >= 0)[:, 0]
            values = number.index_select(0, kept)
            seconds.append(CellSurface(*(each.index_select(-1, values) for each in band.second)))
            whole.number[kept + done] = torch.arange(
                held, held + len(kept), dtype=torch.int32, device=kept.device
            )
            held += len(kept)
        done += cells
    assert whole is not None
    return whole._replace(second=_joined(seconds)) if held else whole._replace(number=None)

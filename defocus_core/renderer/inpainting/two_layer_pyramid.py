"""A pyramid of two layers: in each cell the farthest surface, and the next one in front of it.

A cell on a depth edge holds two surfaces. Their mean is neither, and hidden content is continued
from the farther one alone. So each cell keeps two sheets, each the mean of pixels of like radii.
From the second halving on cells overlap (Burt 1981), so that their values hardly depend on where an
edge lies among them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.tensors.device_plan import launches_cost, pieces
from defocus_core.tensors.pyramid import Axis, AxisHalving, extended, halved, halves, pulled
from defocus_core.tensors.sparse_masks import numbers_of

# Range of radii in px that counts as one surface in a cell of two by two pixels; and the factor by
# which the range grows at each further level.
_ALIKE, _GROWTH = 1.013, 1.5
# Cells on edges that are split into two sheets at once on a CPU, and bytes that each takes
# elsewhere: bounds memory.
_CELLS, _BYTES_EACH = 1 << 12, 1 << 13
# Cells of a level all of which are split where an operation takes long to begin.
_FEW = 1 << 14


class CellSurface(NamedTuple):
    """A surface in each of n cells.

    Attributes:
        data: [K + 3, n], all of the below, one after another.
    """

    data: Tensor

    @property
    def values(self) -> Tensor:
        """[K, n] means over the surface; 0 where there is none."""
        return self.data[:-3]

    @property
    def weight(self) -> Tensor:
        """[n] in [0, 1], the share of the cell that the surface takes."""
        return self.data[-3]

    @property
    def least(self) -> Tensor:
        """[n] px, its least radius; infinite where there is none."""
        return self.data[-2].detach()

    @property
    def most(self) -> Tensor:
        """[n] px, its greatest radius; -infinite where there is none."""
        return self.data[-1].detach()

    @property
    def parts(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Values, weight, least and greatest radius."""
        return self.values, self.weight, self.least, self.most

    def select(self, index: Tensor) -> CellSurface:
        """The cells of these indices."""
        return CellSurface(self.data.index_select(1, index))

    def with_values(self, more: Tensor) -> CellSurface:
        """The surface with further values [k, n] after its own."""
        return CellSurface(torch.cat([self.values, more, self.data[-3:]]))

    def channels(self, channels: slice) -> CellSurface:
        """The surface with a range of its channels."""
        return CellSurface(torch.cat([self.values[channels], self.data[-3:]]))


class PyramidLevel(NamedTuple):
    """A picture, or a part of one, at some resolution.

    Attributes:
        size: (height, width) in cells.
        first: The farthest surface in each cell, row by row.
        second: The surface in front of the first, for the cells that hold two.
        number: [height * width] the index of each cell in `second`, or -1; None if all are -1.
        middle: The middle of the frame, in cells.
        halvings: How many times resolution is halved.
        edges: [height * width] bool, the cells that hold a depth edge.
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
        second = None if self.second is None else self.second.channels(channels)
        return self._replace(first=self.first.channels(channels), second=second)


def pixels_of(
    values: Sequence[Tensor],
    signed_radius: Tensor,
    middle: tuple[Axis, Axis],
    weight: Tensor | None = None,
) -> PyramidLevel:
    """A picture at full resolution.

    Args:
        values: Each [k, H, W], together K channels.
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
    rows = [each.flatten(1) for each in values] + [each[None] for each in (weight, least, most)]
    first = CellSurface(torch.cat(rows))
    return PyramidLevel(size, first, None, None, middle, 0, r.new_zeros(0).bool(), whole)


def coarser(level: PyramidLevel) -> PyramidLevel:
    """The next coarser level, at half the resolution."""
    down, across = (halves(n, axis) for n, axis in zip(level.size, level.middle, strict=True))
    overlapping = level.halvings > 0
    alike = _ALIKE * _GROWTH ** max(level.halvings - 1, 0)
    middle, size = (down.axis, across.axis), (down.length, across.length)
    device, count = level.first.data.device, size[0] * size[1]
    if launches_cost(device) and count <= _FEW:
        every = torch.arange(count, device=device)
        dense, near = _split(level, every, (down, across), overlapping, alike)
        is_edge = near.most > -torch.inf
        number = torch.where(is_edge, every, -1)
        return PyramidLevel(size, dense, near, number, middle, level.halvings + 1, is_edge)
    values, weight, least, most = _dense(level, (down, across), overlapping)
    is_edge = (most > -torch.inf) & ~(most + least < alike)
    edges = numbers_of(is_edge)
    dense = CellSurface(torch.cat([values, torch.stack([weight, least.neg_(), most])]))
    result = PyramidLevel(size, dense, None, None, middle, level.halvings + 1, is_edge)
    if not len(edges):
        return result
    pairs = [
        _split(level, chunk, (down, across), overlapping, alike)
        for chunk in torch.split(edges, pieces(device, _CELLS, _BYTES_EACH))
    ]
    far, near = (_joined([pair[i] for pair in pairs]) for i in (0, 1))
    dense.data.index_copy_(1, edges, far.data)
    held = numbers_of(near.most > -torch.inf)
    if not len(held):
        return result
    number = torch.full((count,), -1, dtype=torch.int32, device=device)
    number[edges.index_select(0, held)] = torch.arange(len(held), dtype=torch.int32, device=device)
    return result._replace(second=near.select(held), number=number)


def _dense(
    level: PyramidLevel, axes: tuple[AxisHalving, AxisHalving], overlapping: bool
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The cells of half resolution as if all that is in one were of one surface.

    Returns:
        Means [K, n], weights [n], minus the least radius [n], and the greatest one [n].
    """
    H, W = level.size
    odd = (axes[0].axis.odd, axes[1].axis.odd)
    first, least = level.first, level.first.least
    if level.number is not None:
        least = torch.where(level.number < 0, least, -torch.inf)

    def cells(values: Tensor, outside: float) -> Tensor:
        return extended(values.reshape(-1, H, W), *axes, outside)

    weighed = first.data[:-2]
    if not level.whole:
        weighed = weighed.clone()
        weighed[:-1] *= first.weight
    sums = (pulled if overlapping else halved)(cells(weighed, 0.0), odd).flatten(1)
    values, weight = sums[:-1], sums[-1]
    values = values / torch.where(weight > 0, weight, 1.0)
    ends = _greatest_of(cells(torch.stack([-least, first.most]), -torch.inf), odd, overlapping)
    least, most = ends.flatten(1).unbind()
    return values, weight.clamp(max=1), least, most


def _greatest_of(values: Tensor, odd: tuple[bool, bool], overlapping: bool) -> Tensor:
    """The greatest value [..., h, w] among the pixels [..., H, W] with a share in each cell."""
    for dim in (-2, -1):
        even, other = (values[..., i::2, :] if dim == -2 else values[..., i::2] for i in (0, 1))
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
        offsets, by = zip(*_taps(axis, overlapping), strict=True)
        first = torch.tensor(offsets, device=cells.device) - axis.before
        place = torch.add(first[:, None], number, alpha=2)
        inside = place.clamp(0, length - 1)
        shares.append(level.first.data.new_tensor(by)[:, None] * (inside == place))
        places.append(inside)
    index = torch.add(places[1], places[0][:, None], alpha=level.size[1]).flatten()
    share = (shares[0][:, None] * shares[1]).flatten()
    data, count = level.first.data.index_select(1, index), len(cells)
    if level.second is not None and level.number is not None:
        number = level.number.index_select(0, index)
        nearer = level.second.data.index_select(1, number.clamp(min=0))
        # 0 where a cell has no second surface
        data, share = torch.cat([data, nearer], 1), torch.cat([share, share * (number >= 0)])
    values, weight, least, most = CellSurface(data.view(len(data), -1, count)).parts
    weight = weight * share.view(-1, count)
    remaining, sheets = weight > 0, []
    for _ in range(2):
        top = torch.where(remaining, most, -torch.inf).amax(0)
        chosen = remaining & (least > top - alike)
        remaining = remaining & ~chosen
        part = weight * chosen
        total = part.sum(0)
        mean = (values * part).sum(1) / torch.where(total > 0, total, 1.0)
        lowest = torch.where(chosen, least, torch.inf).amin(0)
        further = torch.stack([total.clamp(max=1), lowest, top])
        sheets.append(CellSurface(torch.cat([mean, further])))
    return sheets[0], sheets[1]


def _joined(sheets: list[CellSurface]) -> CellSurface:
    """Sheets joined along their cells."""
    if len(sheets) == 1:
        return sheets[0]
    return CellSurface(torch.cat([sheet.data for sheet in sheets], 1))


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
            blank = band.first.data.new_empty(len(band.first.data), height * width)
            number = torch.full_like(band.first.least[:1], -1, dtype=torch.int32)
            number = number.repeat(height * width)
            middle = (axis, band.middle[1])
            whole = PyramidLevel(
                (height, width),
                CellSurface(blank),
                None,
                number,
                middle,
                band.halvings,
                band.edges[:0],
            )
        rows, cells = slice(first * width, end * width), (end - first) * width
        whole.first.data[:, done : done + cells].copy_(band.first.data[:, rows])
        if band.second is not None and band.number is not None and whole.number is not None:
            number = band.number[rows]
            kept = numbers_of(number >= 0)
            seconds.append(band.second.select(number.index_select(0, kept)))
            whole.number[kept + done] = torch.arange(
                held, held + len(kept), dtype=torch.int32, device=kept.device
            )
            held += len(kept)
        done += cells
    assert whole is not None
    return whole._replace(second=_joined(seconds)) if held else whole._replace(number=None)

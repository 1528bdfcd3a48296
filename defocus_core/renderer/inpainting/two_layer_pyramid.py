"""A pyramid of two layers: in each coarse px the farthest surface, and the next one in front of it.

A coarse pixel on a depth edge holds two surfaces. Their mean is neither, and hidden content is
continued from the farther one alone. So each coarse pixel keeps two sheets, each the mean of pixels
of like radii. From the second halving on coarse pixels overlap (Burt 1981), so that their values
hardly depend on where an edge lies among them.

A hidden pixel takes the mean of the surfaces around it at a fine level, by the weight that they
have there, and the rest from the next coarser level, until its weight is enough: push-pull
(Gortler et al. 1996). The levels are computed once, and read for the hidden pixels alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag, pad

from defocus_core.tensors.device_plan import launches_cost, pieces, sent
from defocus_core.tensors.neighbourhoods import flat_nonzero
from defocus_core.tensors.pyramid import (
    Axis,
    AxisHalving,
    extended,
    halved,
    halves,
    position_of,
    pulled,
)

# Range of radii in px that counts as one surface in a coarse pixel of two by two pixels; and the
# factor by which the range grows at each further level.
_ALIKE, _GROWTH = 1.013, 1.5
# Least weight that counts: it guards 0 / 0.
LEAST_WEIGHT = 1e-30
# Bytes that a coarse pixel on an edge takes while it is split into two sheets.
_BYTES_EACH = 1 << 13
# Coarse pixels of a level all of which are split: on a CPU, and where an operation takes long to
# begin.
_FEW, _FEW_THERE = 1 << 9, 1 << 17


class CellSurface(NamedTuple):
    """A surface in each of n coarse pixels."""

    data: Tensor  # [K + 3, n], all of the below, one after another

    @property
    def values(self) -> Tensor:
        """[K, n] means over the surface; 0 where there is none."""
        return self.data[:-3]

    @property
    def weight(self) -> Tensor:
        """[n] in [0, 1], the share of the coarse pixel that the surface takes."""
        return self.data[-3]

    @property
    def minimum(self) -> Tensor:
        """[n] px, its least radius; infinite where there is none."""
        return self.data[-2].detach()

    @property
    def maximum(self) -> Tensor:
        """[n] px, its greatest radius; -infinite where there is none."""
        return self.data[-1].detach()

    @property
    def parts(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Values, weight, least and greatest radius."""
        return self.values, self.weight, self.minimum, self.maximum

    def select(self, index: Tensor) -> CellSurface:
        """The coarse pixels of these indices."""
        return CellSurface(self.data.index_select(1, index))

    def with_values(self, more: Tensor) -> CellSurface:
        """The surface with further values [k, n] after its own."""
        return CellSurface(torch.cat([self.values, more, self.data[-3:]]))


class PyramidLevel(NamedTuple):
    """A picture, or a part of one, at some resolution."""

    size: tuple[int, int]  # (height, width) in coarse pixels
    first: CellSurface  # the farthest surface in each coarse pixel, row by row
    second: CellSurface  # the surface in front of the first, for the coarse pixels that hold two
    second_index: Tensor  # [height * width] the index of each coarse pixel in `second`, or -1
    middle: tuple[Axis, Axis]  # the middle of the frame, in coarse pixels
    level: int  # how many times resolution is halved
    edges: Tensor  # [height * width] bool, the coarse pixels that hold a depth edge
    whole: bool = False  # whether all weights are 1

    @property
    def has_second(self) -> bool:
        """Whether any coarse pixel holds two surfaces."""
        return self.second.data.shape[1] > 0


def pixels_of(
    values: Sequence[Tensor],  # each [k, H, W], together K channels
    signed_radius: Tensor,  # [H, W] px
    middle: tuple[Axis, Axis],
    weight: Tensor | None = None,  # [H, W] in [0, 1], weights of pixels; None if all are 1
) -> PyramidLevel:
    """A picture at full resolution."""
    r = signed_radius.detach()
    size = (r.shape[-2], r.shape[-1])
    minimum = maximum = r = r.flatten()
    whole = weight is None
    weight = torch.ones_like(r) if weight is None else weight.flatten()
    if not whole and not bool((counted := weight.bool()).all()):
        minimum, maximum = torch.where(counted, r, torch.inf), torch.where(counted, r, -torch.inf)
    rows = [each.flatten(1) for each in values] + [
        each[None] for each in (weight, minimum, maximum)
    ]
    first = CellSurface(torch.cat(rows))
    second = CellSurface(first.data[:, :0]), _no_second(len(r), r.device)
    return PyramidLevel(size, first, *second, middle, 0, r.new_zeros(0).bool(), whole)


def _no_second(count: int, device: torch.device) -> Tensor:
    return torch.full((1,), -1, dtype=torch.int32, device=device).expand(count)


def coarser(pyramid_level: PyramidLevel) -> PyramidLevel:
    """The next coarser level, at half the resolution."""
    down, across = (
        halves(n, axis) for n, axis in zip(pyramid_level.size, pyramid_level.middle, strict=True)
    )
    overlapping = pyramid_level.level > 0
    alike = _ALIKE * _GROWTH ** max(pyramid_level.level - 1, 0)
    middle, size = (down.axis, across.axis), (down.length, across.length)
    device, count = pyramid_level.first.data.device, size[0] * size[1]
    if count <= (_FEW_THERE if launches_cost(device) else _FEW):
        dense, near = _two_farthest(*_every(pyramid_level, (down, across), overlapping), alike)
        is_edge = near.maximum > -torch.inf
        numbers = torch.arange(count, dtype=torch.int32, device=device)
        second_index = torch.where(is_edge, numbers, -1)
        return PyramidLevel(
            size, dense, near, second_index, middle, pyramid_level.level + 1, is_edge
        )
    values, weight, minimum, maximum = _dense(pyramid_level, (down, across), overlapping)
    is_edge = (maximum > -torch.inf) & ~(maximum + minimum < alike)
    edges = flat_nonzero(is_edge)
    further = weight[None], minimum.neg_()[None], maximum[None]
    dense = CellSurface(torch.cat([values, *further]))
    second = CellSurface(dense.data[:, :0]), _no_second(count, device)
    result = PyramidLevel(size, dense, *second, middle, pyramid_level.level + 1, is_edge)
    if not len(edges):
        return result
    pairs = [
        _split(pyramid_level, chunk, (down, across), overlapping, alike)
        for chunk in torch.split(edges, pieces(device, _BYTES_EACH))
    ]
    far, near = (_concatenated([pair[i] for pair in pairs]) for i in (0, 1))
    dense.data.index_copy_(1, edges, far.data)
    held = flat_nonzero(near.maximum > -torch.inf)
    if not len(held):
        return result
    second_index = torch.full((count,), -1, dtype=torch.int32, device=device)
    second_index[edges.index_select(0, held)] = torch.arange(
        len(held), dtype=torch.int32, device=device
    )
    return result._replace(second=near.select(held), second_index=second_index)


def _dense(
    pyramid_level: PyramidLevel, axes: tuple[AxisHalving, AxisHalving], overlapping: bool
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The coarse pixels of half resolution as if all that is in one were of one surface.

    Returns means [K, n], weights [n], minus the least radius [n], and the greatest one [n].
    """
    H, W = pyramid_level.size
    odd = (axes[0].axis.odd, axes[1].axis.odd)
    first, minimum = pyramid_level.first, pyramid_level.first.minimum
    if pyramid_level.has_second:
        minimum = torch.where(pyramid_level.second_index < 0, minimum, -torch.inf)

    def coarse(values: Tensor, outside: float) -> Tensor:
        return extended(values.reshape(-1, H, W), *axes, outside)

    weighed = first.data[:-2]
    if not pyramid_level.whole:
        weighed = weighed.clone()
        weighed[:-1].mul_(first.weight)
    sums = (pulled if overlapping else halved)(coarse(weighed, 0.0), odd)
    sums = sums.reshape(len(weighed), -1)
    values, weight = sums[:-1], sums[-1]
    values = values / weight.clamp(min=LEAST_WEIGHT)
    limits = _greatest_of(
        coarse(torch.stack([-minimum, first.maximum]), -torch.inf), odd, overlapping
    )
    minimum, maximum = limits.reshape(2, -1).unbind()
    return values, weight.clamp(max=1), minimum, maximum


def least_of(signed_radius: Tensor, middle: tuple[Axis, Axis]) -> Tensor:
    """The least radius [..., h, w] of the pixels [..., H, W] of each coarse pixel."""
    down, across = (
        halves(n, axis) for n, axis in zip(signed_radius.shape[-2:], middle, strict=True)
    )
    nearest = extended(-signed_radius, down, across, -torch.inf)
    return _greatest_of(nearest, (down.axis.odd, across.axis.odd), overlapping=False).neg_()


def _greatest_of(values: Tensor, odd: tuple[bool, bool], overlapping: bool) -> Tensor:
    """The greatest value [..., h, w] of the pixels [..., H, W] with a share in a coarse one."""
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
    """The pixels that have a share in coarse pixel i, counted from 2 i, and their shares."""
    if axis.axis.odd:
        return [(-1, 0.5), (0, 1.0), (1, 0.5)]
    if overlapping:
        return [(-1, 0.25), (0, 0.75), (1, 0.75), (2, 0.25)]
    return [(0, 1.0), (1, 1.0)]


def _split(
    pyramid_level: PyramidLevel,
    coarse: Tensor,
    axes: tuple[AxisHalving, AxisHalving],
    overlapping: bool,
    alike: float,  # range of radii in px that counts as one surface
) -> tuple[CellSurface, CellSurface]:
    """The farthest surface and the next one in coarse pixels [n] of half resolution."""
    row = coarse.div(axes[1].length, rounding_mode="floor")
    column = coarse - row * axes[1].length
    positions, fractions = [], []
    for second_index, axis, length in zip((row, column), axes, pyramid_level.size, strict=True):
        offsets, by = zip(*_taps(axis, overlapping), strict=True)
        first = sent(offsets, coarse) - axis.before
        position = torch.add(first[:, None], second_index, alpha=2)
        inside = position.clamp(0, length - 1)
        fractions.append(sent(by, pyramid_level.first.data)[:, None] * (inside == position))
        positions.append(inside)
    index = torch.add(positions[1], positions[0][:, None], alpha=pyramid_level.size[1]).flatten()
    fraction = (fractions[0][:, None] * fractions[1]).flatten()
    data, count = pyramid_level.first.data.index_select(1, index), len(coarse)
    if pyramid_level.has_second:
        second_index = pyramid_level.second_index.index_select(0, index)
        nearer = pyramid_level.second.data.index_select(1, second_index.clamp(min=0))
        # 0 where a coarse pixel has no second surface
        data, fraction = (
            torch.cat([data, nearer], 1),
            torch.cat([fraction, fraction * (second_index >= 0)]),
        )
    return _two_farthest(data.view(len(data), -1, count), fraction.view(-1, count), alike)


def _every(
    pyramid_level: PyramidLevel, axes: tuple[AxisHalving, AxisHalving], overlapping: bool
) -> tuple[Tensor, Tensor]:
    """What all n coarse pixels of half resolution hold: [K + 3, k, n], and their shares [k, 1]."""
    data = pyramid_level.first.data
    sheets = [data]
    if pyramid_level.has_second:
        index = pyramid_level.second_index
        nearer = pyramid_level.second.data.index_select(1, index.clamp(min=0))
        sheets.append(torch.cat([nearer[:-3], nearer[-3:-2] * (index >= 0), nearer[-2:]]))
    pixels = torch.stack(sheets, 1).view(len(data), len(sheets), *pyramid_level.size)
    missing, shares = list[int](), list[tuple[float, ...]]()
    for axis, length in zip(axes, pyramid_level.size, strict=True):
        offsets, by = zip(*_taps(axis, overlapping), strict=True)
        before = axis.before - offsets[0]
        missing = [before, 2 * axis.length - 2 + len(by) - before - length, *missing]
        shares.append(by)
    held = pad(pixels, missing).unfold(-2, len(shares[0]), 2).unfold(-2, len(shares[1]), 2)
    held = held.movedim((-2, -1), (2, 3))
    count = held.shape[1] * held.shape[2] * held.shape[3]
    fraction = [a * b for a in shares[0] for b in shares[1]] * len(sheets)
    return held.reshape(len(data), count, -1), sent(fraction, data)[:, None]


def _two_farthest(data: Tensor, fraction: Tensor, alike: float) -> tuple[CellSurface, CellSurface]:
    """The farthest surface and the next one in coarse pixels [n].

    `data`: [K + 3, k, n], the surfaces that each holds; `fraction`: [k, n] or [k, 1], their shares.
    """
    values, weight, minimum, maximum = CellSurface(data).parts
    weight = weight * fraction
    remaining, sheets = weight > 0, []
    for number in range(2):
        top = torch.where(remaining, maximum, -torch.inf).amax(0)
        chosen = remaining & (minimum > top - alike)
        if not number:
            remaining = remaining > chosen
        part = weight * chosen
        total = part.sum(0)
        mean = (values * part).sum(1) / total.clamp(min=LEAST_WEIGHT)
        lowest = torch.where(chosen, minimum, torch.inf).amin(0)
        further = total.clamp(max=1)[None], lowest[None], top[None]
        sheets.append(CellSurface(torch.cat([mean, *further])))
    return sheets[0], sheets[1]


def _concatenated(sheets: list[CellSurface]) -> CellSurface:
    """Sheets joined along their coarse pixels."""
    if len(sheets) == 1:
        return sheets[0]
    return CellSurface(torch.cat([sheet.data for sheet in sheets], 1))


def stacked(
    bands: Iterable[tuple[PyramidLevel, int, int]], height: int, axis: Axis
) -> PyramidLevel:
    """A level joined from bands: each a level, its first row that counts and the one after."""
    firsts, seconds, numbers, count = [], [], [], 0
    for level, start, end in bands:
        width = level.size[1]
        rows = slice(start * width, end * width)
        firsts.append(level.first.data[:, rows])
        index = level.second_index[rows]
        kept = flat_nonzero(index >= 0)
        seconds.append(level.second.select(index.index_select(0, kept)))
        number = torch.arange(count, count + len(kept), dtype=torch.int32, device=kept.device)
        numbers.append(torch.full_like(index, -1).index_copy_(0, kept, number))
        count += len(kept)
    return PyramidLevel(
        (height, width),
        CellSurface(torch.cat(firsts, 1)),
        _concatenated(seconds),
        torch.cat(numbers),
        (axis, level.middle[1]),
        level.level,
        level.edges[:0],
    )


# Bytes that a pixel takes while it is looked up.
_BYTES_OF_QUERY = 1 << 10


class HiddenQueries(NamedTuple):
    """Hidden pixels, and the range of radii of the surfaces that are continued to each."""

    at: Tensor  # [n, 2] rows and columns, also between pixels
    border: Tensor  # [n] px, the radius that a surface must exceed
    ceiling: Tensor  # [n] px, the radius that a surface must not reach

    def select(self, index: Tensor) -> HiddenQueries:
        """The pixels of these indices."""
        return HiddenQueries(*(values.index_select(0, index) for values in self))


class SurfaceTable(NamedTuple):
    """The surfaces of some levels, as they are looked up: of all levels one after another."""

    values: Tensor  # [N, K] the first surface of each coarse pixel, then the second ones
    limits: Tensor  # [2, N] their weights and least radii
    second: Tensor  # [m] for each first one the row of the second, or -1
    # [L, 2, 1] of each level: the row and column of pixel 0 of the frame among coarse pixels, those
    # between two pixels, and the last coarse pixel; [L, 1, 1] its width and first row in the table
    origin: Tensor
    step: Tensor
    last: Tensor
    width: Tensor
    start: Tensor

    @classmethod
    def from_levels(cls, levels: Sequence[PyramidLevel], fine: tuple[Axis, Axis]) -> SurfaceTable:
        """The table of levels of a frame; `fine`: where its middle is at full resolution."""
        firsts = [level.first for level in levels]
        like, counts = firsts[0].minimum, [len(first.weight) for first in firsts]
        seconds = [level.second for level in levels]
        before = accumulate((len(second.weight) for second in seconds), initial=sum(counts))
        numbers = [
            torch.where(level.second_index < 0, -1, level.second_index + first)
            if level.has_second
            else level.second_index
            for level, first in zip(levels, before, strict=False)
        ]
        places = []
        for level in levels:  # a place among coarse pixels is affine in the row or column
            for axis, middle, length in zip(fine, level.middle, level.size, strict=True):
                ends = [position_of(pixel, axis, middle, level.level) for pixel in (0.0, 1.0)]
                places.append((ends[0], ends[1] - ends[0], length - 1))
        origin, step, last = sent(places, like).view(-1, 2, 1, 3).unbind(3)
        rows = [level.size[1] for level in levels], [0, *accumulate(counts[:-1])]
        width, start = sent(rows, like.new_empty(0, dtype=torch.long))[..., None, None]
        return cls(
            torch.cat([sheet.values.T for sheet in (*firsts, *seconds)]),
            torch.cat([sheet.data[-3:-1] for sheet in (*firsts, *seconds)], 1),
            torch.cat(numbers),
            *(origin, step, last, width, start),
        )


def nearby(table: SurfaceTable, asked: HiddenQueries, around: float = 0.0) -> tuple[Tensor, Tensor]:
    """The mean of the coarse pixels of each level around each pixel, weighted by distance.

    Of the surfaces that are continued to it alone. `around`: px on each side, in rows and columns,
    of the two places whose mean is asked for. Returns [L, n, K] values times weights, and [L, n]
    weights.
    """
    count = pieces(asked.at.device, _BYTES_OF_QUERY * len(table.origin))
    if len(asked.at) <= count:
        return _nearby(table, asked, around)
    numbers = torch.split(torch.arange(len(asked.at), device=asked.at.device), count)
    parts = [_nearby(table, asked.select(chunk), around) for chunk in numbers]
    values, weights = zip(*parts, strict=True)
    return torch.cat(values, 1), torch.cat(weights, 1)


def _nearby(table: SurfaceTable, asked: HiddenQueries, around: float) -> tuple[Tensor, Tensor]:
    """The same for few pixels at once."""
    border, ceiling = (x.detach()[None, :, None] for x in (asked.border, asked.ceiling))
    position = torch.addcmul(table.origin, table.step, asked.at.T.to(border.dtype))  # [L, 2, n]
    away = around * table.step if around else 0.0
    below = (position - away).floor_()[..., None]
    tap = below + torch.arange(3 if around else 2, device=below.device)  # [L, 2, n, t]
    offset = tap - position[..., None]
    if isinstance(away, Tensor):
        shares = [1 - (offset + sign * away[..., None]).abs_() for sign in (-1, 1)]
        share = (shares[0].clamp_(min=0) + shares[1].clamp_(min=0)) / 2
    else:
        share = 1 - offset.abs_()
    inside = torch.minimum(tap.clamp(min=0), table.last[..., None])
    share = share * (inside == tap)
    row, column = inside.long().unbind(1)  # [L, n, t]
    row = row * table.width + table.start
    number = (row[..., None] + column[..., None, :]).flatten(2)
    share = (share[:, 0, :, :, None] * share[:, 1, :, None]).flatten(2)  # [L, n, t * t]
    if len(table.values) > len(table.second):  # 0 where a coarse pixel has no second surface
        second = table.second.index_select(0, number.flatten()).view(number.shape)
        number = torch.cat([number, second.clamp(min=0)], 2)
        share = torch.cat([share, share * (second >= 0)], 2)
    weight, minimum = table.limits.index_select(1, number.flatten()).view(2, *number.shape)
    minimum = minimum.detach()
    weight = share * weight * ((minimum > border) & (minimum < ceiling))
    bags = number.flatten(0, 1), table.values, weight.flatten(0, 1)
    values = embedding_bag(*bags[:2], mode="sum", per_sample_weights=bags[2])
    weight = weight.sum(2)
    maximum = weight.clamp(min=1)
    return values.view(*weight.shape, -1) / maximum[..., None], weight / maximum

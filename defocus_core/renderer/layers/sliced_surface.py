"""A sliced surface: the slices that each tile needs, and where slices have pixels.

Slices are located by blocks of 16 px. A slice is a plane if all blocks that hold its pixels have
one slope; then its kernel is tilted. Otherwise its pixels times their slopes are blurred, too. The
edge of the frame is continued beyond it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, reduce
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.renderer.layers.layer import SampleLayer
from defocus_core.renderer.layers.slice_radii import membership, slice_before, slice_position
from defocus_core.renderer.layers.slopes import Shifts
from defocus_core.tensors.box import BLOCK, Box, Grid, Span
from defocus_core.tensors.neighbourhoods import flat_nonzero
from defocus_core.tensors.pyramid import Axis, averaged


def _margins(box: Box, around: Box) -> tuple[list[int], list[int]]:
    """Px between a box and a larger one around it: [left, right] and [above, below]."""
    down, across = (
        [side.first - outer.first, outer.end - side.end]
        for side, outer in zip(box.sides, around.sides, strict=True)
    )
    return across, down


def level_beyond(slopes: Tensor, box: Box) -> Tensor:
    """Slopes [2, H, W], x and y, padded to `box`.

    Beyond an edge, the slope along the edge is repeated from it, and the slope across it is 0.
    """
    across, down = _margins(Box(0, 0, *slopes.shape[-2:]), box)
    x = pad(pad(slopes[:1], [0, 0, *down], mode="replicate"), across)
    y = pad(pad(slopes[1:], across, mode="replicate"), [0, 0, *down])
    return torch.cat([x, y])


def visible_slices(blocks: Tensor, reaches: list[int], tiles: list[Box]) -> list[list[int]]:
    """For each tile the indices of the slices whose blur reaches it, nearest first.

    `blocks`: [K, rows, columns] bool on the CPU, from `blocks_of`; `reaches`: blur radius of each
    slice, in px.
    """
    sums = pad(blocks.int().cumsum(1).cumsum(2), (1, 0, 1, 0))
    slices, reach = torch.arange(len(blocks)), torch.tensor(reaches)
    ends = []
    for side, count in zip(
        zip(*(tile.sides for tile in tiles), strict=True), blocks.shape[1:], strict=True
    ):
        first, end = torch.tensor(side)[..., None].unbind(1)
        last = (-((-end - reach) // BLOCK)).clamp(0, count)
        ends.append((((first - reach) // BLOCK).clamp(min=0).minimum(last), last))
    (top, below), (left, beside) = ends  # [tiles, K] each
    inside = sums[slices, below, beside] - sums[slices, top, beside]
    inside += sums[slices, top, left] - sums[slices, below, left]
    return [torch.nonzero(held)[:, 0].tolist() for held in inside]


def blocks_of(
    positions: Tensor, slices: int, present: Tensor | None = None, sharp: int | None = None
) -> Tensor:
    """Which blocks of 16 px hold pixels of each slice: [K, rows, columns] bool.

    `positions`: [H, W], fractional slice indices. If they need gradients, a pixel on a slice is
    also in the slice before, as its share there, 0, has a gradient; `slices`: the number K of
    slices; `present`: [H, W] bool, which pixels exist; None if all do; `sharp`: the slice in focus,
    on which shares have no gradient; None if there is none.
    """
    height, width = positions.shape
    rows, columns = -(-height // BLOCK), -(-width // BLOCK)
    row, column = (
        torch.arange(n, device=positions.device).div(BLOCK, rounding_mode="floor")
        for n in (height, width)
    )
    number = row[:, None] * columns + column
    learn, positions = positions.requires_grad, positions.detach()
    if present is not None:
        index = flat_nonzero(present)
        positions, number = (x.flatten().index_select(0, index) for x in (positions, number))
    occupied = torch.zeros(slices * rows * columns, dtype=torch.bool, device=positions.device)
    for slice_index in _slices_beside(positions, slices, sharp, learn=learn):
        occupied.index_fill_(0, (slice_index * (rows * columns) + number).flatten(), True)
    return occupied.view(slices, rows, columns)


def block_ranges(values: Tensor) -> tuple[Tensor, Tensor]:
    """The least and the greatest of values [..., H, W] in each block of 16 px.

    Returns two tensors [..., rows, columns].
    """
    rest = (0, -values.shape[-1] % BLOCK, 0, -values.shape[-2] % BLOCK)
    padded = pad(values.reshape(-1, *values.shape[-2:]), rest, mode="replicate")
    blocks = padded.unfold(-2, BLOCK, BLOCK).unfold(-2, BLOCK, BLOCK).flatten(-2)
    blocks = blocks.view(*values.shape[:-2], *blocks.shape[-3:])
    return blocks.amin(-1), blocks.amax(-1)


def _slices_beside(
    positions: Tensor, count: int, sharp: int | None, *, learn: bool
) -> tuple[Tensor, Tensor]:
    """The slices before and after each position; they may be the same slice.

    Other arguments are as for `blocks_of`; `learn`: whether positions need gradients.
    """
    before, after = positions.floor(), positions.ceil()
    if learn and torch.is_grad_enabled():
        between = torch.ones_like(positions, dtype=torch.bool)
        if sharp is not None:
            between = positions != sharp
        before = torch.where(between, slice_before(positions), before)
        after = torch.where(between, (before + 1).clamp(max=count - 1), after)
    return before.long(), after.long()


# Slopes in px per px that differ by less are equal: pictures change by less than 2e-6.
_SAME_SLOPE = 1.5e-5


class Planes:
    """The slopes of slices, looked up by blocks of 16 px; a slice has one if it is a plane there.

    Attributes:
        tilted: [rows, columns] bool, the blocks that hold a slope other than 0, on the CPU.
    """

    def __init__(self, slopes: Tensor, blocks: Tensor) -> None:
        """Find the slices that are planes.

        `slopes`: [2, H, W], x and y, px per px; `blocks`: [K, rows, columns] bool, where slices
        are, on the CPU.
        """
        self._lowest, self._highest = (ends.cpu() for ends in block_ranges(slopes))
        self._blocks = blocks
        self.tilted: Tensor = ((self._lowest < 0) | (self._highest > 0)).any(0)
        every, all_blocks = list(range(len(blocks))), slice(None)
        self._everywhere = self._common(every, all_blocks, all_blocks)

    def slopes(self, slice_indices: list[int], box: Box) -> list[tuple[float, float] | None]:
        """The slope (x, y) of each slice within `box`; None for a slice with several slopes."""
        everywhere = [self._everywhere[number] for number in slice_indices]
        if None not in everywhere:
            return everywhere
        rows, columns = (
            slice(max(side.first // BLOCK, 0), -(-side.end // BLOCK)) for side in box.sides
        )
        local = self._common(slice_indices, rows, columns)
        return [common or in_window for common, in_window in zip(everywhere, local, strict=True)]

    def _common(
        self, slice_indices: list[int], rows: slice, columns: slice
    ) -> list[tuple[float, float] | None]:
        """The slope (x, y) of each slice in a rectangle of blocks; None if there are several."""
        lowest, highest = (x[:, rows, columns] for x in (self._lowest, self._highest))
        if not lowest.numel():
            return [None] * len(slice_indices)
        occupied = self._blocks[slice_indices, rows, columns][:, None]
        low = torch.where(occupied, lowest, torch.inf).flatten(2).amin(2)
        high = torch.where(occupied, highest, -torch.inf).flatten(2).amax(2)
        same = (high - low <= _SAME_SLOPE).all(1) & (low < torch.inf).all(1)  # infinite: no block
        middle = ((low + high) / 2).tolist()
        return [(x, y) if one else None for one, (x, y) in zip(same.tolist(), middle, strict=True)]


class SurfaceSamples(NamedTuple):
    """The layers of a surface that are blurred together, with their slopes and shifts."""

    layers: Sequence[SampleLayer]
    slopes: Tensor | None = None  # [2, H, W] of the radius, px per px; None if nothing is tilted
    # Sub-pixel shifts of the colours near focus; None if they are not rendered
    shifts: Shifts | None = None
    # The rectangle, counted from the first pixel, in which the pixels on the edge are repeated,
    # as the frame continues them; None to repeat none
    around: Box | None = None


class _FramedLayer(NamedTuple):
    """A layer with edges repeated up to `SurfaceSamples.around`, and padded with 0 beyond it."""

    light: Tensor  # [C + 1, ..., H, W], premultiplied by coverage, then coverage
    positions: Tensor  # [..., H, W] positions between slice radii
    # [K, rows, columns] bool, the blocks that hold samples of a slice, in any picture
    blocks: Tensor


class SlicedSurface:
    """A surface, and the slices of it that reach each tile of a grid.

    Attributes:
        plan: For each tile the indices of slices that reach it, nearest first.
        tilted_plan: For each tile the indices in `plan` of slices that have slopes.
    """

    def __init__(
        self,
        samples: SurfaceSamples,
        radii: tuple[float, ...],  # signed radius of each slice, in px
        reaches: list[int],  # blur radius of each slice, in px
        grid: Grid,
        before: int,
        beyond: int,
    ) -> None:
        """Plan the slices of a surface.

        `before`: greatest distance in px from the first row or column of a window to its tile;
        `beyond`: the same from the first row or column of a tile to the end of its window.
        """
        radius = samples.layers[0].signed_radius
        size = radius.shape[-2], radius.shape[-1]
        around = samples.around or Box(0, 0, *size)
        # counted from the first sample that is repeated
        self._given = Box(-around.top, -around.left, *size)
        H, W = around[2:]
        first, last = grid.tiles[0], grid.tiles[-1]
        self._tiles, self._own = grid.tiles, Box(0, 0, H, W)
        top, left = min(first.top - before, 0), min(first.left - before, 0)
        below, beside = max(last.top + beyond, H), max(last.left + beyond, W)
        self._framed_box = Box(top, left, below - top, beside - left)
        count = len(reaches)
        sharp = reaches.index(0) if 0 in reaches else None
        self._samples = [
            self._with_frame(layer, slice_position(layer.signed_radius, radii), count, sharp)
            for layer in samples.layers
        ]
        self._positions, self._shifts = self._samples[0].positions, samples.shifts
        self._first = samples.layers[0]
        self._blocks = blocks = reduce(torch.logical_or, [each.blocks for each in self._samples])
        self.plan = visible_slices(blocks, reaches, grid.tiles)
        self.tilted_plan: list[list[int]] = [[] for _ in grid.tiles]
        self._lean, self._planes = samples.slopes, None
        if samples.slopes is not None:
            self._lean = level_beyond(samples.slopes, around)
            planes = Planes(self._lean.detach(), self._blocks)
            self.tilted_plan = visible_slices(blocks & planes.tilted, reaches, grid.tiles)
            if not samples.slopes.requires_grad:
                self._planes = planes
        self._slice_numbers = torch.arange(
            count, dtype=self._positions.dtype, device=self._positions.device
        )

    @cached_property
    def _slopes(self) -> Tensor | None:
        """The slopes, padded with zeros to the frame; only slices that are no planes need them."""
        if self._lean is None:
            return None
        framed = self._lean.new_zeros(*self._lean.shape[:-2], *self._framed_box[2:])
        self._unframed(self._own, framed).copy_(self._lean)
        return framed

    def _with_frame(
        self, layer: SampleLayer, positions: Tensor, count: int, sharp: int | None
    ) -> _FramedLayer:
        """A layer and its positions [..., H, W], padded to the frame.

        `count`: number of slices; `sharp`: the slice in focus, or None.
        """
        light = self._framed(layer.light_and_coverage)
        framed = self._framed([positions[None]])[0]
        inner = self._unframed(self._own, framed)
        exists = self._unframed(self._own, light.detach()[-1] > 0) if layer.sparse else None
        return _FramedLayer(light, framed, blocks_of(inner, count, exists, sharp).cpu())

    def _framed(self, channels: list[Tensor]) -> Tensor:
        """Channels [n, ..., H, W], concatenated, with edges repeated and zeros around them."""
        across, down = _margins(self._given, self._own)
        whole = pad(torch.cat(channels), [*across, *down], mode="replicate")
        across, down = _margins(self._own, self._framed_box)
        return pad(whole, [*across, *down])

    def _unframed(self, box: Box, values: Tensor) -> Tensor:
        """Crop padded values [..., h, w] to a box that is relative to the first sample."""
        return box.seen_from(self._framed_box).crop(values)

    def members(self, slice_indices: range, box: Box) -> Tensor:
        """Slices of one layer in a box: light and coverage [C + 1, k, ..., height, width]."""
        numbers = self._slice_numbers[slice_indices.start : slice_indices.stop]

        first, *others = self._samples
        fractions = membership(self._unframed(box, first.positions), numbers)
        slices = self._unframed(box, first.light)[:, None] * fractions
        for layer in others:
            part = _bounds(layer.blocks[slice_indices.start : slice_indices.stop], box)
            if part is not None:
                fractions = membership(self._unframed(part, layer.positions), numbers)
                light = self._unframed(part, layer.light)[:, None]
                part.seen_from(box).crop(slices).addcmul_(light, fractions)
        return slices

    def fractions(self, slice_indices: range, box: Box) -> Tensor:
        """The share [h, w] of each pixel in all slices of a range together."""
        positions = self._unframed(box, self._positions)
        return membership(
            positions, self._slice_numbers[slice_indices.start : slice_indices.stop]
        ).sum(0)

    @property
    def has_shifts(self) -> bool:
        """Whether sub-pixel shifts are rendered."""
        return self._shifts is not None

    def shifts(self, index: int) -> Tensor:
        """Changes of colour by sub-pixel shifts in tile `index`, for each part: [M, C, h, w]."""
        assert self._shifts is not None
        tile = self._tiles[index].seen_from(self._given)
        return self._shifts.color_change(tile) * tile.crop(self._first.coverage)

    def slopes(self, window: Box) -> Tensor:
        """Slopes [2, height, width], x and y, in a window around a tile with tilted slices."""
        assert self._slopes is not None
        return self._unframed(window, self._slopes)

    def planes(self, slice_indices: list[int], box: Box) -> list[tuple[float, float] | None]:
        """The slope (x, y) of each slice in `box`; None for a slice with several slopes.

        It is None, too, for slopes that need a gradient. The box is relative to the first sample.
        """
        return (
            self._planes.slopes(slice_indices, box) if self._planes else [None] * len(slice_indices)
        )

    def averaged(
        self, slice_index: int, level: int, coarse: Box, middle: tuple[Axis, Axis], *, tilted: bool
    ) -> Tensor:
        """A slice averaged to the coarse pixels of `coarse`: [1 or 3, C + 1, h, w].

        Resolution is halved `level` times. If `tilted`, the slice times its slopes x and y follows.
        `middle`: the middle of the frame, in px.
        """
        kinds = 3 if tilted and self._slopes is not None else 1
        first = self._samples[0].light
        result = first.new_zeros(kinds, *first.shape[:-2], *coarse[2:])
        box = _bounds(self._blocks[[slice_index]], self._own)
        if box is None:
            return result
        pixels = self.members(range(slice_index, slice_index + 1), box)[:, 0][None]
        if tilted and self._slopes is not None:
            pixels = torch.cat([pixels, pixels * self._unframed(box, self._slopes)[:, None]])
        down, across = (
            Axis(axis.middle - start, axis.odd) for axis, start in zip(middle, box[:2], strict=True)
        )
        pixels, (down, across) = averaged(pixels, level, (down, across))
        mean_box = Box(-down.middle, -across.middle, *pixels.shape[-2:])
        overlap = mean_box.grown(0, coarse)
        if overlap.height > 0 and overlap.width > 0:
            overlap.seen_from(coarse).crop(result).add_(overlap.seen_from(mean_box).crop(pixels))
        return result


def _bounds(blocks: Tensor, box: Box) -> Box | None:
    """The rectangle in `box` around the blocks that hold any of k slices; None if none does.

    `blocks`: [k, rows, columns] bool.
    """
    rows, columns = (slice(max(s.first, 0) // BLOCK, -(-s.end // BLOCK)) for s in box.sides)
    held = blocks[:, rows, columns].any(0)
    down, across = held.any(1).tolist(), held.any(0).tolist()
    if not any(down):
        return None
    spans = (
        Span(
            BLOCK * (start.start + which.index(True)),
            BLOCK * (start.start + len(which) - which[::-1].index(True)),
        )
        for start, which in ((rows, down), (columns, across))
    )
    return Box.from_spans(*spans).grown(0, box)

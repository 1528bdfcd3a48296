"""A sliced surface: the slices of a layer that each tile needs."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property, reduce
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.layers.block_index import blocks_at, blocks_of, visible_slices
from defocus_core.renderer.layers.extents import Patch, patches
from defocus_core.renderer.layers.fringe_samples import FringeSamples
from defocus_core.renderer.layers.planar_slices import Planes
from defocus_core.renderer.layers.samples import SurfaceSamples
from defocus_core.renderer.layers.slice_radii import membership
from defocus_core.tensors.box import Box, Span
from defocus_core.tensors.continuing import continue_edges, level_beyond, positions_continued
from defocus_core.tensors.device_plan import pieces
from defocus_core.tensors.pyramid import Axis, averaged
from defocus_core.tensors.tiling import BLOCK, Grid

# Rows of samples averaged at once are a multiple of _BAND, of about _AREA samples: they stay in a
# cache of a CPU. Bytes that a sample takes elsewhere.
_BAND, _AREA, _BYTES_EACH = 64, 1 << 16, 120


class _SampleTensors(NamedTuple):
    """Samples of which no two are of one pixel."""

    layer: Tensor  # [C + 1, ..., H, W] in a frame of zeros, continued around the samples
    positions: Tensor  # [..., H, W] positions between slice radii, in the same frame
    # [K, rows, columns] bool, the blocks that hold samples of a slice, in any picture
    blocks: Tensor


class Surface:
    """A layer of the scene, and its slices that each tile of a grid sees.

    Attributes:
        plan: For each tile the indices of slices that reach it, nearest first.
        tilted_plan: For each tile the indices in `plan` of slices that have slopes.
    """

    def __init__(
        self,
        samples: SurfaceSamples,
        reaches: list[int],  # blur radius of each slice, in px
        layers: list[int],
        grid: Grid,
        before: int,  # greatest distance in px from the first row or column of a window to its tile
        beyond: int,  # greatest distance in px from the first row of a tile to the end of a window
    ) -> None:
        """Plan the slices of a layer."""
        size = samples.positions.shape[-2], samples.positions.shape[-1]
        around = samples.around or Box(0, 0, *size)
        # counted from the first sample that is repeated
        self._given = Box(-around.top, -around.left, *size)
        H, W = around[2:]
        first, last = grid.tiles[0], grid.tiles[-1]
        self._tiles, self._layers, self._own = grid.tiles, layers, Box(0, 0, H, W)
        top, left = min(first.top - before, 0), min(first.left - before, 0)
        below, beside = max(last.top + beyond, H), max(last.left + beyond, W)
        self._framed_box = Box(top, left, below - top, beside - left)
        count = len(reaches)
        whole = samples.coverage is None
        self._sharp = reaches.index(0) if 0 in reaches else None
        visible = self._sample_tensors(self._layer(samples), samples.positions, count, whole=whole)
        others = [
            self._sample_tensors(self._framed([x]), positions, count)
            for x, positions in samples.others
        ]
        self._samples = [visible, *others]
        self._positions, self._shifts = self._samples[0].positions, samples.shifts
        self._coverage = samples.coverage
        blocks = reduce(torch.logical_or, [each.blocks for each in self._samples])
        self._fringe = None
        if len(samples.at):
            at, layer_index = positions_continued(samples.at, size, around)
            extra, positions = (x[layer_index] for x in (samples.extra, samples.extra_positions))
            blocks = blocks | blocks_at(positions, at, count, (H, W), self._sharp).cpu()
            self._fringe = FringeSamples(at, extra, positions, layers, H)
        self.plan = visible_slices(blocks, reaches, grid.tiles)
        self._blocks = blocks
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
        """Slopes of samples in the frame of zeros; only needed by slices that are no planes."""
        if self._lean is None:
            return None
        framed = self._lean.new_zeros(*self._lean.shape[:-2], *self._framed_box[2:])
        self._unframed(self._own, framed).copy_(self._lean)
        return framed

    def _sample_tensors(
        self, layer: Tensor, positions: Tensor, count: int, *, whole: bool = False
    ) -> _SampleTensors:
        """Samples, from a framed layer and their places [H, W]; without coverage none exists."""
        framed = self._framed([positions[None]])[0]
        inner, exists = self._unframed(self._own, framed), None
        if not whole:
            covered = self._unframed(self._own, layer.detach()[-1].bool())
            exists = None if bool(covered.all()) else covered
        return _SampleTensors(layer, framed, blocks_of(inner, count, exists, self._sharp).cpu())

    def _layer(self, samples: SurfaceSamples) -> Tensor:
        """The pixels themselves, colour times coverage and coverage, framed."""
        color, coverage = samples.color, samples.coverage
        if coverage is not None:
            return self._framed([color * coverage, coverage])
        one = torch.ones_like(color[:1, ..., :1, :1]).expand(1, *color.shape[1:])
        return self._framed([color, one])

    def _framed(self, channels: list[Tensor]) -> Tensor:
        """Channels [n, ..., H, W], one after another, continued in a frame of zeros."""
        pictures, size = channels[0].shape[1:-2], self._framed_box[2:]
        framed = channels[0].new_empty(sum(map(len, channels)), *pictures, *size)
        own = self._own.seen_from(self._framed_box)
        for dim, side in zip((-2, -1), own.sides, strict=True):
            framed.narrow(dim, 0, side.first).zero_()
            framed.narrow(dim, side.end, framed.shape[dim] - side.end).zero_()
        given, first = self._unframed(self._given, framed), 0
        for values in channels:
            given[first : first + len(values)].copy_(values)
            first += len(values)
        continue_edges(self._unframed(self._own, framed), self._given)
        return framed

    def _unframed(self, box: Box, values: Tensor) -> Tensor:
        """Cut a rectangle, counted from the first sample, from framed values [..., h, w]."""
        return box.seen_from(self._framed_box).of(values)

    def patches(self, margins: dict[int, int]) -> list[list[Patch | None]]:
        """The patches of layers in each tile; margins are blur radii in px, by number of layer."""
        blocks = [
            self._blocks[
                [
                    slice_index
                    for slice_index, other in enumerate(self._layers)
                    if other == layer_index
                ]
            ]
            for layer_index in margins
        ]
        occupied = torch.stack([each.any(0) for each in blocks])
        return patches(occupied, self._tiles, list(margins.values()), self._own[2:])

    def members(self, slice_indices: range, window: Box, lit: Box) -> Tensor:
        """Slices of one layer within a window, [C + 1, k, ..., height, width]."""
        slices = None
        for each in self._samples_of(slice_indices, lit):
            layer = self._unframed(window, each.layer)[:, None]
            fractions = self._lit_fractions(each.positions, slice_indices, window, lit)
            slices = layer * fractions if slices is None else slices.addcmul_(layer, fractions)
        if slices is None:
            first = self._samples[0].layer
            pictures = first.shape[1:-2]
            slices = first.new_zeros(len(first), len(slice_indices), *pictures, *window[2:])
        if self._fringe:
            self._fringe.add(
                slices, self._layers[slice_indices.start], slice_indices.start, window, lit
            )
        return slices

    def _samples_of(self, slice_indices: range, box: Box) -> list[_SampleTensors]:
        """The samples of slices that have pixels in the blocks of a box, the nearest first."""
        if len(self._samples) == 1:
            return self._samples
        rows, columns = (
            slice(max(span.first, 0) // BLOCK, -(-span.end // BLOCK)) for span in box.sides
        )
        within = slice(slice_indices.start, slice_indices.stop), rows, columns
        return [each for each in self._samples if bool(each.blocks[within].any())]

    def _lit_fractions(
        self, positions: Tensor, slice_indices: range, window: Box, lit: Box
    ) -> Tensor:
        """Shares [k, height, width] of the pixels of a window in slices; 0 after the end of lit."""
        fractions = membership(
            self._unframed(window, positions),
            self._slice_numbers[slice_indices.start : slice_indices.stop],
        )
        limits = lit.seen_from(window).sides
        below, beside = window.height - limits[0].end, window.width - limits[1].end
        if below > 0:
            fractions[..., -below:, :].zero_()
        if beside > 0:
            fractions[..., -beside:].zero_()
        return fractions

    def fractions(self, slice_indices: range, box: Box) -> Tensor:
        """The share [h, w] of each pixel in a range of slices."""
        positions = self._unframed(box, self._positions)
        return membership(
            positions, self._slice_numbers[slice_indices.start : slice_indices.stop]
        ).sum(0)

    def shifts(self, index: int) -> Tensor | None:
        """Sub-pixel shifts of a tile for each aperture part, [M, C, h, w]; None if it has none."""
        tile = self._tiles[index].seen_from(self._given)
        shifts = self._shifts.over(tile) if self._shifts else None
        if shifts is None or self._coverage is None:
            return shifts
        return shifts * tile.of(self._coverage)

    def slopes(self, window: Box) -> Tensor:
        """Slopes [2, height, width] within a window around a tile that has tilted slices."""
        assert self._slopes is not None
        return self._unframed(window, self._slopes)

    def planes(self, slice_indices: list[int], box: Box) -> list[tuple[float, float] | None]:
        """The slopes of slices within a rectangle; None for a slice of several slopes.

        Slopes that need a gradient give None, too. The box is counted from the first sample.
        """
        return (
            self._planes.slopes(slice_indices, box) if self._planes else [None] * len(slice_indices)
        )

    def bounds(self, slice_indices: list[int], within: Box | None = None) -> Box:
        """The rectangle of blocks that hold samples of the given slices.

        `within`: a rectangle whose rows alone are looked at; None for all rows.
        """
        rows = (within or self._own).sides[0]
        first = rows.first // BLOCK
        occupied = self._blocks[slice_indices, first : -(-rows.end // BLOCK)].any(0)
        down, across = (torch.nonzero(occupied.any(dim))[:, 0].tolist() for dim in (1, 0))
        if not down:
            return Box(0, 0, 0, 0)
        spans = Span(first + down[0], first + down[-1] + 1), Span(across[0], across[-1] + 1)
        held = (Span(BLOCK * span.first, BLOCK * span.end) for span in spans)
        return Box.over(*held).grown(0, self._own)

    def averaged(
        self,
        slice_index: int,
        level: int,
        coarse: Box,
        middle: tuple[Axis, Axis],
        *,
        tilted: bool,
    ) -> Tensor:
        """A slice at reduced resolution; if tilted also times its slopes: [1 or 3, C + 1, h, w]."""
        kinds = 3 if tilted and self._slopes is not None else 1
        first = self._samples[0].layer
        result = first.new_zeros(kinds, *first.shape[:-2], *coarse[2:])
        for band in self._bands(slice_index, 1 << level, middle):
            pixels = self._slice(slice_index, band)[None]
            if tilted and self._slopes is not None:
                slopes = self._unframed(band, self._slopes)
                pixels = torch.cat([pixels, pixels * slopes[:, None]])
            down, across = (
                Axis(axis.middle - start, axis.odd)
                for axis, start in zip(middle, band[:2], strict=True)
            )
            pixels, (down, across) = averaged(pixels, level, (down, across))
            mean_box = Box(-down.middle, -across.middle, *pixels.shape[-2:])
            overlap = mean_box.grown(0, coarse)
            if overlap.height > 0 and overlap.width > 0:
                overlap.seen_from(coarse).of(result).add_(overlap.seen_from(mean_box).of(pixels))
        if self._fringe:
            layer_index = self._layers[slice_index]
            self._fringe.averaged(result[0], layer_index, slice_index, 1 << level, coarse, middle)
        return result

    def _slice(self, slice_index: int, box: Box) -> Tensor:
        """The pixels [C + 1, h, w] of a slice in a box, without fringe."""
        layer, *others = (
            self._unframed(box, each.layer)
            * membership(
                self._unframed(box, each.positions),
                self._slice_numbers[slice_index : slice_index + 1],
            )
            for each in self._samples
        )
        return sum(others, layer)

    def _bands(self, slice_index: int, step: int, middle: tuple[Axis, Axis]) -> Iterator[Box]:
        """Rectangles that cover a slice once; they begin multiples of `step` from the middle."""
        bounds, width = self.bounds([slice_index]), self._own.width
        area = pieces(self._positions.device, _AREA, _BYTES_EACH)
        rows = max(step, area // max(bounds.width, 1) // _BAND * _BAND, _BAND)
        whole = _aligned(bounds, rows, middle)
        for top in range(whole.top, whole.top + whole.height, rows):
            band = Box(top, 0, rows, width).grown(0, self._own)
            extent = self.bounds([slice_index], band)
            if extent.width:
                aligned = _aligned(extent._replace(top=band.top, height=0), step, middle)
                yield band._replace(left=aligned.left, width=aligned.width).grown(0, self._own)


def _aligned(box: Box, step: int, middle: tuple[Axis, Axis]) -> Box:
    """The least rectangle around a box whose sides are multiples of `step` from the middle."""
    limits = [
        (
            axis.middle + (start - axis.middle) // step * step,
            axis.middle - (axis.middle - start - length) // step * step,
        )
        for start, length, axis in zip(box[:2], box[2:], middle, strict=True)
    ]
    (top, below), (left, beside) = limits
    return Box(top, left, below - top, beside - left)

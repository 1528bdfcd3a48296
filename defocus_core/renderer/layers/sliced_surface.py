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
from defocus_core.renderer.layers.ladder import membership
from defocus_core.renderer.layers.planar_slices import Planes
from defocus_core.renderer.layers.samples import SurfaceSamples
from defocus_core.tensors.box import Box, Span
from defocus_core.tensors.continuing import continue_edges, level_beyond, places_continued
from defocus_core.tensors.device_plan import pieces
from defocus_core.tensors.pyramid import Axis, averaged
from defocus_core.tensors.tiling import BLOCK, Grid

# Rows of samples averaged at once are a multiple of _BAND, of about _AREA samples: they stay in a
# cache of a CPU. Bytes that a sample takes elsewhere.
_BAND, _AREA, _BYTES_EACH = 64, 1 << 16, 120


class _SampleSheet(NamedTuple):
    """Samples of which no two are of one pixel.

    Attributes:
        layer: [C + 1, H, W] in a frame of zeros, continued around the samples.
        places: [H, W] positions on the ladder, in the same frame.
        blocks: [K, rows, columns] bool, the blocks that hold samples of a slice.
    """

    layer: Tensor
    places: Tensor
    blocks: Tensor


class Surface:
    """A layer of the scene, and its slices that each tile of a grid sees.

    Attributes:
        plan: For each tile the rungs whose slices reach it, nearest first.
        tilted_plan: For each tile the rungs in `plan` whose slices have slopes.
    """

    def __init__(
        self,
        samples: SurfaceSamples,
        reaches: list[int],
        layers: list[int],
        grid: Grid,
        before: int,
        beyond: int,
    ) -> None:
        """Plan the slices of a layer.

        Args:
            samples: The layer.
            reaches: Blur radius of each rung, in px.
            layers: For each rung the number of its layer.
            grid: The tiles, counted from the first sample.
            before: Greatest distance in px from the first row or column of a window to its tile.
            beyond: Greatest distance in px from the first row of a tile to the end of a window.
        """
        size = samples.places.shape[0], samples.places.shape[1]
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
        own = self._sheet(self._layer(samples), samples.places, count, whole=whole)
        others = [self._sheet(self._framed([x]), places, count) for x, places in samples.others]
        self._sheets = [own, *others]
        self._places, self._shifts = self._sheets[0].places, samples.shifts
        self._coverage = samples.coverage
        blocks = reduce(torch.logical_or, [sheet.blocks for sheet in self._sheets])
        self._fringe = None
        if len(samples.at):
            at, number = places_continued(samples.at, size, around)
            extra, places = (x[number] for x in (samples.extra, samples.extra_places))
            blocks = blocks | blocks_at(places, at, count, (H, W)).cpu()
            self._fringe = FringeSamples(at, extra, places, layers, H)
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
        self._ladder = torch.arange(count, dtype=self._places.dtype, device=self._places.device)

    @cached_property
    def _slopes(self) -> Tensor | None:
        """Slopes of samples in the frame of zeros; only needed by slices that are no planes."""
        if self._lean is None:
            return None
        framed = self._lean.new_zeros(2, *self._framed_box[2:])
        self._unframed(self._own, framed).copy_(self._lean)
        return framed

    def _sheet(
        self, layer: Tensor, places: Tensor, count: int, *, whole: bool = False
    ) -> _SampleSheet:
        """Samples, from a framed layer and their places [H, W]; without coverage none exists."""
        framed = self._framed([places[None]])[0]
        own, exists = self._unframed(self._own, framed), None
        if not whole:
            covered = self._unframed(self._own, layer.detach()[-1].bool())
            exists = None if bool(covered.all()) else covered
        return _SampleSheet(layer, framed, blocks_of(own, count, exists).cpu())

    def _layer(self, samples: SurfaceSamples) -> Tensor:
        """The pixels themselves, colour times coverage and coverage, framed."""
        color, coverage = samples.color, samples.coverage
        if coverage is not None:
            return self._framed([color * coverage, coverage])
        return self._framed([color, torch.ones_like(color[:1, :1, :1]).expand(1, *color.shape[1:])])

    def _framed(self, channels: list[Tensor]) -> Tensor:
        """Channels [..., H, W], one after another, continued in a frame of zeros."""
        framed = channels[0].new_zeros(sum(map(len, channels)), *self._framed_box[2:])
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
            self._blocks[[rung for rung, other in enumerate(self._layers) if other == number]]
            for number in margins
        ]
        occupied = torch.stack([each.any(0) for each in blocks])
        return patches(occupied, self._tiles, list(margins.values()), self._own[2:])

    def members(self, rungs: range, window: Box, lit: Box) -> Tensor:
        """Slices of one layer within a window, [C + 1, k, height, width].

        Args:
            rungs: Their numbers on the ladder.
            window: Counted from the first sample.
            lit: The rectangle of the window that is not zero. It begins at the first row and column
                of the layer or of the window; samples after its end are set to 0.
        """
        slices = None
        for sheet in self._sheets_of(rungs, lit):
            layer = self._unframed(window, sheet.layer)[:, None]
            shares = self._lit_shares(sheet.places, rungs, window, lit)
            slices = layer * shares if slices is None else slices.addcmul_(layer, shares)
        if slices is None:
            first = self._sheets[0].layer
            slices = first.new_zeros(len(first), len(rungs), window.height, window.width)
        if self._fringe:
            self._fringe.add(slices, self._layers[rungs.start], rungs.start, window, lit)
        return slices

    def _sheets_of(self, rungs: range, box: Box) -> list[_SampleSheet]:
        """The sheets that have pixels of slices in the blocks of a box, the nearest first."""
        if len(self._sheets) == 1:
            return self._sheets
        rows, columns = (
            slice(max(span.first, 0) // BLOCK, -(-span.end // BLOCK)) for span in box.sides
        )
        within = slice(rungs.start, rungs.stop), rows, columns
        return [sheet for sheet in self._sheets if bool(sheet.blocks[within].any())]

    def _lit_shares(self, places: Tensor, rungs: range, window: Box, lit: Box) -> Tensor:
        """Shares [k, height, width] of the pixels of a window in slices; 0 after the end of lit."""
        shares = membership(self._unframed(window, places), self._ladder[rungs.start : rungs.stop])
        ends = lit.seen_from(window).sides
        below, beside = window.height - ends[0].end, window.width - ends[1].end
        if below > 0:
            shares[:, -below:].zero_()
        if beside > 0:
            shares[..., -beside:].zero_()
        return shares

    def shares(self, rungs: range, box: Box) -> Tensor:
        """The share [h, w] of each pixel in a range of slices."""
        places = self._unframed(box, self._places)
        return membership(places, self._ladder[rungs.start : rungs.stop]).sum(0)

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

    def planes(self, rungs: list[int], box: Box) -> list[tuple[float, float] | None]:
        """The slopes of slices within a rectangle; None for a slice of several slopes.

        Slopes that need a gradient give None, too. The box is counted from the first sample.
        """
        return self._planes.slopes(rungs, box) if self._planes else [None] * len(rungs)

    def bounds(self, rungs: list[int], within: Box | None = None) -> Box:
        """The rectangle of blocks that hold samples of the given slices.

        Args:
            rungs: Numbers of the slices.
            within: A rectangle whose rows alone are looked at; None for all rows.
        """
        rows = (within or self._own).sides[0]
        first = rows.first // BLOCK
        occupied = self._blocks[rungs, first : -(-rows.end // BLOCK)].any(0)
        down, across = (torch.nonzero(occupied.any(dim))[:, 0].tolist() for dim in (1, 0))
        if not down:
            return Box(0, 0, 0, 0)
        spans = Span(first + down[0], first + down[-1] + 1), Span(across[0], across[-1] + 1)
        held = (Span(BLOCK * span.first, BLOCK * span.end) for span in spans)
        return Box.over(*held).grown(0, self._own)

    def averaged(
        self,
        rung: int,
        halvings: int,
        cells: Box,
        middle: tuple[Axis, Axis],
        *,
        tilted: bool,
    ) -> Tensor:
        """A slice at reduced resolution; if tilted also times its slopes: [1 or 3, C + 1, h, w].

        Args:
            rung: Its number on the ladder.
            halvings: How many times resolution is halved.
            cells: The rectangle to return, in cells of that resolution, counted from the first at
                or after the middle of the frame.
            middle: The middle of the frame, counted from the first sample.
            tilted: Whether the slice has slopes.
        """
        kinds = 3 if tilted and self._slopes is not None else 1
        first = self._sheets[0].layer
        result = first.new_zeros(kinds, len(first), *cells[2:])
        for band in self._bands(rung, 1 << halvings, middle):
            pixels = self._slice(rung, band)[None]
            if tilted and self._slopes is not None:
                slopes = self._unframed(band, self._slopes)
                pixels = torch.cat([pixels, pixels * slopes[:, None]])
            down, across = (
                Axis(axis.middle - start, axis.odd)
                for axis, start in zip(middle, band[:2], strict=True)
            )
            pixels, (down, across) = averaged(pixels, halvings, (down, across))
            mean_box = Box(-down.middle, -across.middle, *pixels.shape[-2:])
            overlap = mean_box.grown(0, cells)
            if overlap.height > 0 and overlap.width > 0:
                overlap.seen_from(cells).of(result).add_(overlap.seen_from(mean_box).of(pixels))
        if self._fringe:
            number = self._layers[rung]
            self._fringe.averaged(result[0], number, rung, 1 << halvings, cells, middle)
        return result

    def _slice(self, rung: int, box: Box) -> Tensor:
        """The pixels [C + 1, h, w] of a slice in a box, without fringe."""
        layer, *others = (
            self._unframed(box, sheet.layer)
            * membership(self._unframed(box, sheet.places), self._ladder[rung : rung + 1])
            for sheet in self._sheets
        )
        return sum(others, layer)

    def _bands(self, rung: int, step: int, middle: tuple[Axis, Axis]) -> Iterator[Box]:
        """Rectangles that cover a slice once; they begin multiples of `step` from the middle."""
        bounds, width = self.bounds([rung]), self._own.width
        area = pieces(self._places.device, _AREA, _BYTES_EACH)
        rows = max(step, area // max(bounds.width, 1) // _BAND * _BAND, _BAND)
        whole = _aligned(bounds, rows, middle)
        for top in range(whole.top, whole.top + whole.height, rows):
            band = Box(top, 0, rows, width).grown(0, self._own)
            extent = self.bounds([rung], band)
            if extent.width:
                aligned = _aligned(extent._replace(top=band.top, height=0), step, middle)
                yield band._replace(left=aligned.left, width=aligned.width).grown(0, self._own)


def _aligned(box: Box, step: int, middle: tuple[Axis, Axis]) -> Box:
    """The least rectangle around a box whose sides are multiples of `step` from the middle."""
    ends = [
        (
            axis.middle + (start - axis.middle) // step * step,
            axis.middle - (axis.middle - start - length) // step * step,
        )
        for start, length, axis in zip(box[:2], box[2:], middle, strict=True)
    ]
    (top, below), (left, beside) = ends
    return Box(top, left, below - top, beside - left)

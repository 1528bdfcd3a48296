"""A layer of the scene, cut into slices as they are needed: what each tile takes of it."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.halving import Axis, extended, halved, halves
from defocus_core.slicing import membership
from defocus_core.slopes import Planes
from defocus_core.tiling import BLOCK, Box, Grid, blocks_at, blocks_of, visible_slices

# Samples on a side of the blocks by which points are found.
_BLOCK = 32


class Samples(NamedTuple):
    """A layer of the scene as samples with positions on the ladder of slices.

    Attributes:
        layer: [C + 1, H, W], premultiplied, the last channel coverage.
        places: [H, W] positions.
        at: [n, 2] rows and columns of further samples.
        extra: [n, C + 1] further samples: parts of nearer surfaces in the same pixels.
        extra_places: [n] their positions.
        slopes: [2, H, W] of the radius, px per px; None where no surface is tilted.
    """

    layer: Tensor
    places: Tensor
    at: Tensor
    extra: Tensor
    extra_places: Tensor
    slopes: Tensor | None


class Surface:
    """A layer of the scene, and what of it each tile of a grid can see.

    Attributes:
        plan: For each tile the rungs that reach it, nearest first.
        tilted_plan: Those of them that have slopes there.
    """

    def __init__(
        self, samples: Samples, reaches: list[int], grid: Grid, before: int, beyond: int
    ) -> None:
        """Plan the slices of a layer.

        Args:
            samples: The layer.
            reaches: Px that each rung spreads.
            grid: The tiles, counted from the first sample.
            before: Px that windows extend above and to the left of tiles at most.
            beyond: Px that windows extend from there downwards and to the right at most.
        """
        self._tiles = grid.tiles
        self._rungs = count = len(reaches)
        H, W = samples.places.shape
        first, last = grid.tiles[0], grid.tiles[-1]
        self._framed_box = Box(
            first.top - before,
            first.left - before,
            last.top - first.top + before + beyond,
            last.left - first.left + before + beyond,
        )
        exists = samples.layer[-1].detach() > 0
        blocks = blocks_of(samples.places, count, None if bool(exists.all()) else exists)
        if len(samples.at):
            blocks |= blocks_at(samples.extra_places, samples.at, count, (H, W))
        self.plan = visible_slices(blocks, reaches, grid.tiles)
        self._samples, self._blocks = samples, blocks
        self.tilted_plan: list[list[int]] = [[] for _ in grid.tiles]
        self._slopes, self._planes = None, None
        if samples.slopes is not None:
            tilted = blocks_of(samples.places, count, samples.slopes.detach().any(0))
            self.tilted_plan = visible_slices(tilted, reaches, grid.tiles)
            self._slopes = self._framed(samples.slopes)
            if not samples.slopes.requires_grad:
                self._planes = Planes(samples.slopes, self._blocks)
        self._layer = self._framed(samples.layer)
        self._places = self._framed(samples.places)
        self._extra = _Points(samples)

    def _framed(self, values: Tensor) -> Tensor:
        """Values [..., H, W] in a frame of zeros in which every window lies."""
        box = self._framed_box
        framed = values.new_zeros(*values.shape[:-2], *box[2:])
        some = box.grown(0, Box(0, 0, *values.shape[-2:]))
        if some.height > 0 and some.width > 0:
            some.seen_from(box).of(framed).copy_(some.of(values))
        return framed

    def members(self, index: int, margin: int, size: tuple[int, int], rungs: list[int]) -> Tensor:
        """Slices within a window around a tile, [k, C + 1, height, width].

        Args:
            index: Of the tile.
            margin: Px of the window above and to the left of the tile.
            size: (height, width) of the window.
            rungs: Their numbers on the ladder.
        """
        corner, window = self._window(index, margin, size)
        numbers = torch.tensor(rungs, dtype=self._places.dtype, device=self._places.device)
        shares = membership(window.of(self._places), numbers)
        pixels = window.of(self._layer) * shares[:, None]
        return self._extra.added(pixels, corner, rungs, self._rungs)

    def slopes(self, index: int, margin: int, size: tuple[int, int]) -> Tensor:
        """[2, height, width] within a window around a tile that has tilted slices."""
        assert self._slopes is not None
        return self._window(index, margin, size)[1].of(self._slopes)

    def plane(self, rung: int, box: Box) -> tuple[float, float] | None:
        """The slope of a slice within a rectangle, if it is the same all over and no gradient.

        Counted from the first sample.
        """
        return self._planes.slope(rung, box) if self._planes else None

    def bounds(self, rungs: list[int]) -> Box:
        """A rectangle that holds all samples of some slices."""
        return _bounds(self._blocks[rungs].any(0), self._samples.places.shape)

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
            cells: What is wanted, in pixels of that resolution, counted from the first at or
                after the middle of the frame.
            middle: Of the frame, counted from the first sample.
            tilted: Whether it has slopes.
        """
        layer, places, slopes = self._samples.layer, self._samples.places, self._samples.slopes
        some = _bounds(self._blocks[rung], places.shape)
        share = (1 - (some.of(places) - rung).abs_()).clamp_(min=0)
        pixels = (some.of(layer) * share)[None]
        if tilted and slopes is not None:
            pixels = torch.cat([pixels, pixels * some.of(slopes)[:, None]])
        down, across = (
            Axis(axis.middle - start, axis.odd)
            for axis, start in zip(middle, some[:2], strict=True)
        )
        for _ in range(halvings):
            y, x = halves(pixels.shape[-2], down), halves(pixels.shape[-1], across)
            pixels = halved(extended(pixels, y, x, 0.0), (down.odd, across.odd)) / 4
            down, across = y.axis, x.axis
        found = Box(-down.middle, -across.middle, *pixels.shape[-2:])
        here = found.grown(0, cells)
        result = pixels.new_zeros(*pixels.shape[:2], *cells[2:])
        if here.height > 0 and here.width > 0:
            here.seen_from(cells).of(result).copy_(here.seen_from(found).of(pixels))
        self._extra.averaged(result[0], rung, 1 << halvings, cells, middle)
        return result

    def _window(
        self, index: int, margin: int, size: tuple[int, int]
    ) -> tuple[tuple[int, int], Box]:
        """The corner of a window, counted from the first sample, and the window in the frame."""
        tile = self._tiles[index]
        y, x = tile.top - margin, tile.left - margin
        return (y, x), Box(y, x, *size).seen_from(self._framed_box)


def _bounds(blocks: Tensor, size: torch.Size) -> Box:
    """The rectangle of a frame that holds all blocks [rows, columns] that are true."""
    ends = []
    for dim, length in enumerate(size):
        some = torch.nonzero(blocks.any(1 - dim))[:, 0]
        first, last = (int(some[0]), int(some[-1]) + 1) if len(some) else (0, 0)
        ends.append((first * BLOCK, min(last * BLOCK, length)))
    (top, below), (left, beside) = ends
    return Box(top, left, below - top, beside - left)


class _Points:
    """The further samples of a layer, sorted by blocks."""

    def __init__(self, samples: Samples) -> None:
        self._at, self._layer, self._places = samples.at, samples.extra, samples.extra_places
        rows, columns = (-(-n // _BLOCK) for n in samples.places.shape)
        self._rows, self._columns = rows, columns
        block = self._at.div(_BLOCK, rounding_mode="floor")
        block = block[:, 0] * columns + block[:, 1]
        self._order = block.argsort(stable=True)
        counts = torch.bincount(block, minlength=rows * columns)
        self._starts = [0, *counts.cumsum(0).tolist()]

    def _near(self, corner: tuple[int, int], size: tuple[int, int]) -> Tensor:
        """Indices of the points in the blocks that a window touches."""
        above, first = (max(n // _BLOCK, 0) for n in corner)
        below = min((corner[0] + size[0] - 1) // _BLOCK + 1, self._rows)
        last = min((corner[1] + size[1] - 1) // _BLOCK + 1, self._columns)
        starts = [y * self._columns for y in range(above, below)]
        return torch.cat(
            [self._order[self._starts[s + first] : self._starts[s + last]] for s in starts]
        )

    def added(
        self,
        pixels: Tensor,
        corner: tuple[int, int],
        rungs: list[int],
        count: int,
    ) -> Tensor:
        """Slices [k, C + 1, height, width] of a window with the points that lie in it.

        Args:
            pixels: Without; overwritten.
            corner: First row and column of the window.
            rungs: Of the slices.
            count: Rungs in all.
        """
        if self._starts[-1] == 0:
            return pixels
        channels, height, width = pixels.shape[1:]
        near = self._near(corner, (height, width))
        if not len(near):
            return pixels
        y = self._at[near, 0] - corner[0]
        x = self._at[near, 1] - corner[1]
        inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        layer = self._layer.index_select(0, near) * inside[:, None]
        places = self._places.index_select(0, near)
        spot = torch.where(inside, y * width + x, 0)[:, None]
        channel = torch.arange(channels, device=pixels.device) * (height * width)
        slots = torch.full((count + 1,), -1, device=pixels.device)
        slots[rungs] = torch.arange(len(rungs), device=pixels.device)
        lower = places.detach().floor()
        flat = pixels.view(-1)
        for rung in (lower, lower + 1):
            slot = slots[rung.long()][:, None]
            share = (1 - (places - rung).abs())[:, None] * (slot >= 0)
            target = slot.clamp(min=0) * (channels * height * width) + channel + spot
            flat.index_add_(0, target.flatten(), (layer * share).flatten())
        return pixels

    def averaged(
        self, pixels: Tensor, rung: int, step: int, cells: Box, middle: tuple[Axis, Axis]
    ) -> None:
        """Add the points of a slice to it at reduced resolution.

        Args:
            pixels: [C + 1, height, width] without; changed.
            rung: Of the slice.
            step: Px between cells.
            cells: What the pixels are, counted from the first at or after the middle of the frame.
            middle: Of the frame, counted from the first sample.
        """
        share = 1 - (self._places - rung).abs()
        here = torch.nonzero(share.detach() > 0)[:, 0]
        if not len(here):
            return
        layer = self._layer[here] * share[here, None] / step**2
        sides = []  # of each axis the cells that have shares in a pixel, and the shares
        for dim, (axis, start) in enumerate(zip(middle, cells[:2], strict=True)):
            offset = self._at[here, dim] - axis.middle
            lower = offset.div(step, rounding_mode="floor")
            upper = (offset - lower * step).to(layer.dtype) / step
            sides.append(
                [(lower - start, 1 - upper), (lower + 1 - start, upper)]
                if axis.odd
                else [(lower - start, torch.ones_like(upper))]
            )
        for y, of_row in sides[0]:
            for x, of_column in sides[1]:
                inside = (y >= 0) & (y < cells.height) & (x >= 0) & (x < cells.width)
                some = layer * (of_row * of_column * inside)[:, None]
                spot = torch.where(inside, y * cells.width + x, 0)
                pixels.view(len(pixels), -1).index_add_(1, spot, some.T)

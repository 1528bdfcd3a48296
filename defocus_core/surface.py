"""A layer of the scene, cut into slices as they are needed: what each tile takes of it."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.mixed import Fringe
from defocus_core.slicing import membership, position
from defocus_core.tiling import Tile, blocks_at, blocks_of, visible_slices


class Ladder(NamedTuple):
    """The slices of a surface.

    Attributes:
        radii: Of all slices of the frame.
        reaches: Px that each spreads.
        stride: The surface uses every slice (1) or every other (2).
    """

    radii: tuple[float, ...]
    reaches: list[int]
    stride: int = 1


class Margins(NamedTuple):
    """Px by which a frame is enlarged, so that every window lies within."""

    before: int
    beside: int
    below: int


class Surface:
    """Pixels with colour, coverage and radius, and what of them each tile of a grid can see.

    Attributes:
        plan: For each tile the indices of the slices that reach it, nearest first.
        tilted_plan: Those of them that have slopes there.
    """

    def __init__(
        self,
        layer: Tensor,
        signed_radius: Tensor,
        ladder: Ladder,
        grid: list[Tile],
        margins: Margins,
        *,
        mask: Tensor | None = None,
        fringe: Fringe | None = None,
        slopes: Tensor | None = None,
    ) -> None:
        """Slice a layer.

        Args:
            layer: [C + 1, H, W], premultiplied, the last channel coverage.
            signed_radius: [H, W] px.
            ladder: The slices.
            grid: The tiles.
            margins: Around the frame.
            mask: [H, W] bool, which pixels exist; None if all do.
            fringe: Further samples.
            slopes: [2, H, W], 0 where they are to be neglected; None if everywhere.
        """
        before, beside, below = margins
        frame = (before, beside, before, below)
        self._margin = before
        self._stride = ladder.stride
        radii, reaches = ladder.radii[:: ladder.stride], ladder.reaches[:: ladder.stride]
        places = position(signed_radius, radii)
        blocks = blocks_of(places, len(radii), mask)
        self._fringe = None
        if fringe is not None and len(fringe.at):
            self._fringe = _Points(fringe, radii, grid, before)
            size = (places.shape[0], places.shape[1])
            blocks |= blocks_at(self._fringe.places, fringe.at, len(radii), size)
        self.plan = self._strided(visible_slices(blocks, reaches, grid))
        self.tilted_plan: list[list[int]] = [[] for _ in grid]
        self._slopes = None
        if slopes is not None and bool(slopes.any()):
            tilted = blocks_of(places, len(radii), slopes.detach().any(0))
            self.tilted_plan = self._strided(visible_slices(tilted, reaches, grid))
            self._slopes = pad(slopes, frame)
        self._layer = pad(layer if mask is None else layer * mask, frame)
        self._places = pad(places, frame)

    def _strided(self, plan: list[list[int]]) -> list[list[int]]:
        return [[k * self._stride for k in slices] for slices in plan]

    def members(
        self, index: int, box: Tile, margin: int, size: tuple[int, int], slices: list[int]
    ) -> Tensor:
        """Slices within a window around a tile, [k, C + 1, height, width].

        Args:
            index: Of the tile.
            box: The tile.
            margin: Px of the window above and to the left of the tile.
            size: (height, width) of the window.
            slices: Their indices.
        """
        rungs = [k // self._stride for k in slices]
        rows, columns = self._window(box, margin, size)
        numbers = torch.tensor(rungs, dtype=self._places.dtype, device=self._places.device)
        shares = membership(self._places[rows, columns], numbers)
        pixels = self._layer[:, rows, columns] * shares[:, None]
        if self._fringe is None:
            return pixels
        return self._fringe.added(pixels, index, box, margin, rungs)

    def empty(self, parts: int, box: Tile) -> Tensor:
        """Nothing seen yet: zeros [M, C + 1, h, w] of a tile."""
        return self._layer.new_zeros(parts, len(self._layer), box.height, box.width)

    def slopes(self, box: Tile, margin: int, size: tuple[int, int]) -> Tensor:
        """[2, height, width] within a window around a tile that has tilted slices."""
        assert self._slopes is not None
        rows, columns = self._window(box, margin, size)
        return self._slopes[:, rows, columns]

    def _window(self, box: Tile, margin: int, size: tuple[int, int]) -> tuple[slice, slice]:
        top, left = box.top + self._margin - margin, box.left + self._margin - margin
        return slice(top, top + size[0]), slice(left, left + size[1])


class _Points:
    """Samples of a fringe, sorted by tile."""

    def __init__(
        self, fringe: Fringe, radii: tuple[float, ...], grid: list[Tile], margin: int
    ) -> None:
        self.places = position(fringe.signed_radius, radii)
        self._rungs = len(radii)
        self._at = fringe.at
        self._layer = fringe.layer
        self._columns = sum(1 for box in grid if box.top == 0)
        height, width = grid[0].height, grid[0].width
        self._around = -(-margin // min(height, width))
        tile = fringe.at[:, 0] // height * self._columns + fringe.at[:, 1] // width
        self._order = tile.argsort(stable=True)
        counts = torch.bincount(tile, minlength=len(grid))
        self._starts = [0, *counts.cumsum(0).tolist()]

    def _near(self, index: int) -> Tensor:
        """Indices of the points in the tiles around a tile."""
        row, column = divmod(index, self._columns)
        rows = (len(self._starts) - 1) // self._columns
        first, last = max(column - self._around, 0), min(column + self._around + 1, self._columns)
        above, below = max(row - self._around, 0), min(row + self._around + 1, rows)
        starts = [y * self._columns for y in range(above, below)]
        return torch.cat(
            [self._order[self._starts[s + first] : self._starts[s + last]] for s in starts]
        )

    def added(self, pixels: Tensor, index: int, box: Tile, margin: int, rungs: list[int]) -> Tensor:
        """Slices [k, C + 1, height, width] of a window with the points of the fringe in it."""
        near = self._near(index)
        if not len(near):
            return pixels
        channels, height, width = pixels.shape[1:]
        y = self._at[near, 0] - (box.top - margin)
        x = self._at[near, 1] - (box.left - margin)
        inside = (y >= 0) & (y < box.height + 2 * margin) & (x >= 0) & (x < box.width + 2 * margin)
        layer, places = self._layer[near] * inside[:, None], self.places[near]
        spot = torch.where(inside, y * width + x, 0)[:, None]
        channel = torch.arange(channels, device=pixels.device) * (height * width)
        slots = torch.full((self._rungs + 1,), -1, device=pixels.device)
        slots[rungs] = torch.arange(len(rungs), device=pixels.device)
        lower = places.detach().floor()
        flat = pixels.flatten()
        for rung in (lower, lower + 1):
            slot = slots[rung.long()][:, None]
            share = (1 - (places - rung).abs())[:, None] * (slot >= 0)
            target = slot.clamp(min=0) * (channels * height * width) + channel + spot
            flat = flat.index_add(0, target.flatten(), (layer * share).flatten())
        return flat.reshape(pixels.shape)

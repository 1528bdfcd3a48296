"""The fill of hidden surfaces: blurred, and composited where visible ones leave a gap.

What was invented is no sharper than what it was continued from: half of the resolution will do for
it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce

import torch
from torch import Tensor

from defocus_core.blur.kernel_bank import Window
from defocus_core.blur.layer_blur import Blur, Shown, Sliced
from defocus_core.compositing.saturating_sum import add_behind, summed
from defocus_core.engine.frame import FillSlices, Frame
from defocus_core.images.box import Box
from defocus_core.images.pyramid import axes, halves, place_of
from defocus_core.images.resampling import Shares, cells_read, linear_shares, resampled
from defocus_core.images.sparse_masks import numbers_of
from defocus_core.images.tiling import Grid
from defocus_core.inpainting.hidden_layers import HiddenLayer
from defocus_core.layers.ladder import position
from defocus_core.layers.sliced_surface import Samples


class Hidden:
    """What each group of m parts sees of a hidden surface over a tile."""

    def __init__(
        self, octaves: list[dict[int, Tensor]], enlarged: Callable[[Tensor], Tensor]
    ) -> None:
        """Keep what may be asked for.

        Args:
            octaves: Of each group by octaves of blur [m, C + 1, h, w], which add up on each side
                of focus; sides occlude each other.
            enlarged: Makes px of that.
        """
        self._octaves = octaves
        self._enlarged = enlarged

    def of(self, octave: int) -> list[Tensor | None]:
        """What is of an octave, alone: [m, C + 1, h, w]; None if there is nothing."""
        found = (some.get(octave) for some in self._octaves)
        return [None if some is None else self._enlarged(some) for some in found]

    def whole(self) -> list[Tensor | None]:
        """Everything, as it occludes itself."""
        found: list[Tensor | None] = []
        for some in self._octaves:
            sides = [side for side in (_side(some, s) for s in (-1, 0, 1)) if side is not None]
            found.append(self._enlarged(_occluding(sides)) if sides else None)
        return found


class Filling:
    """A hidden surface over the tiles of a region.

    Attributes:
        plan: For each tile the rungs that reach it, nearest first.
        windows: Of each rung.
        halvings: How many times resolution is halved.
    """

    def __init__(
        self, frame: Frame, grid: Grid, inner: Box, hidden: HiddenLayer, slices: FillSlices
    ) -> None:
        """Prepare a surface that has pixels.

        Args:
            frame: It is part of.
            grid: The tiles.
            inner: Where in the frame the surface is known.
            hidden: The surface, at the resolution at which it is blurred.
            slices: How it is blurred, at full or at half of the resolution.
        """
        self.halvings, self._fine = slices.halvings, axes(frame.size, inner.top, inner.left)
        self._coarse = self._fine
        if slices.halvings:
            down, across = (halves(n, axis) for n, axis in zip(inner[2:], self._fine, strict=True))
            self._coarse = (down.axis, across.axis)
        color, radius, mask = hidden
        index = numbers_of(mask)
        found = position(radius.flatten().index_select(0, index), frame.radii[:: slices.stride])
        places = torch.zeros_like(radius).flatten().index_copy(0, index, found)
        places = places.reshape(radius.shape)
        nowhere = torch.zeros((0, 2), dtype=torch.long, device=places.device)
        nothing, coverage = color.new_zeros(0, len(color) + 1), mask[None].to(color.dtype)
        samples = Samples(color, coverage, places, nowhere, nothing, places[0, :0], None, None)
        self._tiles = grid.seen_from(inner)
        tiles = self._tiles
        if slices.halvings:
            read = [cells_read(tile, self._fine, self._coarse, 1) for tile in tiles.tiles]
            tiles = tiles._replace(tiles=read)
        self._cells_of = tiles.tiles
        self._blur = Blur(slices.windows, slices.cells, tiles, frame.groups, self._coarse)
        self._sliced: Sliced = self._blur.sliced(samples, slices.stride, slices.layers)
        self.plan = self._sliced.surface.plan
        self.windows: list[Window] = slices.windows[:: slices.stride]
        self._octaves = slices.octaves
        self._shares: dict[tuple[float, int], Shares] = {}

    def has(self, octave: int, index: int) -> bool:
        """Whether something of it over a tile is of an octave of blur."""
        return any(self._octave_of(rung) == octave for rung in self.plan[index])

    def _octave_of(self, rung: int) -> int:
        return self._octaves[self._sliced.layer_of[rung * self._sliced.stride]]

    def over_tile(self, index: int) -> Hidden:
        """What of it is seen over a tile."""
        tile, cells = self._tiles.tiles[index], self._cells_of[index]
        size = cells.height, cells.width
        octaves = [
            self._of_octaves(layers, size) for layers in self._blur.over_tile(self._sliced, index)
        ]

        def enlarged(cells_seen: Tensor) -> Tensor:
            if not self.halvings:
                return cells_seen
            rows, columns = (self._between(d, tile, cells, cells_seen) for d in (0, 1))
            return resampled(cells_seen, rows, columns)

        return Hidden(octaves, enlarged)

    def _of_octaves(self, layers: dict[int, Shown], size: tuple[int, int]) -> dict[int, Tensor]:
        """The sums [m, C + 1, h, w] of the layers of each octave that has one."""
        octaves: dict[int, list[Shown]] = {}
        for number in sorted(layers):
            octaves.setdefault(self._octaves[number], []).append(layers[number])
        found = {
            octave: summed(((s.box, s.layer) for s in some), size)
            for octave, some in octaves.items()
        }
        return {octave: total for octave, total in found.items() if total is not None}

    def _between(self, dim: int, tile: Box, cells: Box, like: Tensor) -> Shares:
        """The shares of cells in the pixels of a tile."""
        first = place_of(tile[dim], self._fine[dim], self._coarse[dim], self.halvings) - cells[dim]
        key = (first, tile[dim + 2])
        if key not in self._shares:
            self._shares[key] = linear_shares(*key, 0.5**self.halvings, like)
        return self._shares[key]


def _side(octaves: dict[int, Tensor], side: int) -> Tensor | None:
    """The sum of what is nearer than focus (-1), in focus (0) or beyond (1); None if nothing is."""
    found = [some for octave, some in octaves.items() if (octave > 0) - (octave < 0) == side]
    return reduce(torch.add, found) if found else None


def _occluding(layers: list[Tensor]) -> Tensor:
    """Layers [m, C + 1, h, w] from front to back as one."""
    found = torch.zeros_like(layers[0])
    for layer in layers:
        found = add_behind(found, layer)
    return found

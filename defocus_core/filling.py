"""A hidden surface, which fills what visible ones leave: blurred and composited, tile by tile.

What was invented is no sharper than what it was continued from: half of the resolution will do for
it.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.blur import Blur, Shown, Sliced
from defocus_core.compositing import add_behind, summed
from defocus_core.frame import FillSlices, Frame
from defocus_core.halving import axes, halves, place_of
from defocus_core.hidden import HiddenLayer
from defocus_core.resampling import cells_read, linear_shares, resampled
from defocus_core.slicing import position
from defocus_core.surface import Samples
from defocus_core.tiling import Box, Grid
from defocus_core.windows import Window

# At half of the resolution edges are soft: what is left is filled by up to this times its coverage.
_FILLS = 2.0


class Hidden(NamedTuple):
    """What each group of m parts sees of hidden surfaces over a tile; None for those that do not.

    Attributes:
        nearer: [m, C + 1, h, w] of what is nearer than focus, alone.
        in_focus: The same of what is in focus or not far from it.
        whole: The same of everything, as it occludes itself.
    """

    nearer: list[Tensor | None]
    in_focus: list[Tensor | None]
    whole: list[Tensor | None]


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
        coverage = mask[None].to(color.dtype)
        layer = torch.cat([color * coverage, coverage])
        index = torch.nonzero(layer[-1].detach().flatten() > 0)[:, 0]
        found = position(radius.flatten().index_select(0, index), frame.radii[:: slices.stride])
        places = torch.zeros_like(radius).flatten().index_copy(0, index, found)
        places = places.reshape(radius.shape)
        nowhere = torch.zeros((0, 2), dtype=torch.long, device=places.device)
        samples = Samples(layer, places, nowhere, layer[:, :0, 0].T, places[0, :0], None, None)
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
        self._sides = slices.sides
        self._shares: dict[tuple[float, int, int], Tensor] = {}

    def has(self, side: int, index: int) -> bool:
        """Whether something of it over a tile is nearer than focus (-1), in focus (0), beyond."""
        sliced, rungs = self._sliced, self.plan[index]
        return any(self._sides[sliced.layer_of[rung * sliced.stride]] == side for rung in rungs)

    def over_tile(self, index: int) -> Hidden:
        """What of it is seen over a tile."""
        tile, cells = self._tiles.tiles[index], self._cells_of[index]
        size = cells.height, cells.width
        hidden = Hidden([], [], [])
        for layers in self._blur.over_tile(self._sliced, index):
            sides = self._of_sides(layers, size)
            hidden.nearer.append(sides.get(-1))
            hidden.in_focus.append(sides.get(0))
            hidden.whole.append(_occluding([sides[side] for side in sorted(sides)]))
        if not self.halvings:
            return hidden

        def enlarged(cells_seen: Tensor | None, times: float) -> Tensor | None:
            if cells_seen is None:
                return None
            rows, columns = (self._between(d, tile, cells, cells_seen) for d in (0, 1))
            return resampled(cells_seen, rows * times, columns)

        return Hidden(
            [enlarged(some, 1.0) for some in hidden.nearer],
            [enlarged(some, 1.0) for some in hidden.in_focus],
            [enlarged(some, _FILLS) for some in hidden.whole],
        )

    def _of_sides(self, layers: dict[int, Shown], size: tuple[int, int]) -> dict[int, Tensor]:
        """The sums [m, C + 1, h, w] of the layers of each side of focus that has one."""
        sides: dict[int, list[Shown]] = {}
        for number in sorted(layers):
            sides.setdefault(self._sides[number], []).append(layers[number])
        found = {
            side: summed(((s.box, s.layer) for s in some), size) for side, some in sides.items()
        }
        return {side: total for side, total in found.items() if total is not None}

    def _between(self, dim: int, tile: Box, cells: Box, like: Tensor) -> Tensor:
        """The shares [pixels, cells] of cells in the pixels of a tile."""
        first = place_of(tile[dim], self._fine[dim], self._coarse[dim], self.halvings) - cells[dim]
        key = (first, tile[dim + 2], cells[dim + 2])
        if key not in self._shares:
            self._shares[key] = linear_shares(*key, 0.5**self.halvings, like)
        return self._shares[key]


def _occluding(layers: list[Tensor]) -> Tensor | None:
    """Layers [m, C + 1, h, w] from front to back as one; None if there is none."""
    if not layers:
        return None
    found = torch.zeros_like(layers[0])
    for layer in layers:
        found = add_behind(found, layer)
    return found

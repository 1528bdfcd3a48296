"""The fill of hidden surfaces: blurred, and composited where visible ones leave a gap.

An invented surface is no sharper than the surface that it was continued from: half of the
resolution is enough for it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce

import torch
from torch import Tensor

from defocus_core.renderer.blur.layer_blur import Blur, ShownLayer
from defocus_core.renderer.compositing.saturating_sum import add_behind, summed
from defocus_core.renderer.engine.frame import SharedFrame
from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer
from defocus_core.renderer.layers.ladder import position
from defocus_core.renderer.layers.samples import SurfaceSamples
from defocus_core.tensors.box import Box
from defocus_core.tensors.pyramid import axes, halves, place_of
from defocus_core.tensors.resampling import Shares, cells_read, linear_shares, resampled
from defocus_core.tensors.sparse_masks import numbers_of
from defocus_core.tensors.tiling import Grid


class Hidden:
    """A hidden surface over a tile, as each group of m parts of the aperture sees it."""

    def __init__(
        self, octaves: list[dict[int, Tensor]], enlarged: Callable[[Tensor], Tensor]
    ) -> None:
        """Keep the octaves of blur of the surface.

        Args:
            octaves: For each group the octaves [m, C + 1, h, w], in cells; octaves of one side of
                focus add up, the sides occlude each other.
            enlarged: Makes px of cells.
        """
        self._octaves = octaves
        self._enlarged = enlarged

    def of(self, octave: int) -> list[Tensor | None]:
        """For each group one octave alone [m, C + 1, h, w]; None if nothing is of this octave."""
        groups = (octaves.get(octave) for octaves in self._octaves)
        return [None if cells is None else self._enlarged(cells) for cells in groups]

    def whole(self) -> list[Tensor | None]:
        """For each group all octaves [m, C + 1, h, w]; None if there is nothing."""
        whole: list[Tensor | None] = []
        for octaves in self._octaves:
            sides = [side for s in (-1, 0, 1) if (side := _side(octaves, s)) is not None]
            whole.append(self._enlarged(_occluding(sides)) if sides else None)
        return whole


class Filling:
    """A hidden surface over the tiles of a region.

    Attributes:
        known: Whether the surface is known, not invented.
        plan: For each tile the rungs that reach it, nearest first.
        windows: The window of each rung.
        halvings: How many times resolution is halved before the blur.
    """

    def __init__(
        self,
        frame: SharedFrame,
        grid: Grid,
        boxes: tuple[Box, Box],
        hidden: HiddenLayer,
        *,
        known: bool,
    ) -> None:
        """Prepare a surface that has pixels.

        Args:
            frame: The frame that it is a part of.
            grid: The tiles.
            boxes: The place of the surface in the frame, and the rectangle it is continued to.
            hidden: The surface, at the resolution at which it is blurred.
            known: Whether it is known, not invented.
        """
        slicing = frame.slices.known if known else frame.slices.invented
        self.known, self.halvings, self._stride = known, slicing.halvings, slicing.stride
        self.windows = slicing.windows[:: slicing.stride]
        self._octave_of_slice = frame.slices.octaves
        self._octave_of_layer = dict(zip(slicing.layers, frame.slices.octaves, strict=True))
        held, inner = boxes
        self._fine = self._coarse = axes(frame.size, inner.top, inner.left)
        self._tiles, around = grid.seen_from(inner), inner.seen_from(held)
        cells = self._tiles
        if self.halvings:
            down, across = (halves(n, axis) for n, axis in zip(inner[2:], self._fine, strict=True))
            self._coarse = (down.axis, across.axis)
            own = axes(frame.size, held.top, held.left)
            rows, columns = (halves(n, axis) for n, axis in zip(held[2:], own, strict=True))
            corner = rows.axis.middle - down.axis.middle, columns.axis.middle - across.axis.middle
            around = Box(*corner, down.length, across.length)
            read = [cells_read(tile, self._fine, self._coarse, 1) for tile in cells.tiles]
            cells = cells._replace(tiles=read)
        self._cells_of = cells.tiles
        self._blur = Blur(
            slicing.windows,
            slicing.cells,
            cells,
            frame.division.groups,
            self._coarse,
            by_corners=frame.settings.field is not None,
        )
        samples = _samples(hidden, frame.slices.radii[:: slicing.stride])._replace(around=around)
        self._sliced = self._blur.sliced(samples, slicing.stride, slicing.layers)
        self.plan = self._sliced.surface.plan
        self._shares: dict[tuple[float, int], Shares] = {}

    def has(self, octave: int, index: int) -> bool:
        """Whether a part of the surface over a tile is of an octave of blur."""
        return any(self._octave_of_slice[k * self._stride] == octave for k in self.plan[index])

    def over_tile(self, index: int) -> Hidden:
        """The surface over a tile."""
        tile, cells = self._tiles.tiles[index], self._cells_of[index]
        size = cells.height, cells.width
        octaves = [
            self._octaves(layers, size) for layers in self._blur.over_tile(self._sliced, index)
        ]

        def enlarged(surface: Tensor) -> Tensor:
            if not self.halvings:
                return surface
            rows, columns = (self._between(d, tile, cells, surface) for d in (0, 1))
            return resampled(surface, rows, columns)

        return Hidden(octaves, enlarged)

    def _octaves(self, layers: dict[int, ShownLayer], size: tuple[int, int]) -> dict[int, Tensor]:
        """The sum [m, C + 1, h, w] of the layers of each octave that has one."""
        octaves: dict[int, list[tuple[Box, Tensor]]] = {}
        for number, shown in sorted(layers.items()):
            octaves.setdefault(self._octave_of_layer[number], []).append((shown.box, shown.layer))
        sums = {octave: summed(octave_layers, size) for octave, octave_layers in octaves.items()}
        return {octave: total for octave, total in sums.items() if total is not None}

    def _between(self, dim: int, tile: Box, cells: Box, like: Tensor) -> Shares:
        """The shares of cells in the pixels of a tile, along one axis."""
        first = place_of(tile[dim], self._fine[dim], self._coarse[dim], self.halvings) - cells[dim]
        key = (first, tile[dim + 2])
        if key not in self._shares:
            self._shares[key] = linear_shares(*key, 0.5**self.halvings, like)
        return self._shares[key]


def _samples(hidden: HiddenLayer, radii: tuple[float, ...]) -> SurfaceSamples:
    """The pixels of a hidden surface, with their places on the ladder of its slices."""
    color, radius, mask = hidden
    index = numbers_of(mask)
    places = torch.zeros_like(radius).flatten()
    places = places.index_copy(0, index, position(radius.flatten().index_select(0, index), radii))
    places = places.reshape(radius.shape)
    nowhere = torch.zeros((0, 2), dtype=torch.long, device=places.device)
    no_fringe, coverage = color.new_zeros(0, len(color) + 1), mask[None].to(color.dtype)
    return SurfaceSamples(color, coverage, places, nowhere, no_fringe, places[0, :0], None, None)


def _side(octaves: dict[int, Tensor], side: int) -> Tensor | None:
    """The sum of the octaves nearer than focus (-1), in focus (0) or beyond (1); None for none."""
    cells = [x for octave, x in octaves.items() if (octave > 0) - (octave < 0) == side]
    return reduce(torch.add, cells) if cells else None


def _occluding(layers: list[Tensor]) -> Tensor:
    """Layers [m, C + 1, h, w] from front to back as one."""
    total = torch.zeros_like(layers[0])
    for layer in layers:
        total = add_behind(total, layer)
    return total

"""The order in which the surfaces over a tile are composited.

An invented surface is no sharper than the surface that it continues: half the resolution is enough
for its blur.

Visible surfaces come first, as they are known, and as their share is right in the mean where
surfaces out of focus cover each other at random. But a surface in focus occludes exactly: where it
continues behind a nearer one, nothing beyond focus shows. The same holds for a surface much less
blurred than the one beyond it.

It does not hold for a surface nearer than focus and one beyond it. At the edge of the near surface,
the lens points that it covers are those that see the visible part of the far one; the other lens
points see the hidden part. So far surfaces are composited alone, hidden parts included; the near
ones then cover them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce

import torch
from torch import Tensor

from defocus_core.renderer.blur.layer_blur import Blur, ShownLayer
from defocus_core.renderer.compositing.aperture_views import TileCompositor
from defocus_core.renderer.compositing.saturating_sum import add_behind, summed
from defocus_core.renderer.compositing.sight import Sight
from defocus_core.renderer.engine.frame import RegionPlace
from defocus_core.renderer.layers.layer import HIDDEN, VISIBLE, SampleLayer
from defocus_core.renderer.layers.slice_radii import CompositeOrder
from defocus_core.renderer.layers.sliced_surface import SurfaceSamples
from defocus_core.tensors.box import Box
from defocus_core.tensors.pyramid import (
    AxisWeights,
    axes,
    coarse_read,
    halves,
    linear_weights,
    position_of,
    resampled,
)


class Hidden:
    """A hidden surface over a tile, as M parts of the aperture see it."""

    def __init__(
        self,
        octaves: dict[int, Tensor],
        enlarged: Callable[[Tensor], Tensor],  # makes px of coarse pixels
        sight: Sight | None,
    ) -> None:
        """Keep the octaves of blur of the surface.

        `octaves`: the octaves [M, C + 1, h, w], in coarse pixels; octaves of one side of focus add
        up, the sides occlude each other; `sight`: the limits of sight in the tile; None without
        limits.
        """
        self._octaves, self._enlarged, self._sight = octaves, enlarged, sight
        self._known: dict[int, Tensor] = {}

    def octave(self, octave: int) -> Tensor | None:
        """One octave in px [M, C + 1, h, w], as far as the lens sees; None if it is absent."""
        if octave in self._octaves and octave not in self._known:
            seen = self._enlarged(self._octaves[octave])
            limit = None if self._sight is None else self._sight.to_octave(octave)
            self._known[octave] = seen if limit is None else seen * limit
        return self._known.get(octave)

    def whole(self) -> Tensor | None:
        """All octaves [M, C + 1, h, w]; None if all are empty."""
        sides = ([o for o in self._octaves if (o > 0) - (o < 0) == side] for side in (-1, 0, 1))
        of_sides = ([self.octave(octave) for octave in side] for side in sides if side)
        seen = [reduce(torch.add, [x for x in side if x is not None]) for side in of_sides]
        return reduce(add_behind, seen, torch.zeros_like(seen[0])) if seen else None


class Filling:
    """A hidden surface over the tiles of a region.

    Attributes:
        plan: For each tile the indices of slices that reach it, nearest first.
        windows: The window of each slice.
        level: How many times resolution is halved before the blur.
    """

    def __init__(self, place: RegionPlace, layer: SampleLayer) -> None:
        """Prepare a surface that has pixels."""
        frame, slicing = place.frame, place.frame.slices.invented
        self.level = slicing.level
        self._octave_of_slice = frame.slices.octaves[:: slicing.stride]
        self._octave_of_layer = dict(zip(slicing.layers, frame.slices.octaves, strict=True))
        self._fine = self._coarse = axes(frame.size, place.inner.top, place.inner.left)
        tiles, around = place.grid.seen_from(place.inner), place.inner.seen_from(place.held)
        coarse = tiles
        if self.level:
            down, across = (
                halves(n, axis) for n, axis in zip(place.inner[2:], self._fine, strict=True)
            )
            self._coarse = (down.axis, across.axis)
            frame_axes = axes(frame.size, place.held.top, place.held.left)
            rows, columns = (
                halves(n, axis) for n, axis in zip(place.held[2:], frame_axes, strict=True)
            )
            corner = rows.axis.middle - down.axis.middle, columns.axis.middle - across.axis.middle
            around = Box(*corner, down.length, across.length)
            read = [coarse_read(tile, self._fine, self._coarse, 1) for tile in coarse.tiles]
            coarse = coarse._replace(tiles=read)
        self._tiles, self._coarse_of = tiles.tiles, coarse.tiles
        self._groups = frame.division.groups
        self._blur = Blur(
            SurfaceSamples([layer], around=around),
            frame.radii,
            slicing,
            coarse,
            self._groups,
            self._coarse,
            by_corners=frame.settings.cat_eye is not None,
        )
        self.plan, self.windows = self._blur.surface.plan, self._blur.windows

    def has(self, octave: int, index: int) -> bool:
        """Whether the surface has pixels of an octave over a tile."""
        return any(self._octave_of_slice[k] == octave for k in self.plan[index])

    def tile_surface(self, index: int, sight: Sight | None = None) -> Hidden:
        """The surface over a tile, as far as the lens sees."""
        tile, coarse = self._tiles[index], self._coarse_of[index]
        octaves: dict[int, list[tuple[Box, Tensor]]] = {}
        for number, shown in sorted(self._blur.tile_layers(index).items()):
            of_octave = octaves.setdefault(self._octave_of_layer[number], [])
            of_octave.append((shown.box, shown.layer))

        def enlarged(surface: Tensor) -> Tensor:
            if not self.level:
                return surface
            return resampled(
                surface, *(self._axis_weights(d, tile, coarse, surface) for d in (0, 1))
            )

        size = coarse.height, coarse.width
        return Hidden({o: summed(layers, size) for o, layers in octaves.items()}, enlarged, sight)

    def _axis_weights(self, dim: int, tile: Box, coarse: Box, like: Tensor) -> AxisWeights:
        """The shares of coarse pixels in the pixels of a tile, along one axis."""
        first = position_of(tile[dim], self._fine[dim], self._coarse[dim], self.level) - coarse[dim]
        return linear_weights(first, tile[dim + 2], 0.5**self.level, like.shape[dim - 2], like)


def composite(
    compositor: TileCompositor,
    surfaces: dict[str, dict[int, ShownLayer]],  # the layers of each kind by their numbers
    continued: list[Filling],
    order: CompositeOrder,
    index: int,
) -> None:
    """Add the surfaces over a tile to its views.

    Known hidden surfaces are composited with the visible ones, in the order of layers.
    """
    visible, known = surfaces[VISIBLE], surfaces.get(HIDDEN, {})
    if HIDDEN in surfaces:
        order = CompositeOrder(0, 0, [])
    blurred: dict[Filling, Hidden] = {}

    def blurred_once(surface: Filling) -> Hidden:
        if surface not in blurred:
            blurred[surface] = surface.tile_surface(index, compositor.sight)
        return blurred[surface]

    def fill(octave: int) -> None:
        for surface in () if HIDDEN in surfaces else continued:
            if surface.has(octave, index):
                compositor.fill(blurred_once(surface).octave(octave))

    def show(numbers: set[int]) -> None:
        for number in sorted(numbers & indices):
            compositor.add(number, visible.get(number), known.get(number))

    indices = {*visible, *known}
    near = {k for k in indices if k < order.around}
    show(near)
    has_more = bool(continued) or max(indices) >= order.beyond if near else False
    covered = compositor.coverage() if has_more else None
    show({k for k in indices - near if k < order.beyond})
    fill(0)
    aside = None
    if covered is not None:
        before = compositor.coverage()
        for octave, _ in order.ahead:
            if octave < 0:
                fill(octave)
        aside = compositor.set_aside(covered + (compositor.coverage() - before))
    # before layers that the tile lacks, too: a pixel does not depend on the tile that it is in
    later = {first for _, first in order.ahead}
    for k in sorted({k for k in indices if k >= order.beyond} | later):
        for octave in order.octaves_before(k):
            if aside is None:
                fill(octave)
            elif octave > 0:
                fill(octave)
                compositor.close_gaps(aside)
        show({k})
    compositor.close()
    for surface in continued:
        compositor.fill(blurred_once(surface).whole())
    if aside is not None:
        compositor.put_together(aside)

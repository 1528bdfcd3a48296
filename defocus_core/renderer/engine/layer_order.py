"""The order in which the surfaces over a tile are composited.

An invented surface is no sharper than the surface that it continues, so half the resolution is
enough for its blur.

Visible surfaces come first, as they are known, and as their shares are right on average where
surfaces out of focus cover each other at random. But a surface in focus occludes exactly: where it
continues behind a nearer one, nothing beyond focus shows. The same holds for a surface much less
blurred than the one beyond it.

It does not hold for a surface nearer than focus and one beyond it. At the edge of the near surface,
the lens points that it covers are those that see the visible part of the far one; the other lens
points see the hidden part. So far surfaces are composited alone, hidden parts included; the near
ones then cover them.
"""

from __future__ import annotations

from functools import reduce

import torch
from torch import Tensor

from defocus_core.renderer.blur.layer_blur import Blur, ShownLayer
from defocus_core.renderer.compositing.aperture_views import TileCompositor
from defocus_core.renderer.compositing.saturating_sum import add_behind
from defocus_core.renderer.compositing.sight import Sight
from defocus_core.renderer.engine.frame import RegionPlace
from defocus_core.renderer.inpainting.hidden_layers import CoarseGrid
from defocus_core.renderer.layers.layer import HIDDEN, VISIBLE, SampleLayer
from defocus_core.renderer.layers.slice_radii import CompositeOrder
from defocus_core.renderer.layers.sliced_surface import SurfaceSamples
from defocus_core.tensors.pyramid import axes, coarse_read, upsampled


class Filling:
    """A hidden surface that fills gaps in the tiles of a region.

    Attributes:
        plan: For each tile the indices of slices that reach it, nearest first.
        windows: The transform window of each slice.
        level: How many times resolution is halved before the blur.
    """

    def __init__(self, place: RegionPlace, layer: SampleLayer) -> None:
        """Prepare the blur of a hidden layer that has pixels."""
        frame, slicing = place.frame, place.frame.slices.invented
        self.level = slicing.level
        self._octave_of_layer = dict(zip(slicing.layers, frame.slices.octaves, strict=True))
        fine, of_held = (axes(frame.size, *box[:2]) for box in (place.inner, place.held))
        middle = CoarseGrid.from_size(place.inner[2:], fine, self.level).middle
        held = CoarseGrid.from_size(place.held[2:], of_held, self.level)
        self._axes = fine, middle
        tiles = coarse = place.grid.seen_from(place.inner)
        if self.level:
            read = [coarse_read(tile, *self._axes, self.level) for tile in tiles.tiles]
            coarse = tiles._replace(tiles=read)
        self._tiles, self._coarse_of = tiles.tiles, coarse.tiles
        self._blur = Blur(
            SurfaceSamples([layer], around=held.coarse(place.inner.seen_from(place.held))),
            frame.radii,
            slicing,
            coarse,
            frame.division.groups,
            middle,
            by_corners=frame.settings.cat_eye is not None,
        )
        self.plan, self.windows = self._blur.surface.plan, self._blur.windows

    def octaves(self, index: int, sight: Sight | None) -> dict[int, Tensor]:
        """The octaves [M, C + 1, h, w] of the surface in tile `index`, by number.

        They are multiplied by the share that the lens sees.
        """
        octaves: dict[int, Tensor] = {}
        for number, shown in sorted(self._blur.tile_layers(index).items()):
            octave = self._octave_of_layer[number]
            octaves[octave] = octaves[octave] + shown.layer if octave in octaves else shown.layer
        tile, read = self._tiles[index], self._coarse_of[index]
        for octave, layer in octaves.items():
            whole = upsampled(layer, read, tile, self._axes, self.level) if self.level else layer
            octaves[octave] = whole if sight is None else whole * sight.to_octave(octave)
        return octaves


def _whole(octaves: dict[int, Tensor]) -> Tensor:
    """All octaves of a hidden surface as one layer.

    Octaves on one side of focus are added; nearer sides occlude farther ones.
    """
    sides = ([o for o in octaves if (o > 0) - (o < 0) == side] for side in (-1, 0, 1))
    seen = [reduce(torch.add, [octaves[o] for o in side]) for side in sides if side]
    return reduce(add_behind, seen, torch.zeros_like(seen[0]))


def composite(
    compositor: TileCompositor,
    surfaces: dict[str, dict[int, ShownLayer]],  # the layers of each kind by their numbers
    hidden: dict[int, Tensor],  # the octaves of the continued surface
    order: CompositeOrder,
) -> None:
    """Composite all surfaces over a tile, in order.

    Known hidden surfaces are composited with the visible ones, in the order of layers.
    """
    visible, known = surfaces[VISIBLE], surfaces.get(HIDDEN, {})
    if HIDDEN in surfaces:
        order = CompositeOrder(0, 0, [])

    def fill(octave: int) -> None:
        if octave in hidden and HIDDEN not in surfaces:
            compositor.fill(hidden[octave])

    def show(numbers: set[int]) -> None:
        for number in sorted(numbers & indices):
            compositor.add(number, visible.get(number), known.get(number))

    indices = {*visible, *known}
    near = {k for k in indices if k < order.around}
    show(near)
    has_more = bool(hidden) or max(indices) >= order.beyond if near else False
    covered = compositor.coverage if has_more else None
    show({k for k in indices - near if k < order.beyond})
    fill(0)
    aside = None
    if covered is not None:
        before = compositor.coverage
        for octave, _ in order.ahead:
            if octave < 0:
                fill(octave)
        aside = compositor.set_aside(covered + (compositor.coverage - before))
    # before layers that the tile lacks, too: a pixel does not depend on the tile that it is in
    later = {first for _, first in order.ahead}
    for k in sorted({k for k in indices if k >= order.beyond} | later):
        for octave in (octave for octave, first in order.ahead if first == k):
            if aside is None:
                fill(octave)
            elif octave > 0:
                fill(octave)
                compositor.close_gaps(aside)
        show({k})
    compositor.close()
    if hidden:
        compositor.fill(_whole(hidden))
    if aside is not None:
        compositor.put_together(aside)

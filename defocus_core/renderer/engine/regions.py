"""The regions of a picture, which are sliced, blurred and composited tile by tile.

Slices of a layer are summed in the Fourier domain; layers are composited front to back, for each
part of the aperture. Hidden layers fill the gaps of visible ones; in focus they also occlude. First
the layers of a region are found, from a picture or from layers with coverage; from these `Region`
computes tiles.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from defocus_core.renderer.blur.layer_blur import Blur
from defocus_core.renderer.compositing.aperture_views import TileCompositor
from defocus_core.renderer.compositing.left_right import count_negative, left_and_right
from defocus_core.renderer.compositing.saturating_sum import ColorRange, add_light, mean_of_parts
from defocus_core.renderer.engine.frame import RegionPlace, SharedFrame, frame_at
from defocus_core.renderer.engine.layer_order import Filling, composite
from defocus_core.renderer.engine.region_layers import (
    RegionLayers,
    backdrop_in,
    discs,
    fractions_seen,
    layers_at,
    samples_within,
    visible_samples,
)
from defocus_core.renderer.engine.scene import InFocus
from defocus_core.renderer.inpainting.frame_pyramid import Backdrop
from defocus_core.renderer.layers.alpha import Alpha, with_coverage
from defocus_core.renderer.layers.layer import CONTINUED, HIDDEN, TRACE, UNCOVERED, VISIBLE
from defocus_core.renderer.layers.sliced_surface import SurfaceSamples
from defocus_core.tensors.box import Box, Grid, regions
from defocus_core.tensors.pyramid import axes
from defocus_core.tensors.threads import recomputed, threaded
from defocus_core.tensors.views import ViewTensors, assemble


def region_of(frame: SharedFrame, grid: Grid, scene: InFocus, backdrop: Backdrop | None) -> Region:
    """The region that consists of the tiles of `grid`; `backdrop`: as in `layers_at`."""
    place = RegionPlace.from_grid(frame_at(frame, grid.box), grid)
    return Region(place, layers_at(place, scene, backdrop))


class Region:
    """A rectangle of tiles, with the data that they share."""

    def __init__(self, place: RegionPlace, seen: RegionLayers) -> None:
        """Prepare the blur of the layers of the region."""
        frame = self._frame = place.frame
        self._tiles, self._sight = place.grid.tiles, seen.sight
        self._like = seen.layers[0].color
        around = place.inner.seen_from(place.held)
        middle = axes(frame.size, place.inner.top, place.inner.left)

        def blur_of(samples: SurfaceSamples) -> Blur:
            return Blur(
                samples._replace(around=around),
                frame.radii,
                frame.slices.visible,
                place.grid.seen_from(place.inner),
                frame.division.groups,
                middle,
                by_corners=frame.settings.cat_eye is not None,
            )

        self._blurs = {VISIBLE: blur_of(visible_samples(place, seen))}
        for kind in (HIDDEN, UNCOVERED):
            if layers := seen.layers_of(kind):
                self._blurs[kind] = blur_of(samples_within(place, layers))
        continued = seen.layers_of(CONTINUED)
        self._continued = Filling(place, continued[0]) if continued else None
        division = frame.division
        centre = division.parts[division.centre]
        # Shares of the aperture parts that see the frame, and the scene that continues it
        self._in_frame = fractions_seen(place, seen, frame.box, centre)
        self._in_scene: Tensor | float = 1.0
        if frame.cut:
            self._in_scene = fractions_seen(place, seen, frame.scene, division.parts)
        channels, minimum = frame.content.channels, frame.content.minimum
        self._range = ColorRange.from_channels(channels, self._like, minimum)
        self._traces = [
            torch.cat(layer.crop(place.core).light_and_coverage) for layer in seen.layers_of(TRACE)
        ]
        self._discs = [discs(place, seen, lights) for lights in seen.lights]

    def tile(self, index: int) -> ViewTensors:
        """The views of tile number `index` of the region."""
        frame, box = self._frame, self._tiles[index]
        compositor = self._composited(index)
        lit, division = self._lit(compositor.front, index), frame.division
        trust = self._trust(lit[:, -1], compositor.invented, box)
        counts, content = self._counts(index), frame.content
        weights = division.weights
        centre = self._range.bounded(mean_of_parts(lit[division.centre], weights[division.centre]))
        if not frame.settings.left_right:
            return ViewTensors([centre], trust, counts, box)
        both, weights = lit[division.pair], weights[division.pair]
        if compositor.moved is not None:
            both = add_light(both, compositor.moved)
        cut = sum(part.is_left for part in division.parts[division.pair])
        left = mean_of_parts(both[:cut], weights[:cut])
        right = mean_of_parts(both[cut:], weights[cut:])
        halves = torch.stack([left, right])
        counts |= count_negative(halves, content.limit, content.minimum)
        images = left_and_right(
            halves,
            centre,
            self._range,
            minimum=content.minimum,
            fraction=division.left_fraction,
            has_alpha=content.alpha is not Alpha.NONE,
            dual_pixel=frame.settings.dual_pixel,
        )
        return ViewTensors([centre, *images], trust, counts, box)

    def _trust(self, covered: Tensor, invented: Tensor | None, box: Box) -> Tensor:
        """The share [1, h, w] of the aperture that saw the scene.

        It is the share of the coverage [M, h, w] of all parts that is not invented, times the share
        of the parts that looks into the frame, as surfaces beyond the frame were not seen.
        """
        mean = self._frame.division.mean
        observed = covered if invented is None else covered - invented
        fraction = mean(observed) / mean(covered)
        if isinstance(self._in_frame, Tensor) and not self._frame.is_inside(box, self._frame.box):
            expected = box.seen_from(self._tiles[0]).crop(self._in_frame)
            fraction = fraction * mean(expected[:, 0])
        return fraction.clamp(0, 1)[None]

    def _composited(self, index: int) -> TileCompositor:
        """The surfaces of tile `index`, composited for each part of the aperture."""
        frame, content, tile = self._frame, self._frame.content, self._tiles[index]
        sight = self._sight and self._sight.crop(tile.seen_from(self._tiles[0]))
        division, shape = frame.division, self._like.shape
        blank = self._like.new_zeros(len(division.parts), shape[0] + 1, *tile[2:])
        full = self._full(index)
        compositor = TileCompositor(blank, full, sight, closed=not content.open)
        surfaces = {kind: blur.tile_layers(index) for kind, blur in self._blurs.items()}
        if UNCOVERED in surfaces:
            compositor.reserve(surfaces[UNCOVERED])
        order = frame.slices.composite_order
        hidden = self._continued.octaves(index, sight) if self._continued else {}
        composite(compositor, surfaces, hidden, order)
        if content.alpha is Alpha.COVERED:
            compositor.front = with_coverage(compositor.front)
        if content.open:
            compositor.leave_open()
        return compositor

    def _lit(self, views: Tensor, index: int) -> Tensor:
        """The views of tile `index` through all parts, with highlights added.

        Views are later divided by their coverage, to which highlights do not contribute. So
        highlights are multiplied by the coverage, and errors of the coverage do not brighten them.
        """
        box = self._tiles[index].seen_from(self._tiles[0])
        for trace in self._traces:
            views = views + box.crop(trace)
        inside = box.crop(self._in_scene) if isinstance(self._in_scene, Tensor) else 1.0
        for lights in self._discs:
            coverage = views[:, -1:] / inside
            views = add_light(views, box.crop(lights) * coverage)
        return views

    def _full(self, index: int) -> Tensor | float:
        """The greatest coverage in tile `index`: the share of each part that sees the scene."""
        tile, frame = self._tiles[index], self._frame
        if not isinstance(self._in_scene, Tensor) or not frame.content.edges:
            return 1.0
        if frame.is_inside(tile, frame.scene):
            return 1.0
        return tile.seen_from(self._tiles[0]).crop(self._in_scene)

    def _counts(self, index: int) -> dict[str, int]:
        """Counts of the work done for tile `index`, and of the work if nothing were skipped."""
        windows, area = self._frame.slices.visible.windows, self._tiles[index].area
        visible = self._blurs[VISIBLE].surface.plan[index]
        done = [(windows[slice_index], windows[slice_index].level) for slice_index in visible]
        if (hidden := self._continued) is not None:
            reaching = [hidden.windows[slice_index] for slice_index in hidden.plan[index]]
            done += [(window, hidden.level + window.level) for window in reaching]
        return {
            "pixels": area,
            "pixels_copied": 0 if any(window.margin for window, _ in done) else area,
            "tiles": 1,
            "slice_tiles": 2 * len(windows),
            "slice_tiles_done": len(done),
            "slice_tiles_blurred": sum(window.margin > 0 for window, _ in done),
            "slice_tiles_reduced": sum(level > 0 for _, level in done),
            "tiles_with_hidden": int(len(done) > len(visible)),
        }


def rendered_regions(
    frame: SharedFrame, scene: InFocus, progress: Callable[[int, int], None] | None
) -> Iterator[ViewTensors]:
    """Yield the views of each region of a picture, row by row, from left to right.

    Regions are computed one after another, the tiles of each in threads. `progress`: called with
    the number of tiles done and the number of all tiles.
    """
    backdrop = backdrop_in(frame, scene)
    numbers, count = itertools.count(1), len(frame.grid.tiles)

    def computed(grid: Grid) -> ViewTensors:
        region, tiles = region_of(frame, grid, scene, backdrop), list[ViewTensors]()
        work = recomputed(region.tile), range(len(grid.tiles)), frame.settings.threads
        for tile in threaded(*work):
            tiles.append(tile)
            if progress and (number := next(numbers)) <= count:  # else a backward pass repeats it
                progress(number, count)
        return assemble(tiles)

    for row in regions(frame.grid, frame.margin):
        yield from map(recomputed(computed), row)

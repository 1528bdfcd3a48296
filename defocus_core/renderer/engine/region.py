"""A region of a picture through the pipeline: slice, blur, composite, tile by tile.

Slices of a layer are summed in the Fourier domain; layers are composited front to back, for each
part of the aperture. Hidden layers fill the gaps of visible ones; in focus they also occlude.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from defocus_core.depth.matting import Unmixed
from defocus_core.renderer.blur.layer_blur import Blur, Sliced, blended
from defocus_core.renderer.compositing.aperture_views import TileCompositor
from defocus_core.renderer.compositing.bokeh_discs import Occluder, draw, occluders_of
from defocus_core.renderer.compositing.frame_border import border_fallback, fraction_in_frame
from defocus_core.renderer.compositing.highlights import Highlights, split
from defocus_core.renderer.compositing.saturating_sum import (
    ColorRange,
    add_light,
    count_negative,
    pair_of,
    picture,
)
from defocus_core.renderer.compositing.sight import SightLimits
from defocus_core.renderer.engine.frame import SharedFrame, corner_views, frame_at, views_of
from defocus_core.renderer.engine.layer_order import Filling, add_in_order
from defocus_core.renderer.engine.scene import (
    RegionSurfaces,
    Scene,
    SurfacesOfColors,
    continued,
    taken_apart,
)
from defocus_core.renderer.inpainting.frame_pyramid import Backdrop
from defocus_core.renderer.inpainting.hidden_layers import known_within, separated
from defocus_core.renderer.layers.samples import Sheet, SurfaceSamples
from defocus_core.renderer.layers.slice_radii import slice_position
from defocus_core.renderer.layers.slopes import AROUND, Shifts, slopes
from defocus_core.tensors.box import Box, Grid
from defocus_core.tensors.pyramid import axes
from defocus_core.tensors.views import Views


class Region:
    """A rectangle of tiles of a picture, and everything that they share."""

    def __init__(
        self,
        frame: SharedFrame,
        grid: Grid,
        scene: Scene,
        backdrop: Backdrop | SurfacesOfColors | None,
        shown: Unmixed | None = None,
    ) -> None:
        """Find the surfaces of a region, and prepare their blur.

        `backdrop`: the frame at low resolution, or hidden surfaces that are continued for all
        colours; None if nothing is continued; `shown`: the visible surfaces of the frame; None to
        find those of the region.
        """
        frame = frame_at(frame, grid.box)
        self._frame, self._grid, self._tiles = frame, grid, grid.tiles
        self._scene, self._shown_at_once = scene, shown
        core, content, slices = grid.box, frame.content, frame.slices
        outer = core.grown(frame.margin, frame.box)
        reach = max(frame.farthest + frame.farthest % 2, *frame.beyond)  # even: it may be halved
        held, inner = core.grown(reach, frame.box), core.grown(reach, frame.scene)
        self._held, self._inner, self._inside = held, inner, held.seen_from(outer)
        self._blur = Blur(
            slices.visible.windows,
            slices.visible.coarse,
            grid.seen_from(inner),
            frame.division.groups,
            axes(frame.size, inner.top, inner.left),
            by_corners=frame.settings.field is not None,
        )
        pixels, signed_radius = (
            outer.of(x).to(frame.dtype) for x in (scene.image, scene.signed_radius)
        )
        if content.edges:  # pixels beside them are looked up by their numbers
            pixels, signed_radius = pixels.contiguous(), signed_radius.contiguous()
        inmost = core.seen_from(outer)
        self._others: list[Sheet] = []
        self._shared: RegionSurfaces | None = None
        if isinstance(backdrop, SurfacesOfColors):
            self._shared = backdrop.at(outer, self._inside)
        unmixed_pixels, signed_radius, highlights = self._surfaces(pixels, signed_radius, outer)
        positions = slice_position(signed_radius, slices.radii)
        self._sight = self._limits_of_sight(signed_radius, positions, inmost)
        radius, groups = inmost.of(signed_radius), frame.division.groups
        self._in_frame = self._fractions_within(frame.box, radius, groups[:1])
        self._in_scene = self._fractions_within(frame.scene, radius, groups) if frame.cut else None
        self._like = unmixed_pixels.color
        self._range = ColorRange.of(content.channels, self._like, content.minimum)
        self._fallback = (
            border_fallback(inmost.of(unmixed_pixels.color), frame.trace) if frame.trace else None
        )
        self._visible = self._in_front(unmixed_pixels, signed_radius, positions)
        self._hidden: list[Filling] = []
        if backdrop is not None:
            self._hidden = self._fillings(unmixed_pixels.color, signed_radius, backdrop, outer)
        self._highlights: Tensor | None = None
        if highlights:
            occluders = occluders_of(unmixed_pixels, signed_radius, positions, slices.radii)
            self._highlights = self._drawn(highlights, occluders, inmost)

    def _surfaces(
        self, pixels: Tensor, signed_radius: Tensor, outer: Box
    ) -> tuple[Unmixed, Tensor, Highlights | None]:
        """The visible surfaces in the rectangle `outer`: pixels, radii, and highlights apart."""
        frame = self._frame
        if self._shared is not None:
            shown = self._shared.shown
        elif self._shown_at_once is not None and outer == frame.box:
            shown = self._shown_at_once
        else:
            shown = taken_apart(pixels, signed_radius, self._scene.matte, outer, frame)
        if frame.content.highlights:
            shown, highlights = split(shown, signed_radius, frame.content.limit)
            return shown, signed_radius, highlights
        return shown, signed_radius, None

    def _limits_of_sight(
        self, signed_radius: Tensor, positions: Tensor, core: Box
    ) -> SightLimits | None:
        """How far the lens sees at each pixel of the region; None if no surface hides another."""
        slices, content = self._frame.slices, self._frame.content
        if not content.edges:
            return None
        limits = SightLimits.of(signed_radius, positions, slices.visible.layers, slices.octaves)
        return limits.over(core).without([not one.edges for one in content.each])

    def _drawn(self, highlights: Highlights, occluders: Sequence[Occluder], core: Box) -> Tensor:
        """The discs of highlights behind surfaces, for each part of the aperture."""
        radii, (aperture, parts, *_) = self._frame.slices.radii, self._frame.division
        barrel = views_of(self._frame, highlights.at, core, self._grid.box)
        return draw(highlights, occluders, radii, aperture, parts, core, barrel)

    def _fractions_within(
        self, bounds: Box, signed_radius: Tensor, groups: list[slice]
    ) -> list[Tensor] | None:
        """For each group the shares of its parts that look into a box; None if all are 1."""
        frame, core = self._frame, self._grid.box
        if self._is_inside(core, bounds):
            return None
        aperture, parts, *_ = frame.division
        seen, position, size = corner_views(frame, core), core.seen_from(bounds), bounds[2:]
        fractions = [
            fraction_in_frame(signed_radius, position, size, aperture, parts[group], seen)
            for group in groups
        ]
        return [blended(fraction, core, core) for fraction in fractions] if seen else fractions

    def _in_front(
        self, unmixed_pixels: Unmixed, signed_radius: Tensor, positions: Tensor
    ) -> Sliced:
        """The visible surfaces, from pixels, their radii, and their positions."""
        frame, inside = self._frame, self._inside
        radii, (aperture, parts, _, groups) = frame.slices.radii, frame.division
        around = inside.grown(AROUND, Box(0, 0, *signed_radius.shape[-2:]))
        inner, radius = inside.seen_from(around), around.of(signed_radius)
        positions = around.of(positions)
        lean = shifts = None
        if frame.content.tilted:
            lean = slopes(radius, frame.quality.min_slope)
        if frame.settings.left_right and frame.copies_in_focus:
            color = around.of(unmixed_pixels.color)
            shifts = Shifts(color, radius, positions, inner, radii, aperture, parts[groups[-1]])
        lean = None if lean is None else inner.of(lean)
        samples = SurfaceSamples.within(
            inside, unmixed_pixels, inner.of(positions), radii, lean, shifts, self._others
        )
        return self._sliced(samples)

    def _sliced(self, samples: SurfaceSamples) -> Sliced:
        """Visible samples whose light reaches the region, and what they are continued by."""
        samples = samples._replace(around=self._inner.seen_from(self._held))
        return self._blur.sliced(samples, 1, self._frame.slices.visible.layers)

    def _fillings(
        self,
        color: Tensor,
        signed_radius: Tensor,
        backdrop: Backdrop | SurfacesOfColors,
        outer: Box,
    ) -> list[Filling]:
        """The hidden surfaces that have pixels; nothing is invented where a surface is known."""
        frame, held, inside = self._frame, self._held, self._inside
        if isinstance(backdrop, Backdrop):
            invented = continued(color, signed_radius, backdrop, outer, inside, frame)
        else:
            invented = self._shared.hidden if self._shared else None
        if invented is None:
            return []
        surfaces = [(invented, False)]
        if (hidden := self._scene.hidden) is not None:
            known = known_within(hidden, held, inside.of(signed_radius), frame.dtype)
            known, invented = separated(known, invented, axes(frame.size, held.top, held.left))
            surfaces = [(known, True), (invented, False)]
        return [
            Filling(frame, self._grid, (held, self._inner), surface, known=is_known)
            for surface, is_known in surfaces
            if bool(surface.mask.any())
        ]

    def tile(self, index: int) -> Views:
        """The views of one tile of the region."""
        frame, box = self._frame, self._tiles[index]
        compositor, needed = self._composited(index)
        whole, *halves = self._lit(compositor.by_group, index)
        trust = self._trust(whole[:, -1], compositor.invented, box)
        counts, content = self._counts(index, needed), frame.content
        _, parts, weights, groups = frame.division
        centre = self._range.bounded(picture(whole, weights[groups[0]]))
        if not frame.settings.left_right:
            return Views([centre], trust, counts, box)
        both = halves[0] if halves else whole
        if compositor.moved is not None:
            both = add_light(both, compositor.moved)
        cut = sum(part.is_left for part in parts[groups[-1]])
        left = picture(both[:cut], weights[groups[-1]][:cut])
        right = picture(both[cut:], weights[groups[-1]][cut:])
        counts |= count_negative(torch.stack([left, right]), content.limit, content.minimum)
        images = self._paired(centre, left, right)
        images = frame.settings.dual_pixel.crossed(images, centre)
        return Views([centre, *images], trust, counts, box)

    def _paired(self, centre: Tensor, left: Tensor, right: Tensor) -> Tensor:
        """Left and right [2, C, h, w], whose mean is the centre [C, h, w]."""
        fraction, minimum = self._frame.division.left_fraction, self._frame.content.minimum
        pair = pair_of(centre, left, right, minimum=minimum, fraction=fraction)
        return self._range.bounded_pair(pair, centre, fraction)

    def _trust(self, covered: Tensor, invented: Tensor | None, box: Box) -> Tensor:
        """The share of the aperture that saw the scene, [1, h, w].

        Of the coverage [m, h, w] of m parts the share that is not invented, times the share of the
        parts that looks into the frame: what surfaces are continued by was not seen.
        """
        mean = self._frame.division.mean
        observed = covered if invented is None else covered - invented
        fraction = mean(observed) / mean(covered)
        if self._in_frame is not None and not self._is_inside(box, self._frame.box):
            expected = box.seen_from(self._tiles[0]).of(self._in_frame[0])
            fraction = fraction * mean(expected[:, 0])
        return fraction.clamp(0, 1)[None]

    def _composited(self, index: int) -> tuple[TileCompositor, list[Filling]]:
        """The views of a tile by the parts of the aperture, and the hidden surfaces they needed."""
        compositor, visible = self._blank(index), self._blur.over_tile(self._visible, index)
        composite_order, reaching = self._frame.slices.composite_order, self._reaching(index)
        return compositor, add_in_order(compositor, visible, reaching, composite_order, index)

    def _blank(self, index: int) -> TileCompositor:
        """The views of a tile without surfaces."""
        size, like = self._tiles[index][2:], self._like
        blank = [
            like.new_zeros(group.stop - group.start, len(like) + 1, *like.shape[1:-2], *size)
            for group in self._frame.division.groups
        ]
        sight = self._sight and self._sight.over(self._tiles[index].seen_from(self._tiles[0]))
        return TileCompositor(blank, self._full(index), sight)

    def _reaching(self, index: int) -> list[Filling]:
        """The hidden surfaces that reach a tile, known before invented."""
        return [surface for surface in self._hidden if surface.plan[index]]

    def _lit(self, views: list[Tensor], index: int) -> list[Tensor]:
        """The views of each group of parts, with highlights.

        A picture is divided by its coverage, which highlights do not share: they are weighted by
        it, so that errors of the coverage do not make them brighter.
        """
        box = self._tiles[index].seen_from(self._tiles[0])
        if self._fallback is not None:
            views = [view + box.of(self._fallback) for view in views]
        if self._highlights is None:
            return views
        lit, groups = box.of(self._highlights), self._frame.division.groups
        inside: list[Tensor | float] = [1.0 for _ in groups]
        if self._in_scene is not None:
            inside = [box.of(fraction) for fraction in self._in_scene]
        return [
            add_light(view, lit[group] * (view[:, -1:] / fraction))
            for view, group, fraction in zip(views, groups, inside, strict=True)
        ]

    def _is_inside(self, box: Box, bounds: Box) -> bool:
        """Whether no light from beyond a larger rectangle reaches a rectangle."""
        return box == box.grown(0, bounds.shrunk(self._frame.farthest))

    def _full(self, index: int) -> list[Tensor | float]:
        """The greatest coverage in a tile, for each group."""
        tile, frame = self._tiles[index], self._frame
        if self._in_scene is None or not frame.content.edges or self._is_inside(tile, frame.scene):
            return [1.0 for _ in frame.division.groups]
        box = tile.seen_from(self._tiles[0])
        return [box.of(fraction) for fraction in self._in_scene]

    def _counts(self, index: int, needed: list[Filling]) -> dict[str, int]:
        """Counts of the work done for a tile, and of the work of a renderer that skips nothing."""
        windows, area = self._frame.slices.visible.windows, self._tiles[index].area
        reaching, pieces = self._reaching(index), self._visible.pieces[index]
        visible = [windows[slice_index] for slice_index in self._visible.surface.plan[index]]
        hidden = [
            surface.windows[slice_index]
            for surface in reaching
            for slice_index in surface.plan[index]
        ]
        done = [(window, window.level) for window in visible]
        done += [
            (surface.windows[slice_index], surface.level + surface.windows[slice_index].level)
            for surface in needed
            for slice_index in surface.plan[index]
        ]
        counts = {
            "pixels": area,
            "pixels_copied": 0 if any(window.margin for window in visible + hidden) else area,
            "tiles": 1,
            "slice_tiles": 2 * len(windows),
            "slice_tiles_done": len(done),
            "slice_tiles_blurred": sum(window.margin > 0 for window, _ in done),
            "slice_tiles_reduced": sum(level > 0 for _, level in done),
            "slice_tiles_culled": len(visible) + len(hidden) - len(done),
            "layer_pixels": area * len(pieces),
            "layer_pixels_done": sum(piece.patch.shown.area for piece in pieces),
            "tiles_culled": int(len(needed) < len(reaching)),
            "tiles_with_hidden": int(any(not surface.known for surface in reaching)),
        }
        pictures = math.prod(self._like.shape[1:-2])
        return {name: pictures * count for name, count in counts.items()}

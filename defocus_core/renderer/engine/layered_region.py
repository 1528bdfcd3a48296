"""A region of layers with coverage: visible and hidden samples, and what is continued behind."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from defocus_core.depth.matting import Unmixed, whole
from defocus_core.renderer.blur.layer_blur import Sliced
from defocus_core.renderer.compositing.aperture_views import TileCompositor
from defocus_core.renderer.compositing.bokeh_discs import Occluder
from defocus_core.renderer.compositing.frame_border import border_fallback
from defocus_core.renderer.compositing.highlights import Highlights, split_samples
from defocus_core.renderer.compositing.saturating_sum import within_alpha
from defocus_core.renderer.compositing.sight import Openings
from defocus_core.renderer.engine.frame import SharedFrame
from defocus_core.renderer.engine.layer_order import Filling, add_in_order
from defocus_core.renderer.engine.region import Region
from defocus_core.renderer.engine.scene import Scene, SurfacesOfColors, continued
from defocus_core.renderer.inpainting.frame_pyramid import Backdrop
from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer, separated
from defocus_core.renderer.layers.samples import Sampled, SampleStack, SurfaceSamples
from defocus_core.renderer.layers.slice_radii import slice_position
from defocus_core.tensors.box import Box, Grid
from defocus_core.tensors.pyramid import axes

# Samples at the border of the frame that are looked up at once; bounds memory.
_SAMPLES_AT_ONCE = 1 << 17


class LayeredRegion(Region):
    """A rectangle of tiles of layers with coverage, and everything that they share."""

    def __init__(
        self,
        frame: SharedFrame,
        grid: Grid,
        scene: Scene,
        backdrop: Backdrop | SurfacesOfColors | None,
        shown: Unmixed | None = None,
    ) -> None:
        """Find the samples of a region, and prepare their blur.

        `backdrop`: the frame at low resolution; None if nothing in it is continued.
        """
        assert scene.layered is not None, "a scene of layers"
        self._layered = scene.layered
        self._behind: Sliced | None = None
        self._nothing: Sliced | None = None
        super().__init__(frame, grid, scene, backdrop, shown)
        if self._fallback is not None:  # with alpha, and without the light of highlights
            plain = grid.box.of(scene.image).to(frame.dtype).clamp(max=frame.content.limit)
            self._fallback = border_fallback(plain, frame.trace)

    def _surfaces(
        self, pixels: Tensor, signed_radius: Tensor, outer: Box
    ) -> tuple[Unmixed, Tensor, Highlights | None]:
        """The visible samples in the rectangle `outer`; plans the hidden ones."""
        frame = self._frame
        stack = self._layered.stack(outer, frame.dtype)
        inmost = self._grid.box.seen_from(outer)
        weights = stack.color[1:, -1] * stack.through[1:-1]
        self._shown = inmost.of(stack.signed_radius[1:]), inmost.of(weights)
        hidden, self._is_known = stack.hidden(), stack.knows_behind()
        if hidden is not None:
            self._behind = self._sliced(self._within(hidden, stack.signed_radius[0]))
        if self._layered.open and self._layered.is_continued:
            self._nothing = self._sliced(self._uncovered(stack))
        self._solid, radius = stack.solid(self._layered.limits[1]), stack.signed_radius[0]
        slices, opaque = frame.slices, stack.opaque()
        self._openings = Openings.of(opaque, slices.radii, slices.visible.layers).over(inmost)
        samples, highlights = split_samples(
            stack.visible(), len(pixels) - 1, radius, frame.content.limit
        )
        self._others = samples.others
        return samples.nearest, radius, highlights

    def _limits_of_sight(self, signed_radius: Tensor, positions: Tensor, core: Box) -> None:
        """None: openings are of samples."""
        return

    def _fractions_within(
        self, bounds: Box, signed_radius: Tensor, groups: list[slice]
    ) -> list[Tensor] | None:
        """As of a picture, but the mean over what shows of the samples of each pixel."""
        total = super()._fractions_within(bounds, signed_radius, groups)
        if total is None:
            return None
        radii, weights = self._shown
        total = [fraction * (1 - weights.sum(0)) for fraction in total]
        layers = max(1, _SAMPLES_AT_ONCE // signed_radius.numel())
        for first in range(0, len(radii), layers):
            radius, weight = (x[first : first + layers] for x in (radii, weights))
            fractions = super()._fractions_within(bounds, radius, groups) or []
            total = [
                so_far + (fraction * weight).sum(2)
                for so_far, fraction in zip(total, fractions, strict=True)
            ]
        return total

    def _drawn(self, highlights: Highlights, occluders: Sequence[Occluder], core: Box) -> Tensor:
        """The discs of highlights; what hides a part of a light is in its coverage already."""
        positions = slice_position(self._solid, self._frame.slices.radii)
        solid = Occluder(self._solid, positions, torch.ones_like(positions))
        return super()._drawn(highlights, [solid], core)

    def _within(self, samples: Sampled, signed_radius: Tensor) -> SurfaceSamples:
        """The samples that reach the tiles, of the pixels of the rectangle around."""
        radii, inside = self._frame.slices.radii, self._inside
        positions = slice_position(inside.of(signed_radius), radii)
        return SurfaceSamples.within(
            inside, samples.nearest, positions, radii, others=samples.others
        )

    def _uncovered(self, stack: SampleStack) -> SurfaceSamples:
        """What no sample covers, as a surface without colours."""
        rest = stack.through[-1:]
        blank = whole(rest[:0], rest[0])._replace(coverage=rest)
        return self._within(Sampled(blank, []), torch.full_like(rest[0], self._layered.limits[1]))

    def _fillings(
        self,
        color: Tensor,
        signed_radius: Tensor,
        backdrop: Backdrop | SurfacesOfColors,
        outer: Box,
    ) -> list[Filling]:
        """What is continued: surfaces behind pixels of which no sample tells what is behind."""
        frame, held, inside = self._frame, self._held, self._inside
        assert isinstance(backdrop, Backdrop), "layers of all colours"
        invented = continued(color, signed_radius, backdrop, outer, inside, frame)
        if invented is not None and self._is_known is not None:
            everywhere = torch.full_like(signed_radius, torch.inf)
            known = HiddenLayer(*map(inside.of, (color, everywhere, self._is_known)))
            _, invented = separated(known, invented, axes(frame.size, held.top, held.left))
        if invented is None or not bool(invented.mask.any()):
            return []
        return [Filling(frame, self._grid, (held, self._inner), invented, known=False)]

    def _paired(self, centre: Tensor, left: Tensor, right: Tensor) -> Tensor:
        """As of a picture; alpha is 1 at most."""
        pair = super()._paired(centre, left, right)
        return within_alpha(pair, self._frame.division.left_fraction)

    def _composited(self, index: int) -> tuple[TileCompositor, list[Filling]]:
        """The views of a tile by the parts of the aperture, and the hidden surfaces they needed."""
        compositor, reaching = self._blank(index), self._reaching(index)
        openings = self._openings.over(self._tiles[index].seen_from(self._tiles[0]))
        visible = self._blur.over_tile(self._visible, index)
        if self._nothing is not None:
            compositor.reserve(self._blur.over_tile(self._nothing, index))
        if self._behind is None:
            composite_order = self._frame.slices.composite_order
            needed = add_in_order(compositor, visible, reaching, composite_order, index)
        else:
            hidden = self._blur.over_tile(self._behind, index)
            compositor.add_known(visible, hidden, openings, closed=not self._layered.open)
            compositor.close(openings)
            needed = [] if compositor.are_nearly_full() else reaching
            for surface in needed:
                compositor.fill(surface.over_tile(index).whole(), known=surface.known)
        if not self._layered.blurs_alpha:
            compositor.add_alpha()
        if self._layered.open:
            compositor.leave_open()
        return compositor, needed

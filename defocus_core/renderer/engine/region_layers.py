"""The layers of a region: what a picture, or layers with coverage, show and hide there.

A layer is colour, coverage and radii, nearest first; each kind of layer is seen otherwise. The
batch of small pictures and colours that are rendered apart give layers of the same form.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.optics.parts import Part
from defocus_core.renderer.blur.layer_blur import blended
from defocus_core.renderer.compositing.highlights import (
    Highlights,
    draw,
    occluders_of,
    split,
)
from defocus_core.renderer.compositing.sight import (
    Openings,
    SightLimits,
    fraction_in_frame,
)
from defocus_core.renderer.engine.frame import (
    SharedFrame,
    corner_views,
    views_of,
)
from defocus_core.renderer.engine.layer_order import Filling
from defocus_core.renderer.engine.scene import (
    RegionSurfaces,
    Scene,
    SurfacesOfColors,
    continued,
    layers_within,
)
from defocus_core.renderer.inpainting.frame_pyramid import Backdrop, backdrop_of
from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer, without_known
from defocus_core.renderer.layers.layer import (
    HIDDEN,
    SOLID,
    UNCOVERED,
    VISIBLE,
    SampleLayer,
    of_slices,
)
from defocus_core.renderer.layers.samples import Layered
from defocus_core.renderer.layers.slice_radii import slice_position
from defocus_core.renderer.layers.sliced_surface import SurfaceSamples
from defocus_core.renderer.layers.slopes import AROUND, Shifts, slopes
from defocus_core.tensors.box import Box, Grid
from defocus_core.tensors.pyramid import axes

# Samples at the border of the frame that are looked up at once; bounds memory.
_SAMPLES_AT_ONCE = 1 << 17


class RegionPlace(NamedTuple):
    """Where a region lies; the rectangles are those of the frame unless it is said."""

    frame: SharedFrame
    grid: Grid
    outer: Box  # all that its pixels depend on
    held: Box  # what light reaches it from
    inner: Box  # the same with what lies beyond the frame
    inside: Box  # `held` within `outer`
    core: Box  # its tiles within `outer`

    @classmethod
    def of(cls, frame: SharedFrame, grid: Grid) -> RegionPlace:
        """The place of the tiles of a region."""
        box = grid.box
        outer = box.grown(frame.margin, frame.box)
        reach = max(frame.farthest + frame.farthest % 2, *frame.beyond)  # even: it may be halved
        held, inner = box.grown(reach, frame.box), box.grown(reach, frame.scene)
        return cls(frame, grid, outer, held, inner, held.seen_from(outer), box.seen_from(outer))

    def fills(self, surface: HiddenLayer | None) -> list[Filling]:
        """A hidden surface to composite; nothing if it has no pixel."""
        if surface is None or not bool(surface.mask.any()):
            return []
        return [Filling(self.frame, self.grid, (self.held, self.inner), surface)]

    def fractions(self, bounds: Box, signed_radius: Tensor, parts: list[Part]) -> Tensor | None:
        """The shares [m, 1, ..., h, w] of parts that look into a box; None if all are 1."""
        frame, core = self.frame, self.grid.box
        if frame.is_inside(core, bounds):
            return None
        aperture = frame.division.aperture
        seen, position, size = corner_views(frame, core), core.seen_from(bounds), bounds[2:]
        fractions = fraction_in_frame(signed_radius, position, size, aperture, parts, seen)
        return blended(fractions, core, core) if seen else fractions


class RegionLayers(NamedTuple):
    """What is seen in the rectangle `outer` of a region."""

    # Those of each kind, nearest first; that of the surface that the depth names comes first
    layers: tuple[SampleLayer, ...]
    positions: Tensor  # [H, W] of the first layer, between slice radii
    highlights: Highlights | None
    invented: list[Filling]  # surfaces that are continued behind edges
    # How far the lens sees in the tiles: of a picture, by slices; of layers, past opaque samples
    sight: SightLimits | Openings | None

    def of(self, kind: str) -> list[SampleLayer]:
        """The layers of a kind."""
        return [layer for layer in self.layers if layer.kind == kind]


def of_picture(
    place: RegionPlace,
    scene: Scene,
    image: Tensor,
    signed_radius: Tensor,
    backdrop: Backdrop | SurfacesOfColors | None,
) -> RegionLayers:
    """What a picture [C, H, W] and its radii show and hide."""
    frame, content, slices = place.frame, place.frame.content, place.frame.slices
    of_all: RegionSurfaces | None = None
    layers: tuple[SampleLayer, ...] = (SampleLayer.whole(image, signed_radius),)
    if isinstance(backdrop, SurfacesOfColors):
        of_all = backdrop.at(place.outer, place.inside)
        layers = of_all.layers
    elif backdrop is not None:
        layers = layers_within(image, signed_radius, backdrop, place.outer)
    highlights = None
    if content.highlights:
        layers, highlights = split(layers, len(image), content.limit)
    positions, sight = slice_position(signed_radius, slices.radii), None
    if content.edges:
        sight = SightLimits.of(signed_radius, positions, slices.visible.layers, slices.octaves)
        sight = sight.over(place.core).without([not one.edges for one in content.each])
    invented = of_all.hidden if of_all else None
    if isinstance(backdrop, Backdrop):
        around = place.outer, place.inside
        invented = continued(layers[0], backdrop, *around, frame)
    return RegionLayers(layers, positions, highlights, place.fills(invented), sight)


def of_layers(
    place: RegionPlace,
    layered: Layered,
    image: Tensor,
    backdrop: Backdrop | SurfacesOfColors | None,
) -> RegionLayers:
    """What layers show and hide; `image`: [C + 1, H, W], the picture of them in focus."""
    frame, slices = place.frame, place.frame.slices
    stack = layered.stack(place.outer, frame.dtype)
    radius = stack.signed_radius[0]
    visible, hidden = stack.visible(), stack.hidden()
    if layered.mixed and isinstance(backdrop, Backdrop):
        own, *nearer = layers_within(visible[0].color, radius, backdrop, place.outer)
        visible = (own, *visible[1:], *nearer)
        if nearer:  # which hide a part of it
            hidden = (own._replace(coverage=1 - own.coverage, sparse=True), *hidden[1:])
    layers, highlights = split(visible, len(image) - 1, frame.content.limit)
    if highlights is not None:  # with an alpha of 0
        light = torch.cat([highlights.light, torch.zeros_like(highlights.light[:, :1])], 1)
        highlights = highlights._replace(light=light)
    solid = SampleLayer.whole(image[:0], stack.solid(layered.limits[1]))
    others = [*(layer._replace(kind=HIDDEN) for layer in hidden), solid._replace(kind=SOLID)]
    if layered.open and layered.is_continued:
        rest, farthest = stack.through[-1:], torch.full_like(radius, layered.limits[1])
        others.append(SampleLayer(rest[:0], rest, farthest, sparse=True, kind=UNCOVERED))
    fills = list[Filling]()
    if backdrop is not None:
        assert isinstance(backdrop, Backdrop), "layers of all colours"
        around = place.outer, place.inside
        invented, known = continued(layers[0], backdrop, *around, frame), stack.knows_behind()
        if invented is not None and known is not None:
            behind = place.inside.of(known), place.inside.of(stack.signed_radius[-1])
            middle = axes(frame.size, place.held.top, place.held.left)
            invented = without_known(invented, *behind, middle)
        fills = place.fills(invented)
    openings = Openings.of(stack.opaque(), slices.radii, slices.visible.layers)
    positions = slice_position(radius, slices.radii)
    sight = openings.over(place.core)
    return RegionLayers((*layers, *others), positions, highlights, fills, sight)


def samples_within(place: RegionPlace, layers: Sequence[SampleLayer]) -> SurfaceSamples:
    """The samples whose light reaches the tiles."""
    radii = place.frame.slices.radii
    layers = [layer.within(place.inside) for layer in layers]
    if len(layers) > len(radii) + 1:
        layers = [layers[0], *of_slices(layers[1:], radii)]
    return SurfaceSamples(layers, slice_position(layers[0].signed_radius, radii))


def visible_samples(place: RegionPlace, seen: RegionLayers) -> SurfaceSamples:
    """The visible samples whose light reaches the tiles, with their slopes and shifts."""
    frame, inside, first = place.frame, place.inside, seen.layers[0]
    radii, division = frame.slices.radii, frame.division
    around = inside.grown(AROUND, Box(0, 0, *first.signed_radius.shape[-2:]))
    inner, radius = inside.seen_from(around), around.of(first.signed_radius)
    positions = around.of(seen.positions)
    lean = shifts = None
    if frame.content.tilted:
        lean = slopes(radius, frame.quality.min_slope)
    if frame.settings.left_right and frame.copies_in_focus:
        color = around.of(first.color)
        halves = division.parts[division.pair]
        shifts = Shifts(color, radius, positions, inner, radii, division.aperture, halves)
    lean = None if lean is None else inner.of(lean)
    samples = samples_within(place, seen.of(VISIBLE))
    return samples._replace(positions=inner.of(positions), slopes=lean, shifts=shifts)


def fractions_seen(
    place: RegionPlace, seen: RegionLayers, bounds: Box, parts: list[Part]
) -> Tensor | None:
    """As `RegionPlace.fractions`, in the mean over the visible samples of each pixel."""
    first, *others = (layer.within(place.core) for layer in seen.of(VISIBLE))
    radius = first.signed_radius
    total = place.fractions(bounds, radius, parts)
    if total is None or not first.sparse or not others:  # of a picture, its own surface alone
        return total
    radii = torch.stack([layer.signed_radius for layer in others])
    weights = torch.stack([layer.covered for layer in others])
    total = total * (1 - weights.sum(0))
    at_once = max(1, _SAMPLES_AT_ONCE // radius.numel())
    for start in range(0, len(radii), at_once):
        radius, weight = (x[start : start + at_once] for x in (radii, weights))
        fractions = place.fractions(bounds, radius, parts)
        if fractions is not None:
            total = total + (fractions * weight).sum(2)
    return total


def discs(place: RegionPlace, seen: RegionLayers, highlights: Highlights) -> Tensor:
    """The discs of highlights behind surfaces, for each part of the aperture.

    Of layers, what hides a part of a light is in its coverage already.
    """
    radii, (aperture, parts, *_) = place.frame.slices.radii, place.frame.division
    occluders = occluders_of(seen.of(SOLID) or seen.layers, radii)
    barrel = views_of(place.frame, highlights.at, place.core, place.grid.box)
    return draw(highlights, occluders, radii, aperture, parts, place.core, barrel)


def backdrop_in(frame: SharedFrame, scene: Scene) -> Backdrop | SurfacesOfColors | None:
    """What hidden surfaces are continued from; None if none is."""
    content, layered = frame.content, scene.layered
    if not content.edges or scene.surfaces is not None:
        return scene.surfaces if content.edges else None
    if layered is not None and not layered.is_continued:
        return None
    pixels, limit = scene.image, content.limit
    if layered is not None:
        if not layered.blurs_alpha:
            in_memory = isinstance(pixels, Tensor)
            pixels = pixels[:-1] if in_memory else layered.picture(alpha=False)
        limit = max(limit, 1.0)  # alpha is no light
    return backdrop_of(
        pixels,
        scene.signed_radius,
        limit,
        frame.dtype,
        frame.settings.threads,
        content.limits,
        unmixes=frame.quality.unmixes and (layered is None or layered.mixed),
        matte=scene.matte,
    )

"""The layers of a region: visible and hidden surfaces of a picture, or of a layered scene.

A layer has colour, coverage and radii. Visible layers come first, the nearest at the front.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.optics.parts import Part
from defocus_core.renderer.compositing.highlights import Highlights, draw, split
from defocus_core.renderer.compositing.sight import Openings, Sight, SightLimits
from defocus_core.renderer.engine.frame import RegionPlace, SharedFrame, views_of
from defocus_core.renderer.engine.scene import InFocus
from defocus_core.renderer.inpainting.frame_pyramid import Backdrop, backdrop_of
from defocus_core.renderer.inpainting.hidden_layers import hidden_layer, without_known
from defocus_core.renderer.layers.alpha import Alpha, color_of
from defocus_core.renderer.layers.layer import (
    CONTINUED,
    HIDDEN,
    SOLID,
    TRACE,
    UNCOVERED,
    VISIBLE,
    SampleLayer,
    layers_of,
    mixed_within,
    of_slices,
)
from defocus_core.renderer.layers.samples import Layered
from defocus_core.renderer.layers.slice_radii import slice_position
from defocus_core.renderer.layers.sliced_surface import SurfaceSamples
from defocus_core.renderer.layers.slopes import AROUND, Shifts, slopes
from defocus_core.tensors.box import Box
from defocus_core.tensors.pyramid import axes


class RegionLayers(NamedTuple):
    """The layers in the rectangle `outer` of a region."""

    # Visible layers first, nearest first; of a picture, the surface at its depth is the first
    layers: tuple[SampleLayer, ...]
    lights: list[Highlights]  # the highlights, drawn one by one
    # How far the lens sees in the tiles: of a picture, by slices; of layers, past opaque samples.
    # None where no surface hides another
    sight: Sight | None

    def layers_of(self, kind: str) -> list[SampleLayer]:
        """The layers of the given kind."""
        return [layer for layer in self.layers if layer.kind == kind]


def layers_at(place: RegionPlace, scene: InFocus, backdrop: Backdrop | None) -> RegionLayers:
    """The layers of a region of a scene.

    `backdrop`: the frame at low resolution, from which hidden surfaces are continued; None to
    continue none.
    """
    frame = place.frame
    surface = scene.surface
    both = surface.image, surface.signed_radius
    image, radius = (place.outer.crop(x).to(frame.dtype) for x in both)
    if frame.content.edges:  # pixels beside them are looked up by their numbers
        image, radius = image.contiguous(), radius.contiguous()
    if scene.layers is not None:
        seen = _of_layers(place, scene.layers, backdrop)
        plain = image.clamp(max=frame.content.limit)  # with alpha, without the light of highlights
    else:
        seen = _of_picture(place, image, radius, backdrop)
        plain = seen.layers[0].color
    if not frame.trace:
        return seen
    trace = SampleLayer(plain, torch.full_like(plain[:1], frame.trace), radius, kind=TRACE)
    return seen._replace(layers=(*seen.layers, trace))


def _of_picture(
    place: RegionPlace,
    image: Tensor,  # [C, ..., H, W]
    radius: Tensor,  # [..., H, W] px
    backdrop: Backdrop | None,
) -> RegionLayers:
    """The layers of a picture in a region, visible and hidden, and its highlights."""
    frame, content, slices = place.frame, place.frame.content, place.frame.slices
    layers: Sequence[SampleLayer] = (SampleLayer.whole(image, radius),)
    lights, behind, sight = list[Highlights](), list[SampleLayer](), None
    if backdrop is not None:
        whole, mixed = place.outer[2:] == backdrop.size, backdrop.mixed
        layers = layers_of(image, radius, mixed if whole else mixed_within(mixed, place.outer))
    if content.highlights:
        layers, lights = split(layers, len(image), content.limit)
    if content.edges:
        positions = slice_position(radius, frame.radii)
        sight = SightLimits.from_radius(radius, positions, slices.visible.layers, slices.octaves)
        sight = sight.crop(place.core)
    if backdrop is not None:
        behind = [*continued(layers[0], backdrop, place.outer, place.inside, frame)]
    return RegionLayers((*layers, *behind), lights, sight)


def _of_layers(place: RegionPlace, layered: Layered, backdrop: Backdrop | None) -> RegionLayers:
    """The layers of a layered scene in a region, visible and hidden, and its highlights."""
    frame, slices = place.frame, place.frame.slices
    stack = layered.stack(place.outer, frame.dtype)
    radius, others, sight = stack.signed_radius[0], list[SampleLayer](), None
    visible, hidden = stack.visible(), stack.hidden()
    layers, lights = split(visible, layered.colors.shape[1], frame.content.limit)
    if hidden:
        others = [layer._replace(kind=HIDDEN) for layer in hidden]
        sight = Openings.from_samples(stack.opaque(), frame.radii, slices.visible.layers)
        sight = sight.crop(place.core)
    solid = SampleLayer.whole(stack.color[0, :0], stack.solid(layered.limits[1]))
    others.append(solid._replace(kind=SOLID))
    if layered.open and layered.is_continued:
        rest, farthest = stack.through[-1:], torch.full_like(radius, layered.limits[1])
        others.append(SampleLayer(rest[:0], rest, farthest, sparse=True, kind=UNCOVERED))
    if backdrop is not None:
        known = stack.known_behind(place.inside)
        others += continued(layers[0], backdrop, place.outer, place.inside, frame, known)
    return RegionLayers((*layers, *others), lights, sight)


def samples_within(place: RegionPlace, layers: Sequence[SampleLayer]) -> SurfaceSamples:
    """The samples of layers whose light reaches the tiles of a region."""
    radii = place.frame.radii
    layers = [layer.crop(place.inside) for layer in layers]
    if len(layers) > len(radii) + 1:
        layers = [layers[0], *of_slices(layers[1:], radii)]
    return SurfaceSamples(layers)


def visible_samples(place: RegionPlace, seen: RegionLayers) -> SurfaceSamples:
    """The visible samples whose light reaches the tiles of a region, with slopes and shifts."""
    frame, inside, first = place.frame, place.inside, seen.layers[0]
    around = inside.grown(AROUND, Box(0, 0, *first.signed_radius.shape[-2:]))
    inner, radius = inside.seen_from(around), around.crop(first.signed_radius)
    lean = shifts = None
    if frame.content.tilted:
        found = slopes(radius, frame.quality.min_slope)
        lean = None if found is None else inner.crop(found)
    # where the number of slices was asked for, pixels in focus are no copies
    if frame.settings.left_right and frame.settings.num_layers is None:
        color, division = around.crop(first.color), frame.division
        halves = division.parts[division.pair]
        shifts = Shifts(color, radius, inner, frame.radii, division.aperture, halves)
    samples = samples_within(place, seen.layers_of(VISIBLE))
    return samples._replace(slopes=lean, shifts=shifts)


def fractions_seen(
    place: RegionPlace, seen: RegionLayers, bounds: Box, parts: list[Part]
) -> Tensor | float:
    """The share [m, 1, h, w] of each part that sees `bounds`, or 1.0 if all shares are 1.

    It is the mean of `RegionPlace.fractions` over the visible samples of each pixel.
    """
    if place.frame.is_inside(place.grid.box, bounds):
        return 1.0
    first, *others = (layer.crop(place.core) for layer in seen.layers_of(VISIBLE))
    total = of_first = place.fractions(bounds, first.signed_radius, parts)
    for layer in others if first.sparse else ():  # of a picture, its own surface alone
        own = place.fractions(bounds, layer.signed_radius, parts)
        total = total + (own - of_first) * layer.covered
    return total


def discs(place: RegionPlace, seen: RegionLayers, highlights: Highlights) -> Tensor:
    """The discs [M, C, h, w] of highlights through each part, clipped by nearer surfaces.

    The coverage of a highlight in its layer already excludes what other layers hide of it.
    """
    radii, (aperture, parts, *_) = place.frame.radii, place.frame.division
    before = seen.layers_of(SOLID) or seen.layers_of(VISIBLE)
    barrel = views_of(place.frame, highlights.at, place.core, place.grid.box)
    return draw(highlights, before, radii, aperture, parts, place.core, barrel)


def backdrop_in(frame: SharedFrame, scene: InFocus) -> Backdrop | None:
    """The backdrop from which hidden surfaces are continued; None if no surface is continued."""
    content, (surface, layered, _) = frame.content, scene
    if not content.edges or (layered is not None and not layered.is_continued):
        return None
    pixels, limit = surface.image, content.limit
    if layered is not None:
        pixels = pixels if layered.alpha is Alpha.BLURRED else color_of(pixels)
        limit = max(limit, 1.0)  # alpha is no light
    return backdrop_of(
        pixels,
        surface.signed_radius,
        limit,
        frame.dtype,
        content.limits,
        unmixes=layered is None,
        matte=surface.matte,
    )


def continued(
    layer: SampleLayer,
    backdrop: Backdrop,
    outer: Box,
    inside: Box,
    frame: SharedFrame,
    known: tuple[Tensor, Tensor] | None = None,
) -> tuple[SampleLayer, ...]:
    """The hidden layer continued behind the edges of a visible one; empty if nothing is hidden.

    `outer`: where the visible layer lies in the frame; `inside`: the rectangle to continue,
    relative to `outer`; `known`: as in `without_known`, within `inside`.
    """
    level = frame.slices.invented.level
    hidden = hidden_layer(layer.color, layer.signed_radius, backdrop, outer, inside, level=level)
    if hidden is not None and known is not None:
        held = inside.top + outer.top, inside.left + outer.left
        hidden = without_known(hidden, *known, axes(frame.size, *held))
    if hidden is None or not bool(hidden.mask.any()):
        return ()
    color, radius, mask = hidden
    coverage = mask[None].to(color)
    return (SampleLayer(color, coverage, radius, sparse=True, kind=CONTINUED),)

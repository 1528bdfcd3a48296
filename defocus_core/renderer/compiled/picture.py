"""The views of a scene of tensors, rendered by the compiled back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from defocus_core.renderer.compiled.arrays import (
    NO_LIGHTS,
    Statistics,
    counts_of,
    render_samples,
    samples_of,
)
from defocus_core.renderer.compiled.back import HiddenSamples, Samples
from defocus_core.renderer.compiled.carried import CHANNELS, by_loops
from defocus_core.renderer.engine.frame import RegionPlace, SharedFrame
from defocus_core.renderer.engine.scene import InFocus
from defocus_core.renderer.layers.layer import CONTINUED, VISIBLE, SampleLayer
from defocus_core.tensors.box import Box, Grid
from defocus_core.tensors.views import ViewTensors


def rendered(in_focus: InFocus, frame: SharedFrame) -> ViewTensors:
    """The views of a scene, which must be a single surface, rendered by compiled loops."""
    statistics = Statistics(*(getattr(frame.content, name) for name in Statistics._fields))
    groups, negative, scene = [], 0, in_focus.surface
    for some, samples, lights in _sampled(in_focus, statistics, frame):
        found, darker = render_samples(samples, lights, statistics, frame.settings, some)
        del samples, lights  # large arrays
        groups.append(torch.from_numpy(found[:, :-1]))
        negative = max(negative, darker)
    images = groups[0] if len(groups) == 1 else torch.cat(groups, 1)
    counts = counts_of(scene.signed_radius.detach().numpy(), negative, frame.settings)
    box = Box(0, 0, *scene.signed_radius.shape)
    return ViewTensors(list(images), torch.from_numpy(found[0, -1:]), counts, box)


def _sampled(
    in_focus: InFocus, statistics: Statistics, frame: SharedFrame
) -> Iterator[tuple[slice, Samples, NDArray[np.float32]]]:
    """Yield the channels that are rendered at once, their surfaces, and lights to add.

    Compiled loops find the surfaces of a picture with three channels, no highlights and no matte;
    torch finds those of other pictures.
    """
    scene, unit = in_focus.surface, statistics.unit
    if by_loops(scene) and not frame.content.highlights:
        image, radius = (x.detach().float().contiguous().numpy() for x in scene.tensors)
        # held by the caller alone, who lets go of them before the next are made
        yield slice(0, CHANNELS), samples_of(image, radius, statistics), NO_LIGHTS
        return
    from defocus_core.renderer.engine.region_layers import backdrop_in, discs, layers_at

    whole, count = frame.box, len(scene.image)
    place = RegionPlace.from_grid(frame, Grid([whole], whole[2:], 1))
    place = place._replace(outer=whole, held=whole, inside=whole, core=whole)
    seen = layers_at(place, in_focus, backdrop_in(frame, in_focus))
    layers, drawn = seen.layers, sum(discs(place, seen, lights) for lights in seen.lights)
    del seen  # also how far is seen, which compiled loops find themselves
    for first in range(0, count, CHANNELS):
        channels = slice(first, min(first + CHANNELS, count))
        lights = NO_LIGHTS
        if isinstance(drawn, Tensor):
            lights = (drawn[:, channels] / unit).float().contiguous().numpy()
        yield channels, _of_layers(layers, channels, unit), lights


def _of_layers(layers: Sequence[SampleLayer], channels: slice, unit: float) -> Samples:
    """Layers as surfaces, with only some of their channels, and with light divided by `unit`."""
    light, radius = _stacked([x for x in layers if x.kind == VISIBLE], channels, unit)
    hidden = None
    if continued := [x for x in layers if x.kind == CONTINUED]:
        behind, px = _stacked(continued, channels, unit)
        hidden = HiddenSamples(behind, px * np.float32(0.5), _range(behind, px))
    return Samples(light, radius, _range(light, radius), hidden)


def _stacked(
    layers: Sequence[SampleLayer], channels: slice, unit: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Light [n, H, 4 W] of n layers, divided by `unit`, and their radii [n, H, W] px.

    channels: the channels of the light.
    """
    size = layers[0].signed_radius.shape
    light = torch.zeros(len(layers), *size, CHANNELS + 1, dtype=torch.float32)
    radius = torch.stack([layer.signed_radius.float() for layer in layers])
    for own, layer in zip(light, layers, strict=True):
        color = layer.color[channels] / unit * layer.coverage
        own[..., : len(color)] = color.movedim(0, -1)
        own[..., -1] = layer.covered
    return light.flatten(2).numpy(), radius.numpy()


def _range(light: NDArray[np.float32], radius: NDArray[np.float32]) -> tuple[float, float]:
    """The least and the greatest radius of pixels with coverage."""
    held = radius[light[..., 3::4] > 0]
    return float(held.min()), float(held.max())

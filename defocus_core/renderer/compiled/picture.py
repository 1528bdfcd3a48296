"""The compiled back of the renderer: the views of a picture."""

from __future__ import annotations

import math
import mmap
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from defocus_core.renderer.compiled import back
from defocus_core.renderer.compiled.back import Sampled, Samples
from defocus_core.renderer.compiled.bands import Bounds
from defocus_core.renderer.compiled.carried import CHANNELS, by_loops, carries_pair
from defocus_core.renderer.compiled.hidden import hidden_of
from defocus_core.renderer.compiled.mixed import find_edges, split_mixed
from defocus_core.renderer.engine.frame import RegionPlace, SharedFrame
from defocus_core.renderer.engine.scene import InFocus, Surface
from defocus_core.renderer.layers.layer import CONTINUED, VISIBLE, SampleLayer
from defocus_core.renderer.layers.slice_radii import SHARP
from defocus_core.tensors.box import Grid
from defocus_core.tensors.views import ViewTensors

# As in `compositing/saturating_sum.py`: how far left and right may exceed the range, and rounding;
# and as in `compositing/left_right.py` the share of light below which nothing is counted.
_OVERSHOOT, _SLACK, _NEGLIGIBLE = 0.1, 9e-5, 1e-3


def rendered(frame: SharedFrame, scene: Surface) -> ViewTensors:
    """The views of a surface that is carried; the centre alone if left and right are not."""
    whole, pair = frame.box, frame.settings.left_right and carries_pair(frame.settings)
    place = RegionPlace.from_grid(frame, Grid([whole], whole[2:], 1))
    place = place._replace(outer=whole, held=whole, inside=whole, core=whole)
    # light has no unit: float32 is fine enough for that of about 1, also its squares
    unit = _unit(frame.content.limit)
    bounds, views = _bounds(frame, len(scene.image), unit), 3 if pair else 1
    groups, negative = list[Tensor](), 0
    for channels, sampled, lights in _sampled(place, scene, unit):
        if lights is None:
            lights = np.zeros((views, CHANNELS, 1, 0), np.float32)
        found, darker = back.render(
            sampled,
            lights[:views],
            bounds._replace(range=np.ascontiguousarray(bounds.range[channels])),
            outline=frame.settings.aperture.fixed.outline,
            min_slope=frame.quality.min_slope,
            edges=frame.content.edges,
            threads=frame.settings.threads,
        )
        del sampled, lights  # large arrays
        groups.append(torch.from_numpy(found[:, :-1]).mul_(unit))
        negative = max(negative, darker)
    trust = torch.from_numpy(found[0, -1:])
    counts = _counts(frame, scene) | ({"pixels_clamped": negative} if pair else {})
    images = groups[0] if len(groups) == 1 else torch.cat(groups, 1)
    return ViewTensors(list(images), trust, counts, whole)


def _sampled(
    place: RegionPlace, scene: Surface, unit: float
) -> Iterator[tuple[slice, Sampled, NDArray[np.float32] | None]]:
    """The channels that are rendered at once, their surfaces, and lights to add, if any.

    Those of three colours without lights and without a matte are found by compiled loops.
    """
    content, count = place.frame.content, len(scene.image)
    if by_loops(scene) and not content.highlights:
        channels = slice(0, CHANNELS)
        if content.edges:  # the samples are held by what takes them apart alone
            yield channels, surfaces_of(_of_picture(scene, unit), content.limit / unit), None
        else:
            yield channels, Sampled(_of_picture(scene, unit), None, None), None
        return
    from defocus_core.renderer.engine.region_layers import backdrop_in, discs, layers_at

    in_focus = InFocus.from_scene(scene)
    seen = layers_at(place, in_focus, backdrop_in(place.frame, in_focus))
    layers, drawn = seen.layers, sum(discs(place, seen, lights) for lights in seen.lights)
    del seen  # also how far is seen, which compiled loops find themselves
    for first in range(0, count, CHANNELS):
        channels = slice(first, min(first + CHANNELS, count))
        lights = None
        if isinstance(drawn, Tensor):
            lights = (drawn[:, channels] / unit).float().contiguous().numpy()
        # held by the caller alone, who lets go of them before the next are made
        yield channels, _of_layers(layers, channels, unit), lights


def _of_layers(layers: Sequence[SampleLayer], channels: slice, unit: float) -> Sampled:
    """The surfaces that layers are, in some of their colours."""
    own, *nearer = (_samples(x, channels, 1, unit) for x in layers if x.kind == VISIBLE)
    hidden = [_samples(x, channels, 2, unit) for x in layers if x.kind == CONTINUED]
    return Sampled(own, nearer[0] if nearer else None, hidden[0] if hidden else None)


def surfaces_of(own: Samples, limit: float) -> Sampled:
    """The surfaces of a picture with edges; limit: brightness that a highlight exceeds."""
    own, nearer = _split_surfaces(own, limit)
    found = hidden_of(own.light, own.radius, nearer and nearer.light, limit)
    if found is None:
        return Sampled(own, nearer, None)
    light, coarse_radius = found
    coarse_radius *= np.float32(0.5)
    return Sampled(own, nearer, Samples(light, coarse_radius))


def _split_surfaces(own: Samples, limit: float) -> tuple[Samples, Samples | None]:
    """The surfaces that the depth names, without parts of nearer ones; and these, if there are."""
    edge, border = np.empty(own.radius.shape, np.uint8), np.empty(own.radius.shape, np.float32)
    if not find_edges(own.radius, edge, border):
        return own, None
    light = own.light.copy()
    others, radii = (_few(values.shape) for values in own)
    found = split_mixed(
        own.light, own.radius, edge, border, np.float32(limit), light, others, radii
    )
    return own._replace(light=light), Samples(others, radii) if found else None


def _few(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Zeros that take memory only where something else is written: NumPy's come in huge pages."""
    private = getattr(mmap, "MAP_PRIVATE", 0) | getattr(mmap, "MAP_ANONYMOUS", 0)
    pages = mmap.mmap(-1, 4 * math.prod(shape), **({"flags": private} if private else {}))
    return np.frombuffer(pages, np.float32).reshape(shape)


def _of_picture(scene: Surface, unit: float) -> Samples:
    """The colours and radii of a picture as arrays."""
    layer = SampleLayer.whole(scene.image.float(), scene.signed_radius)
    return _samples(layer, slice(0, CHANNELS), 1, unit)


def _unit(brightest: float) -> float:
    """A power of two near the brightest light: dividing by it is exact."""
    return 2.0 ** math.floor(math.log2(brightest)) if brightest > 0 else 1.0


def _counts(frame: SharedFrame, scene: Surface) -> dict[str, int]:
    """Counts of the work done."""
    radius = frame.box.crop(scene.signed_radius)
    in_focus = int((radius.abs() <= SHARP).sum())
    return {"pixels": frame.box.area, "pixels_copied": in_focus, "tiles": 1}


def _samples(layer: SampleLayer, channels: slice, step: int, unit: float) -> Samples:
    """A layer as arrays of some of its colours in a unit, its radii in pixels of a step."""
    color = layer.color[channels] / unit
    light = torch.zeros(*color.shape[1:], CHANNELS + 1, dtype=torch.float32)
    light[..., : len(color)] = (color if layer.is_whole else color * layer.coverage).movedim(0, -1)
    light[..., -1] = layer.covered
    radius = (layer.signed_radius / step).float().contiguous()
    return Samples(light.flatten(1).numpy(), radius.numpy())


def _bounds(frame: SharedFrame, channels: int, unit: float) -> Bounds:
    """The bounds of the views of a frame."""
    dtype = np.float64 if frame.dtype == torch.float64 else np.float32
    content, division = frame.content, frame.division
    others = [(content.minimum, math.inf)] * (channels - len(content.channels))
    every: NDArray[Any] = np.array([*content.channels, *others], dtype)
    least, greatest = every.T / unit
    slack = [_SLACK * np.minimum(np.abs(x), greatest - least) for x in (least, greatest)]
    more = _OVERSHOOT * (greatest - least)
    limits = least - slack[0], greatest + slack[1], least - more, greatest + more
    left = float(division.left_fraction) if frame.settings.left_right else 0.5
    apart = float(frame.settings.dual_pixel.separation)
    negative = (content.minimum - _NEGLIGIBLE * content.limit) / unit
    range_ = np.stack(limits, 1).astype(np.float32)
    return Bounds(range_, content.minimum / unit, negative, left, apart)

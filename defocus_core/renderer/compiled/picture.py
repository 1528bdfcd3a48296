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

from defocus_core.depth.ramps import reduction
from defocus_core.renderer.compiled import back
from defocus_core.renderer.compiled.back import HiddenSamples, Samples
from defocus_core.renderer.compiled.bands import Bounds
from defocus_core.renderer.compiled.carried import CHANNELS, by_loops, carries_pair
from defocus_core.renderer.compiled.hidden import hidden_of
from defocus_core.renderer.compiled.look import DepthLook, look_at_depth, look_at_light
from defocus_core.renderer.compiled.mixed import set_light, split_mixed
from defocus_core.renderer.compiled.shifts import may_be_shifted
from defocus_core.renderer.engine.frame import Content, Division, RegionPlace, SharedFrame
from defocus_core.renderer.engine.scene import InFocus, Surface
from defocus_core.renderer.engine.settings import Settings, quality_of
from defocus_core.renderer.inpainting.disocclusion import EDGE
from defocus_core.renderer.layers.layer import CONTINUED, VISIBLE, SampleLayer
from defocus_core.renderer.layers.slice_radii import SHARP, plane_of
from defocus_core.tensors.box import Box, Grid
from defocus_core.tensors.views import ViewTensors

# As in `compositing/saturating_sum.py`: how far left and right may exceed the range, and rounding;
# and as in `compositing/left_right.py` the share of light below which nothing is counted.
_OVERSHOOT, _SLACK, _NEGLIGIBLE = 0.1, 9e-5, 1e-3
# Radius in px up to which no light comes from farther than the renderer goes on beyond the frame.
_WIDEST = 40.0
_MANY = 1 << 22  # numbers from which on it matters that few pages are touched
_NO_LIGHTS = np.zeros((3, CHANNELS, 1, 0), np.float32)


def look_at(surface: Surface, settings: Settings) -> DepthLook:
    """What is seen of the radii of a surface."""
    infinity = math.inf if settings.infinity is None else settings.infinity
    radius = surface.signed_radius.detach().contiguous().numpy()
    return DepthLook(*look_at_depth(radius, infinity, reduction(radius.shape)))


def is_clean(surface: Surface, seen: DepthLook) -> bool:
    """Whether the depth of a surface needs no repair, for certain."""
    if not seen.clean or seen.step <= seen.hard:
        return seen.clean
    image, radius = (x.detach().float().contiguous().numpy() for x in surface.tensors[:2])
    return len(image) == CHANNELS and not may_be_shifted(image, radius, np.float32(seen.hard))


def rendered_alone(surface: Surface, settings: Settings) -> ViewTensors | None:
    """The views of a surface of three colours; None if something else must look at it."""
    seen = look_at(surface, settings)
    each, plain = look_at_light(surface.image.detach().contiguous().numpy())
    widest = max(-seen.range[0], seen.range[1])
    usable = plain and seen.usable and widest <= _WIDEST and plane_of(*seen.range) is None
    if not usable or not (settings.depth_repair == "off" or is_clean(surface, seen)):
        return None
    channels = tuple((least, greatest) for least, greatest in each.tolist())
    content = Content(
        limits=seen.range,
        edges=seen.step > EDGE,
        tilted=True,
        minimum=min(0.0, *(least for least, _ in channels)),
        channels=channels,
        limit=max(0.0, *(greatest for _, greatest in channels)),
        highlights=False,
        double=False,
    )
    views = rendered(surface, settings, content)
    # each has memory of its own: a caller who keeps one does not keep the others
    return views._replace(images=[x.clone() for x in views.images], trust=views.trust.clone())


def rendered(
    scene: Surface, settings: Settings, content: Content, frame: SharedFrame | None = None
) -> ViewTensors:
    """The views of a surface that is carried; the centre alone if left and right are not.

    frame: of the picture, where torch finds its surfaces.
    """
    pair = settings.left_right and carries_pair(settings)
    # light has no unit: float32 is fine enough for that of about 1, also its squares
    unit = 2.0 ** math.floor(math.log2(content.limit)) if content.limit > 0 else 1.0
    bounds, groups, negative = _bounds(content, len(scene.image), unit, settings), [], 0
    for some, samples, lights in _sampled(scene, content, unit, frame):
        found, darker = back.render(
            samples,
            lights[: 3 if pair else 1],
            bounds._replace(range=bounds.range[some]),
            outline=settings.aperture.fixed.outline,
            min_slope=quality_of(settings.quality).min_slope,
            edges=content.edges,
            threads=settings.threads,
        )
        del samples, lights  # large arrays
        groups.append(torch.from_numpy(found[:, :-1]).mul_(unit))
        negative = max(negative, darker)
    box = Box(0, 0, *scene.signed_radius.shape)
    in_focus = int((scene.signed_radius.abs() <= SHARP).sum())
    counts = {"pixels": box.area, "pixels_copied": in_focus, "tiles": 1}
    counts |= {"pixels_clamped": negative} if pair else {}
    images = groups[0] if len(groups) == 1 else torch.cat(groups, 1)
    return ViewTensors(list(images), torch.from_numpy(found[0, -1:]), counts, box)


def _sampled(
    scene: Surface, content: Content, unit: float, frame: SharedFrame | None
) -> Iterator[tuple[slice, Samples, NDArray[np.float32]]]:
    """The channels that are rendered at once, their surfaces, and lights to add.

    Those of three colours without lights and without a matte are found by compiled loops.
    """
    count = len(scene.image)
    if by_loops(scene) and not content.highlights:
        image, radius = (x.detach().float().contiguous().numpy() for x in scene.tensors)
        options: dict[str, Any] = {"unit": unit, "edges": content.edges}
        # held by the caller alone, who lets go of them before the next are made
        yield (
            slice(0, CHANNELS),
            samples_of(image, radius, content.limits, content.limit, **options),
            _NO_LIGHTS,
        )
        return
    assert frame is not None
    from defocus_core.renderer.engine.region_layers import backdrop_in, discs, layers_at

    whole, in_focus = frame.box, InFocus.from_scene(scene)
    place = RegionPlace.from_grid(frame, Grid([whole], whole[2:], 1))
    place = place._replace(outer=whole, held=whole, inside=whole, core=whole)
    seen = layers_at(place, in_focus, backdrop_in(frame, in_focus))
    layers, drawn = seen.layers, sum(discs(place, seen, lights) for lights in seen.lights)
    del seen  # also how far is seen, which compiled loops find themselves
    for first in range(0, count, CHANNELS):
        channels = slice(first, min(first + CHANNELS, count))
        lights = _NO_LIGHTS
        if isinstance(drawn, Tensor):
            lights = (drawn[:, channels] / unit).float().contiguous().numpy()
        yield channels, _of_layers(layers, channels, unit), lights


def _of_layers(layers: Sequence[SampleLayer], channels: slice, unit: float) -> Samples:
    """The surfaces that layers are, in some of their colours."""
    light, radius = _stacked([x for x in layers if x.kind == VISIBLE], channels, unit)
    hidden = None
    if continued := [x for x in layers if x.kind == CONTINUED]:
        behind, px = _stacked(continued, channels, unit)
        hidden = HiddenSamples(behind, px * np.float32(0.5), _range(behind, px))
    return Samples(light, radius, _range(light, radius), hidden)


def _stacked(
    layers: Sequence[SampleLayer], channels: slice, unit: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Light [n, H, 4 W] of layers in some of their colours, in a unit, and radii [n, H, W] px."""
    size = layers[0].signed_radius.shape
    light = torch.zeros(len(layers), *size, CHANNELS + 1, dtype=torch.float32)
    radius = torch.stack([layer.signed_radius.float() for layer in layers])
    for own, layer in zip(light, layers, strict=True):
        color = layer.color[channels] / unit
        color = color if layer.is_whole else color * layer.coverage
        own[..., : len(color)] = color.movedim(0, -1)
        own[..., -1] = layer.covered
    return light.flatten(2).numpy(), radius.numpy()


def _range(light: NDArray[np.float32], radius: NDArray[np.float32]) -> tuple[float, float]:
    """The least and the greatest radius of what is there."""
    held = radius[light[..., 3::4] > 0]
    return float(held.min()), float(held.max())


def samples_of(
    image: NDArray[np.float32],
    radius: NDArray[np.float32],
    limits: tuple[float, float],
    limit: float,
    *,
    unit: float,
    edges: bool,
) -> Samples:
    """The surfaces of a picture [3, H, W] without highlights of radii [H, W] px.

    limits: of its radii; limit: of its light; edges: whether surfaces hide others.
    """
    light = _few((1 + edges, radius.shape[0], 4 * radius.shape[1]))
    scale, limit = np.float32(1 / unit), limit / unit
    set_light(image, scale, light[0])
    radii = radius[None]
    if edges:
        radii = _few((2, *radius.shape))
        radii[0] = radius
        if not split_mixed((image, scale, np.float32(limit), radius), light, radii):
            light, radii = light[:1], radii[:1]
    samples = Samples(light, radii, limits)
    return samples._replace(hidden=hidden_of(samples, limit)) if edges else samples


def _few(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Zeros that take memory only where something else is written: NumPy's come in huge pages."""
    if math.prod(shape) < _MANY:
        return np.zeros(shape, np.float32)
    private = getattr(mmap, "MAP_PRIVATE", 0) | getattr(mmap, "MAP_ANONYMOUS", 0)
    pages = mmap.mmap(-1, 4 * math.prod(shape), **({"flags": private} if private else {}))
    return np.frombuffer(pages, np.float32).reshape(shape)


def _bounds(content: Content, count: int, unit: float, settings: Settings) -> Bounds:
    """The bounds of the views of a picture of so many channels."""
    others = [(content.minimum, math.inf)] * (count - len(content.channels))
    least, greatest = np.array([*content.channels, *others]).T / unit
    slack = [_SLACK * np.minimum(np.abs(x), greatest - least) for x in (least, greatest)]
    more = _OVERSHOOT * (greatest - least)
    limits = least - slack[0], greatest + slack[1], least - more, greatest + more
    range_, left, pair = np.stack(limits, 1).astype(np.float32), 0.5, settings.dual_pixel
    if settings.left_right:
        left = float(Division.from_aperture(settings.aperture, 1, pair).left_fraction)
    negative = (content.minimum - _NEGLIGIBLE * content.limit) / unit
    return Bounds(range_, content.minimum / unit, negative, left, float(pair.separation))

"""Layers of an item, drawn from decoded pictures; values of all of them, or of a window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.batch.jobs.output_kinds import KINDS
from defocus_core.compare.picture import DecodedPicture, color_layers, is_map
from defocus_core.reports.html import halves, thumbnails
from defocus_core.reports.html.item import HEAT, LIGHT, PLAIN, SHARE, SIGNED, Layer

WHOLE = 1 << 21  # px up to which all values are kept: 1920 x 1080
_WINDOW = (1920, 1080)  # px of a window of a larger picture
A, B, DIFFERENCE = "a", "b", "difference"

Box = tuple[int, int, int, int]  # x, y, width, height


@dataclass(frozen=True)
class Drawn:
    """A layer with its thumbnail, and its channels [H, W] in the values of the file."""

    layer: Layer
    planes: Sequence[NDArray[Any]]


def shown_channels(
    names: Sequence[str], differences: Mapping[str, float] | None = None
) -> tuple[str, ...]:
    """The channels of a file that are shown: its first colour, or those that differ most."""
    groups = [] if is_map(names) else list(color_layers(names))
    groups += [(name,) for name in names if not any(name in group for group in groups)]
    maximum = [max((differences or {}).get(name, 0.0) for name in group) for group in groups]
    if not any(maximum) or maximum[0] > 0:
        return groups[0]
    return groups[maximum.index(max(maximum))]


def draw(
    key: str,
    title: str,
    picture: DecodedPicture,
    names: Sequence[str],
    *,
    value_range: tuple[float, float] | None = None,
    side: int = thumbnails.SIDE,  # longest side of the thumbnail, px
) -> Drawn:
    """A layer of some channels of a picture."""
    planes = [picture.planes[name] for name in names]
    kind = kind_of(names)
    if value_range is None:
        value_range = thumbnails.ends_of(planes[0], kind)
    thumbnail = (
        thumbnails.of_light(planes, picture.gamma, side)
        if kind == LIGHT
        else thumbnails.of_map(planes[0], value_range, side)
    )
    height, width = planes[0].shape
    layer = Layer(
        *(key, title, kind, tuple(names), (width, height), picture.gamma, value_range),
        type=picture.types[names[0]],
        thumbnail=thumbnail,
    )
    return Drawn(layer, planes)


def kind_of(names: Sequence[str]) -> str:
    """The kind of a layer of some channels."""
    if not is_map(names) and next(color_layers(names), None):
        return LIGHT
    row = KINDS.get(names[0])
    if row is None or row.image:
        return PLAIN
    return SIGNED if row.of_radius else SHARE


def window_of(size: tuple[int, int], place: tuple[int, int] | None) -> Box:
    """The part of a picture whose values are kept: all of it, or what is around a place."""
    width, height = size
    if width * height <= WHOLE:
        return 0, 0, width, height
    x, y = place or (width // 2, height // 2)
    wide, high = min(width, _WINDOW[0]), min(height, _WINDOW[1])
    left = max(0, min(x - wide // 2, width - wide))
    top = max(0, min(y - high // 2, height - high))
    return left, top, wide, high


def with_values(drawn: Sequence[Drawn], box: Box) -> list[Layer]:
    """Layers with their values within a box; those of A and B have one scale.

    Where halves do not hold the values of A and B, their difference is a layer of its own.
    """
    cut = {each.layer.key: _within(each.planes, box) for each in drawn}
    pair = [plane for key in (A, B) for plane in cut.get(key, ())]
    by_key = {each.layer.key: each.layer for each in drawn}
    types = {by_key[key].type for key in (A, B) if key in by_key}
    shared = halves.common_scale(pair, types.pop() if len(types) == 1 else "")
    layers, base = [], None
    for each in drawn:
        layer, planes = each.layer, cut[each.layer.key]
        if layer.kind == HEAT:
            layers.append(_difference(layer, cut, shared, box))
            continue
        is_pair = layer.key in (A, B)
        scale = shared if is_pair else halves.common_scale(planes, layer.type)
        bits = halves.bits(planes, scale)
        packed = halves.pack(bits, box[:2], scale, base if layer.key == B else None)
        base = (layer.key, bits) if layer.key == A else base
        layers.append(replace(layer, halves=packed))
    return layers


def _difference(
    layer: Layer, cut: Mapping[str, Sequence[NDArray[Any]]], scale: float, box: Box
) -> Layer:
    """The layer of a difference with its values, if those of A and B do not tell it exactly."""
    if halves.is_exact([*cut[A], *cut[B]], scale):
        return layer
    with np.errstate(all="ignore"):
        planes = [np.subtract(b, a, dtype=np.float64) for a, b in zip(cut[A], cut[B], strict=True)]
    step = halves.unit_scale(planes)
    return replace(layer, halves=halves.pack(halves.bits(planes, step), box[:2], step))


def _within(planes: Sequence[NDArray[Any]], box: Box) -> list[NDArray[Any]]:
    x, y, width, height = box
    return [plane[y : y + height, x : x + width] for plane in planes]

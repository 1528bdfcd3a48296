"""Layers of an item of a report, made from decoded pictures, with values of all or some pixels.

Values are packed as numbers of 16 bits, which a browser unpacks and shows at any exposure: those of
integer files as they are, others as half floats. The file stores the difference of each, modulo
2^16, from the left neighbour, or from the same pixel of another layer: channel after channel, all
low bytes before all high bytes, deflated (zlib).
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.picture import (
    DecodedPicture,
    color_layers,
    in_linear_light,
    is_map,
    read_picture,
)
from defocus_core.compare.record import Comparison
from defocus_core.errors import InputError
from defocus_core.picture.preview import largest
from defocus_core.reports.html import thumbnails
from defocus_core.reports.html.item import HEAT, LIGHT, PLAIN, SHARE, SIGNED, Layer, StoredValues
from defocus_core.request.output_kinds import KINDS

WHOLE = 1 << 21  # px up to which all values are kept: 1920 x 1080
_WINDOW = (1920, 1080)  # px of a window of a larger picture
A, B, DIFFERENCE = "a", "b", "difference"

Box = tuple[int, int, int, int]  # x, y, width, height
_LARGEST = 65504.0  # of half
_LEVEL = 4  # level of zlib: 6 takes twice the time for 3 % less
_USUAL = 95  # percentile of the pixels that differ, at the hottest colour


def scale_of(planes: Sequence[NDArray[Any]], *, least: float = 1.0) -> float:
    """The power of 2, at least `least`, by which values are divided to fit into half floats."""
    maximum = max(map(largest, planes), default=0.0)
    return max(least, 2.0 ** math.ceil(math.log2(maximum / _LARGEST))) if maximum else 1.0


def half_bits(planes: Sequence[NDArray[Any]], scale: float) -> NDArray[np.uint16]:
    """The bits [C, H, W] of half floats, of planes [H, W] divided by `scale`."""
    with np.errstate(all="ignore"):
        halves = np.stack([_scaled(plane, scale).astype(np.float16) for plane in planes])
    return halves.view(np.uint16)


def are_integers(planes: Sequence[NDArray[Any]], greatest: int) -> bool:
    """Whether all values times `greatest` are whole numbers from 0 to `greatest`."""
    rounding = greatest * 2.0**-22  # of float32, twice
    with np.errstate(invalid="ignore", over="ignore"):
        steps = (plane * np.float32(greatest) for plane in planes)
        return all(
            each.min() >= 0
            and each.max() <= greatest
            and (abs(each - np.rint(each)) < rounding).all()
            for each in steps
        )


def _scaled(plane: NDArray[Any], scale: float) -> NDArray[Any]:
    """The values divided by `scale`, to be stored as half floats."""
    return plane if scale == 1 else np.asarray(plane, np.float64) / scale


def pack(
    values: NDArray[np.uint16],
    box: Box,
    scale: float = 1.0,
    base: tuple[str, NDArray[np.uint16]] | None = None,
) -> StoredValues:
    """Pack bits [C, H, W] of the pixels of a box.

    Each is stored as the difference from its left neighbour or from `base` (the key and the bits of
    another layer), whichever is shorter.
    """
    _, height, width = values.shape
    first = values.copy()
    first[:, :, 1:] -= values[:, :, :-1]
    packed = StoredValues(_deflated(first), box, (width, height), scale)
    if base is None or base[1].shape != values.shape:
        return packed
    other = _deflated(values - base[1])
    shorter = len(other) < len(packed.payload)
    return replace(packed, payload=other, base=base[0]) if shorter else packed


def _deflated(values: NDArray[np.uint16]) -> bytes:
    low, high = values.astype(np.uint8), (values >> 8).astype(np.uint8)
    return zlib.compress(low.tobytes() + high.tobytes(), _LEVEL)


@dataclass(frozen=True)
class Drawn:
    """A layer with its thumbnail, and its channels [H, W] in the values of the file."""

    layer: Layer
    planes: Sequence[NDArray[Any]]


def shown_channels(
    names: Sequence[str], differences: Mapping[str, float] | None = None
) -> tuple[str, ...]:
    """The channels of a file to show: its first colour, or those that differ most.

    `differences`: the greatest difference of each channel.
    """
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
) -> Drawn:
    """A layer made of some channels of a picture.

    `value_range`: the values shown as black and as white; None to find them.
    """
    planes = [picture.planes[name] for name in names]
    kind = layer_kind(names)
    value_range = value_range or thumbnails.ends_of(planes[0], kind)
    if kind == LIGHT:
        thumbnail = thumbnails.of_light(planes, picture.gamma)
    else:
        thumbnail = thumbnails.of_map(planes[0], value_range)
    height, width = planes[0].shape
    layer = Layer(
        *(key, title, kind, tuple(names), (width, height), picture.gamma, value_range),
        thumbnail=thumbnail,
        unit=KINDS[names[0]].unit if names[0] in KINDS else "",
    )
    return Drawn(layer, planes)


def layer_kind(names: Sequence[str]) -> str:
    """The kind of a layer with these channels: light, or a kind of map."""
    if not is_map(names) and next(color_layers(names), None):
        return LIGHT
    row = KINDS.get(names[0])
    if row is None or row.image:
        return PLAIN
    return SIGNED if row.signed else SHARE


def window_of(size: tuple[int, int], place: tuple[int, int] | None) -> Box:
    """The box of a picture whose values are kept: all of it, or a window around a place (x, y)."""
    width, height = size
    if width * height <= WHOLE:
        return 0, 0, width, height
    x, y = place or (width // 2, height // 2)
    wide, high = min(width, _WINDOW[0]), min(height, _WINDOW[1])
    left = max(0, min(x - wide // 2, width - wide))
    top = max(0, min(y - high // 2, height - high))
    return left, top, wide, high


def valued_layers(drawn: Sequence[Drawn], place: tuple[int, int] | None = None) -> list[Layer]:
    """The layers; those that have the size of the first get the values of their pixels.

    Values are kept in a window around `place`, (x, y). A and B have the same type and scale. If
    that type does not hold their values exactly, the difference has values of its own.
    """
    size = drawn[0].layer.size
    x, y, width, height = box = window_of(size, place)
    cut = {
        each.layer.key: [plane[y : y + height, x : x + width] for plane in each.planes]
        for each in drawn
        if each.layer.size == size
    }
    both = [plane for key in (A, B) for plane in cut.get(key, ())]
    shared = scale_of(both)
    greatest = next((each for each in (255, 65535) if are_integers(both, each)), 0)
    layers, base = [], None
    for layer in (each.layer for each in drawn):
        planes, values = cut.get(layer.key, ()), None
        if layer.kind == HEAT:
            values = None if greatest else _difference(cut[A], cut[B], shared, box)
        elif planes and greatest and layer.key in (A, B):
            bits = np.rint(np.stack(planes) * np.float32(greatest)).astype(np.uint16)
            values = pack(bits, box, base=base if layer.key == B else None)
            values = replace(values, ends=(0.0, 65535 / greatest))
        elif planes:
            scale = shared if layer.key in (A, B) else scale_of(planes)
            bits = half_bits(planes, scale)
            values = pack(bits, box, scale, base if layer.key == B else None)
        base = (A, bits) if layer.key == A and planes else base
        layers.append(replace(layer, values=values))
    return layers


def _difference(
    a: Sequence[NDArray[Any]], b: Sequence[NDArray[Any]], scale: float, box: Box
) -> StoredValues | None:
    """The packed values of B − A; None if A and B as half floats are exact."""
    both = zip(half_bits([*a, *b], scale).view(np.float16), [*a, *b], strict=True)
    with np.errstate(all="ignore"):
        if all(np.array_equal(h, _scaled(p, scale), equal_nan=True) for h, p in both):
            return None
        planes = [np.subtract(new, old, dtype=np.float64) for old, new in zip(a, b, strict=True)]
    step = scale_of(planes, least=0.0)
    return pack(half_bits(planes, step), box, step)


def draw_pair(record: Comparison, *, values: bool) -> tuple[list[Layer], float]:
    """The layers of the readable files of a pair; and the difference drawn in the hottest colour.

    `values`: whether layers have values, not thumbnails alone.
    """
    equal = record.passes and not record.differing and record.b is not None
    a, b = None if equal else _read(record.a), _read(record.b)
    if not (a or b):
        return [], 1.0
    if a and b and (a.gamma, a.associated) != (b.gamma, b.associated):
        a, b = in_linear_light(a), in_linear_light(b)
    drawn, full = _pair(a, b, record, "A = B" if equal else "B")
    place = None if record.worst is None else (record.worst.x, record.worst.y)
    return valued_layers(drawn, place) if values else [each.layer for each in drawn], full


def _read(path: Path | None) -> DecodedPicture | None:
    with suppress(InputError):
        return None if path is None else read_picture(path)
    return None


def _pair(
    a: DecodedPicture | None, b: DecodedPicture | None, record: Comparison, title: str
) -> tuple[list[Drawn], float]:
    """The layers A, B and difference, if any; and the difference drawn in the hottest colour."""
    sides = [(key, name, each) for key, name, each in ((A, "A", a), (B, title, b)) if each]
    names = [n for n in sides[-1][2].planes if all(n in each.planes for _, _, each in sides)]
    if not names:
        return [draw(k, t, each, shown_channels(list(each.planes))) for k, t, each in sides], 1.0
    shown = shown_channels(names, record.channels)
    first = draw(*sides[0], shown)
    drawn = [first, *(draw(*side, shown, value_range=first.layer.ends) for side in sides[1:])]
    if len(drawn) < 2 or drawn[0].planes[0].shape != drawn[1].planes[0].shape:
        return drawn, 1.0
    difference, full = difference_of(*drawn)
    return [*drawn, *difference], full


def difference_of(a: Drawn, b: Drawn) -> tuple[list[Drawn], float]:
    """The layer of the difference, if not 0; and the difference drawn in the hottest colour."""
    greatest = _greatest(a.planes, b.planes)
    full = _full(greatest)
    if not full:
        return [], 1.0
    thumbnail = thumbnails.of_difference(greatest, full)
    layer = replace(b.layer, key=DIFFERENCE, title="difference", kind=HEAT, thumbnail=thumbnail)
    return [Drawn(layer, [])], full


def _greatest(a: Sequence[NDArray[Any]], b: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """The greatest difference of any channel at each pixel; equal NaN or Inf count as 0."""
    greatest: NDArray[Any] = np.zeros(a[0].shape)
    with np.errstate(all="ignore"):
        for one, other in zip(a, b, strict=True):
            each = np.abs(np.subtract(other, one, dtype=np.float64))
            each[np.equal(one, other) | (np.isnan(one) & np.isnan(other))] = 0.0
            np.maximum(greatest, each, out=greatest)
    return greatest


def _full(greatest: NDArray[Any]) -> float:
    """The difference drawn in the hottest colour: a power of 2 that few pixels exceed, or 0."""
    finite = greatest[np.isfinite(greatest)]
    if finite.size == 0 or not finite.any():
        return 0.0 if finite.size == greatest.size else 1.0
    return float(2.0 ** np.ceil(np.log2(np.percentile(finite[finite > 0], _USUAL))))

"""The layers of a pair: A, B, their difference, and the maps and views that lie beside B.

A batch writes OUT/<kind>/<sample>: where B is such a file, the sample's maps and views are layers,
too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.picture import DecodedPicture, in_linear_light, read_picture
from defocus_core.compare.record import Comparison
from defocus_core.compare.selection import coc_file
from defocus_core.errors import InputError
from defocus_core.reports.html import thumbnails
from defocus_core.reports.html.item import HEAT, Layer
from defocus_core.reports.html.layers import (
    DIFFERENCE,
    A,
    B,
    Drawn,
    beside,
    draw,
    drawn_files,
    is_view,
    shown_channels,
    wiggle_of,
    window_of,
    with_values,
)


@dataclass(frozen=True)
class Subject:
    """A pair that is to be drawn."""

    record: Comparison  # what is known of it
    values: bool  # whether its values are wanted, and not thumbnails alone
    coc: Path | None = None  # CoC maps of the pictures, if they were named


@dataclass(frozen=True)
class Drawing:
    """A pair that was drawn."""

    layers: Sequence[Layer] = ()
    wiggle: tuple[str, ...] = ()  # keys of the left and the right view; empty if there are none
    full: float = 1.0  # the difference of the hottest colour
    lens: str = ""  # the lens that the file names, in words; empty if it names none


def draw_pair(subject: Subject) -> Drawing:
    """Draw a pair; what cannot be read is left out."""
    record = subject.record
    equal = record.passes and not record.differing and record.b is not None
    a, b = None if equal else _read(record.a), _read(record.b)
    whole = b or a
    if whole is None:
        return Drawing()
    if a and b and (a.gamma, a.associated) != (b.gamma, b.associated):
        a, b = in_linear_light(a), in_linear_light(b)
    drawn, full = _pair(a, b, record, "A = B" if equal else "B")
    size = drawn[0].layer.size
    files = dict(beside(whole.path))
    if subject.coc is not None:
        with suppress(InputError):
            files["coc"] = coc_file(subject.coc, record.name)
    others = drawn_files(files.items(), values=subject.values)
    drawn += [each for each in others if each.layer.size == size]
    layers: Sequence[Layer] = [each.layer for each in drawn]
    if subject.values:
        place = None if record.worst is None else (record.worst.x, record.worst.y)
        kept = [each for each in drawn if not is_view(each)]
        valued = {each.key: each for each in with_values(kept, window_of(size, place))}
        layers = [valued.get(each.key, each) for each in layers]
    wiggle = wiggle_of(layers, whole.path)
    return Drawing(layers, wiggle, full, lens_words(whole.metadata))


def _read(path: Path | None) -> DecodedPicture | None:
    with suppress(InputError):
        return None if path is None else read_picture(path)
    return None


def _pair(
    a: DecodedPicture | None, b: DecodedPicture | None, record: Comparison, title: str
) -> tuple[list[Drawn], float]:
    """A, B of a title and their difference, as far as there are such; the hottest difference."""
    sides = [(key, name, each) for key, name, each in ((A, "A", a), (B, title, b)) if each]
    _, _, last = sides[-1]
    names = [n for n in last.planes if all(n in each.planes for _, _, each in sides)]
    if not names:
        return [draw(k, t, each, shown_channels(list(each.planes))) for k, t, each in sides], 1.0
    names_shown = shown_channels(names, record.channels)
    first = sides[0][2]
    value_range = draw(A, "A", first, names_shown).layer.value_range
    drawn = [
        draw(key, title, each, names_shown, value_range=value_range) for key, title, each in sides
    ]
    if len(drawn) < 2 or drawn[0].planes[0].shape != drawn[1].planes[0].shape:
        return drawn, 1.0
    difference, full = difference_of(*drawn)
    return (drawn if difference is None else [*drawn, difference]), full


def difference_of(a: Drawn, b: Drawn) -> tuple[Drawn | None, float]:
    """The difference of two layers, and that of the hottest colour; None if nothing differs."""
    greatest = _greatest(a.planes, b.planes)
    full = _full(greatest)
    if not full:
        return None, 1.0
    thumbnail = thumbnails.of_difference(greatest, full)
    layer = replace(b.layer, key=DIFFERENCE, title="difference", kind=HEAT, thumbnail=thumbnail)
    return Drawn(layer, []), full


def _greatest(a: Sequence[NDArray[Any]], b: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """The greatest difference of the channels of each pixel; NaN and Inf of both are none."""
    greatest: NDArray[Any] = np.zeros(a[0].shape)
    with np.errstate(all="ignore"):
        for one, other in zip(a, b, strict=True):
            each = np.abs(np.subtract(other, one, dtype=np.float64))
            each[np.equal(one, other) | (np.isnan(one) & np.isnan(other))] = 0.0
            np.maximum(greatest, each, out=greatest)
    return greatest


def _full(greatest: NDArray[Any]) -> float:
    """The power of 2 at which colours of heat end; 0 where nothing differs."""
    finite = greatest[np.isfinite(greatest)]
    if finite.size == 0 or not finite.any():
        return 0.0 if finite.size == greatest.size else 1.0
    maximum = float(np.percentile(finite, 99.9)) or float(finite.max())
    return float(2.0 ** np.ceil(np.log2(maximum)))


def lens_words(metadata: Mapping[str, str]) -> str:
    """The lens that the metadata of a picture of ours name, in words; empty if they name none."""
    values = {name: metadata.get(f"defocus:{name}", "") for name in ("focal_length", "fnumber")}
    if not all(values.values()):
        return ""
    focus = metadata.get("defocus:focus", "")
    return f"{values['focal_length']} f/{values['fnumber']}" + (f", {focus}" if focus else "")

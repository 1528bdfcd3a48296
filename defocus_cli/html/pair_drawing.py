"""The layers of a pair: A, B, their difference, and the maps and views that lie beside B.

A batch writes OUT/<kind>/<sample>: where B is such a file, the sample's maps and views are layers,
too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defocus_cli.compare.record import Comparison
from defocus_cli.compare.selection import coc_file
from defocus_cli.diagnosis.picture import Picture, in_linear_light, read_picture
from defocus_cli.formats.kinds import KINDS, SUFFIXES
from defocus_cli.html import thumbnails
from defocus_cli.html.item import HEAT, Layer
from defocus_cli.html.layers import (
    DIFFERENCE,
    A,
    B,
    Drawn,
    draw,
    shown_channels,
    window_of,
    with_values,
)
from defocus_cli.system.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

_VIEWS = ("left", "right")
_VIEW_SIDE = 960  # px of the thumbnails of views beside values


@dataclass(frozen=True)
class Subject:
    """A pair that is to be drawn.

    Attributes:
        record: what is known of it.
        values: whether its values are wanted, and not thumbnails alone.
        coc: CoC maps of the pictures, if they were named.
    """

    record: Comparison
    values: bool
    coc: Path | None = None


@dataclass(frozen=True)
class Drawing:
    """A pair that was drawn.

    Attributes:
        layers: its layers.
        wiggle: keys of the left and the right view; empty if there are none.
        full: the difference of the hottest colour.
        lens: the lens that the file names, in words; empty if it names none.
    """

    layers: Sequence[Layer] = ()
    wiggle: tuple[str, ...] = ()
    full: float = 1.0
    lens: str = ""


def draw_pair(subject: Subject) -> Drawing:
    """Draw a pair; what cannot be read is left out."""
    record = subject.record
    a, b = (_read(path) for path in (record.a, record.b))
    whole = b or a
    if whole is None:
        return Drawing()
    if a and b and (a.gamma, a.associated) != (b.gamma, b.associated):
        a, b = in_linear_light(a), in_linear_light(b)
    drawn, full = _pair(a, b, record)
    size = drawn[0].layer.size
    beside = dict(beside_of(whole.path))
    if subject.coc is not None:
        with suppress(InputError):
            beside["coc"] = coc_file(subject.coc, record.name)
    drawn += companions(beside, size, _VIEW_SIDE if subject.values else thumbnails.SIDE)
    layers: Sequence[Layer] = [each.layer for each in drawn]
    if subject.values:
        place = None if record.worst is None else (record.worst.x, record.worst.y)
        kept = [each for each in drawn if each.layer.key not in _VIEWS]
        valued = {each.key: each for each in with_values(kept, window_of(size, place))}
        layers = [valued.get(each.key, each) for each in layers]
    return Drawing(layers, wiggle_of(layers, whole.path), full, lens_words(whole.metadata))


def _read(path: Path | None) -> Picture | None:
    with suppress(InputError):
        return None if path is None else read_picture(path)
    return None


def _pair(a: Picture | None, b: Picture | None, record: Comparison) -> tuple[list[Drawn], float]:
    """A, B and their difference, as far as there are such, and the hottest difference."""
    sides = [(key, title, each) for key, title, each in ((A, "A", a), (B, "B", b)) if each]
    _, _, last = sides[-1]
    names = [n for n in last.planes if all(n in each.planes for _, _, each in sides)]
    if not names:
        return [draw(k, t, each, shown_channels(list(each.planes))) for k, t, each in sides], 1.0
    names_shown = shown_channels(names, record.channels)
    first = sides[0][2]
    ends = draw(A, "A", first, names_shown).layer.ends
    drawn = [draw(key, title, each, names_shown, ends=ends) for key, title, each in sides]
    if record.passes and len(drawn) == 2:  # they look the same
        drawn[0] = replace(drawn[0], layer=replace(drawn[0].layer, thumbnail=b""))
    if len(drawn) < 2 or drawn[0].planes[0].shape != drawn[1].planes[0].shape:
        return drawn, 1.0
    greatest = _greatest(drawn[0].planes, drawn[1].planes)
    full = _full(greatest)
    if not full:
        return drawn, 1.0
    layer = replace(
        drawn[1].layer,
        key=DIFFERENCE,
        title="difference",
        kind=HEAT,
        thumbnail=thumbnails.of_difference(greatest, full),
    )
    return [*drawn, Drawn(layer, [])], full


def _greatest(a: Sequence[NDArray[Any]], b: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """The greatest difference of the channels of each pixel; NaN and Inf of both are none."""
    import numpy as np

    with np.errstate(all="ignore"):
        differences = []
        for one, other in zip(a, b, strict=True):
            each = np.abs(np.subtract(other, one, dtype=np.float64))
            each[np.equal(one, other) | (np.isnan(one) & np.isnan(other))] = 0.0
            differences.append(each)
    greatest: NDArray[Any] = np.max(np.stack(differences), axis=0)
    return greatest


def _full(greatest: NDArray[Any]) -> float:
    """The power of 2 at which colours of heat end; 0 where nothing differs."""
    import numpy as np

    finite = greatest[np.isfinite(greatest)]
    if finite.size == 0 or not finite.any():
        return 0.0 if finite.size == greatest.size else 1.0
    most = float(np.percentile(finite, 99.9)) or float(finite.max())
    return float(2.0 ** np.ceil(np.log2(most)))


def beside_of(path: Path) -> Iterator[tuple[str, Path]]:
    """Kind and file of what a batch wrote of the same sample, other than the file itself."""
    own, root = path.parent.name, path.parent.parent
    if own not in KINDS:
        return
    suffixes = dict.fromkeys([path.suffix, *SUFFIXES.values()])
    for kind in KINDS.values():
        endings = suffixes if kind.image else (".exr",)
        files = (root / kind.name / f"{path.stem}{suffix}" for suffix in endings)
        file = next((file for file in files if file.is_file()), None)
        if kind.name != own and file is not None:
            yield kind.name, file


def companions(beside: Mapping[str, Path], size: tuple[int, int], side: int) -> list[Drawn]:
    """Layers of the files beside a picture that are of its size."""
    drawn = []
    for kind, path in beside.items():
        picture = _read(path)
        if picture is not None and (picture.width, picture.height) == size:
            names = shown_channels(list(picture.planes))
            longest = side if KINDS[kind].image else thumbnails.SIDE
            drawn.append(draw(kind, KINDS[kind].name, picture, names, side=longest))
    return drawn


def wiggle_of(layers: Sequence[Layer], path: Path) -> tuple[str, ...]:
    """Keys of the left and the right view, where there are both; one of them may be ``b``."""
    keys = {layer.key: layer.key for layer in layers}
    if path.parent.name in _VIEWS and B in keys:
        keys[path.parent.name] = B
    return tuple(keys[view] for view in _VIEWS) if set(_VIEWS) <= keys.keys() else ()


def lens_words(metadata: Mapping[str, str]) -> str:
    """The lens that the metadata of a picture of ours name, in words; empty if they name none."""
    values = {name: metadata.get(f"defocus:{name}", "") for name in ("focal_length", "fnumber")}
    if not all(values.values()):
        return ""
    focus = metadata.get("defocus:focus", "")
    return f"{values['focal_length']} f/{values['fnumber']}" + (f", {focus}" if focus else "")

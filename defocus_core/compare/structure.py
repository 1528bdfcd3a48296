"""Structure of two files: what makes them different, and what is noted and no more.

Another size and a missing or further channel are differences. Another number type, order of
channels, codec or data window is a note. Metadata that differs is listed apart.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.compare.findings.finding import Finding
from defocus_core.compare.picture import color_layers
from defocus_core.io.images.primaries import primaries_name, same_primaries
from defocus_core.system.text import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from defocus_core.compare.picture import DecodedPicture

# Attributes that differ from run to run: times, and the program that wrote a file.
_OF_A_RUN = ("capdate", "*date", "date*", "*datetime*", "time", "*time*", "software", "utcoffset")
_DEPTHS = ("Z", "ZBack")  # channels of deep samples


@dataclass(frozen=True)
class Structure:
    """How two files differ apart from the values of their pixels."""

    findings: tuple[Finding, ...]  # another size, missing and further channels
    notes: tuple[str, ...]  # differences that change no pixel, in words
    metadata: tuple[str, ...]  # attributes that differ, in words
    common: tuple[str, ...]  # names of the channels of the size of the picture that both have
    apart: tuple[str, ...]  # names of the common channels of another size, as those of a thumbnail


def compare_structure(
    a: DecodedPicture, b: DecodedPicture, ignored: Sequence[str] = ()
) -> Structure:
    """How two files differ apart from the values of their pixels."""
    findings = []
    if (a.width, a.height) != (b.width, b.height):
        text = f"another size: {b.width}x{b.height} instead of {a.width}x{a.height}"
        values = {"a": [a.width, a.height], "b": [b.width, b.height]}
        findings.append(Finding("another size", text, values))
    both = [name for name in a.planes if name in b.planes]
    resized = [name for name in both if a.planes[name].shape != b.planes[name].shape]
    if resized and not findings:
        text = f"another size of {_list(resized)}"
        findings.append(Finding("another size", text, {"channels": resized}))
    lone = _depths_of_samples(a, b)
    missing = [name for name in a.planes if name not in b.planes and name not in lone]
    further = [name for name in b.planes if name not in a.planes and name not in lone]
    if missing:
        text = f"missing {_counted(missing)}"
        findings.append(Finding("missing channel", text, {"channels": missing}))
    if further:
        text = f"further {_counted(further)}"
        findings.append(Finding("further channel", text, {"channels": further}))
    same = [name for name in both if name not in resized]
    shown = (a.height, a.width)
    return Structure(
        findings=tuple(findings),
        notes=(*_notes(a, b), *([f"flattened, without {_list(lone)}"] if lone else [])),
        metadata=tuple(_differing(*(_heeded(each.metadata, ignored) for each in (a, b)))),
        common=tuple(name for name in same if a.planes[name].shape == shown),
        apart=tuple(name for name in same if a.planes[name].shape != shown),
    )


def compare_primaries(
    a: DecodedPicture, b: DecodedPicture, ignored: Sequence[str] = ()
) -> Finding | None:
    """Whether two pictures declare other primaries, by which equal numbers are other colours."""
    counts = _heeded({"chromaticities": ""}, ignored)
    if not counts or same_primaries(a.primaries, b.primaries) or not any(color_layers([*a.planes])):
        return None
    old, new = (primaries_name(each.primaries) for each in (a, b))
    text = f"other primaries declared: {new} instead of {old}"
    return Finding("other primaries declared", text, {"a": old, "b": new})


def compare_samples(a: DecodedPicture, b: DecodedPicture) -> Finding | None:
    """How the samples of two deep pictures differ; None if they do not, or one is flat."""
    if not a.samples or not b.samples:
        return None
    old, new = (each.samples[""] for each in (a, b))
    if not np.array_equal(old, new):
        places, owners = np.unique(np.concatenate([old, new]), return_inverse=True)
        counts = [np.bincount(of, minlength=len(places)) for of in np.split(owners, [len(old)])]
        pixels = int(np.count_nonzero(counts[0] != counts[1]))
        text = f"deep samples: another number in {counted(pixels, 'pixel')}"
        return Finding("deep samples", text, {"pixels": pixels})
    greatest = {
        name: float(np.abs(b.samples[name].astype("f8") - values).max(initial=0.0))
        for name, values in a.samples.items()
        if name in b.samples and not np.array_equal(values, b.samples[name], equal_nan=True)
    }
    if not greatest:
        return None
    each = ", ".join(f"{name} by up to {maximum:.3g}" for name, maximum in greatest.items())
    return Finding("deep samples", f"deep samples: other values, {each}", {"max": greatest})


def _depths_of_samples(a: DecodedPicture, b: DecodedPicture) -> list[str]:
    """Channels of depth that a deep picture must have, and that the other lacks as it is flat."""
    if bool(a.samples) == bool(b.samples):
        return []
    deep, flat = (a, b) if a.samples else (b, a)
    names = set(deep.planes) - set(flat.planes)
    return sorted(name for name in names if name.rpartition(".")[2] in _DEPTHS)


def _heeded(metadata: Mapping[str, str], ignored: Sequence[str]) -> dict[str, str]:
    """The attributes that count."""
    patterns = [pattern.lower() for pattern in (*_OF_A_RUN, *ignored)]

    def counts(name: str) -> bool:
        full = name.lower()
        return not any(
            fnmatchcase(full, p) or fnmatchcase(re.split("[/:]", full)[-1], p) for p in patterns
        )

    return {name: text for name, text in metadata.items() if counts(name)}


def _counted(names: Sequence[str]) -> str:
    return f"channel{'s' * (len(names) > 1)} {_list(names)}"


def _list(names: Sequence[str]) -> str:
    more = f" and {len(names) - 8} more" if len(names) > 8 else ""
    return ", ".join(names[:8]) + more


def _notes(a: DecodedPicture, b: DecodedPicture) -> list[str]:
    types: dict[tuple[str, str], list[str]] = {}
    for name in a.planes:
        old, new = a.types[name], b.types.get(name)
        if new is not None and new != old:
            types.setdefault((old, new), []).append(name)
    notes = [f"{_list(names)} {new} instead of {old}" for (old, new), names in types.items()]
    if a.layout.get("format") != b.layout.get("format"):
        return [*notes, f"{b.layout.get('format')} instead of {a.layout.get('format')}"]
    said = {"channel order"} if set(a.planes) != set(b.planes) else set()
    if (a.width, a.height) != (b.width, b.height):
        said |= {key for key in a.layout if "window" in key}
    layouts = ({k: v for k, v in each.layout.items() if k not in said} for each in (a, b))
    return [*notes, *_differing(*layouts)]


def _differing(a: Mapping[str, str], b: Mapping[str, str]) -> list[str]:
    """Each key whose values differ, in words."""
    lines = []
    for key in sorted({*a, *b}):
        if a.get(key) != b.get(key):
            old, new = (_short(d[key]) if key in d else "nothing" for d in (a, b))
            lines.append(f"{key} {new} instead of {old}")
    return lines


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}…"


def of_another_size(a: DecodedPicture, b: DecodedPicture) -> Iterator[Finding]:
    """How a picture of another size comes from A, if that is seen: as a crop, or turned by 90°."""
    sides = []
    for side in (a, b):
        size = (side.height, side.width)
        sides.append({n: plane for n, plane in side.planes.items() if plane.shape == size})
    names = [name for name in sides[0] if name in sides[1]]
    if not names:
        return
    old, new = (np.stack([np.nan_to_num(side[name]) for name in names]) for side in sides)
    if old.shape[1:] == new.shape[:0:-1]:
        turned = {
            "to the left": np.rot90(old, 1, (1, 2)),
            "to the right": np.rot90(old, -1, (1, 2)),
        }
        for way, planes in turned.items():
            if np.array_equal(planes, new):
                yield Finding("rotated", f"rotated by 90° {way}")
    large, small = (old, new) if old.shape[1] >= new.shape[1] else (new, old)
    (height, width), (high, wide) = large.shape[1:], small.shape[1:]
    if (high, wide) == (height, width) or high > height or wide > width:
        return
    for x, y in _corners(large, small):
        if np.array_equal(large[:, y : y + high, x : x + wide], small):
            whole = f"{width}x{height}"
            text = f"a crop: {wide}x{high} at {x},{y} of {whole}"
            if large is new:
                text = f"A is a crop of B: {wide}x{high} at {x},{y} of {whole}"
            yield Finding("crop", text, {"window": [x, y, wide, high]})
            return


def _corners(large: NDArray[Any], small: NDArray[Any]) -> Iterator[tuple[int, int]]:
    """Where a smaller picture may lie in a larger one: in the middle, at corners, at a match."""
    spare_y, spare_x = large.shape[1] - small.shape[1], large.shape[2] - small.shape[2]
    yield from product((spare_x // 2, 0, spare_x), (spare_y // 2, 0, spare_y))
    # Pixels that match one distinctive pixel of the smaller picture.
    flat = small.reshape(len(small), -1)
    for place in {int(flat[0].argmax()), int(flat[0].argmin()), flat.shape[1] // 2}:
        row, column = np.unravel_index(place, small.shape[1:])
        same = np.ones(large.shape[1:], bool)
        for plane, value in zip(large, flat[:, place], strict=True):
            same &= plane == value
        for y, x in np.argwhere(same)[:64]:
            corner = int(x - column), int(y - row)
            if 0 <= corner[0] <= spare_x and 0 <= corner[1] <= spare_y:
                yield corner

"""Differences of two files other than pixels: size, channels, samples, primaries, metadata.

Another number type, order of channels, codec or data window is a note. Differing metadata is listed
separately.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.table import Finding
from defocus_core.compare.picture import DecodedPicture, color_layers
from defocus_core.compare.record import CompareSettings, Comparison
from defocus_core.io.images.primaries import primaries_name, same_primaries
from defocus_core.system.text import counted

# Attributes that differ from run to run: times, and the program that wrote a file.
_OF_A_RUN = ("capdate", "*date", "date*", "*datetime*", "time", "*time*", "software", "utcoffset")
_DEPTHS = ("Z", "ZBack")  # channels of deep samples


def compare_structure(
    record: Comparison,
    a: DecodedPicture,
    b: DecodedPicture,
    settings: CompareSettings,
    *,
    ruled: bool,  # whether rules decide about values
) -> tuple[Comparison, list[str], bool]:
    """Compare the structure of both files.

    Returns the record with findings and notes on the structure; the channels to compare, which both
    files have in the size of the picture; and whether the structure alone makes B different.
    `ruled`: whether there are rules to fail.
    """
    both = [name for name in a.planes if name in b.planes]
    resized = [name for name in both if a.planes[name].shape != b.planes[name].shape]
    common = [n for n in both if n not in resized and a.planes[n].shape == (a.height, a.width)]
    lone = _depths_of_samples(a, b)
    findings = [*_of_channels(a, b, resized, lone)]
    others = [name for name in both if name not in (*resized, *common)]  # like those of a thumbnail
    apart = [
        name
        for name in others
        if not np.array_equal(a.planes[name], b.planes[name], equal_nan=True)
    ]
    ignored = settings.ignore_metadata
    metadata = _differing(*(_heeded(each.metadata, ignored) for each in (a, b)))
    samples = [*_compare_samples(a, b)]
    strict = bool(findings or apart) or (settings.metadata and bool(metadata))
    strict |= bool(samples) and not ruled
    findings += [*_compare_primaries(a, b, ignored), *samples]
    of = "which is of another size than the picture"
    told = [f"other values in {', '.join(apart)}, {of}"] if apart else []
    notes = (*told, *_notes_of(a, b, lone))
    record = replace(record, findings=tuple(findings), notes=notes, metadata=tuple(metadata))
    return record, common, strict


def _of_channels(
    a: DecodedPicture, b: DecodedPicture, resized: Sequence[str], lone: Sequence[str]
) -> Iterator[Finding]:
    """Findings of another size, missing and further channels.

    `lone`: channels of depth that only the deep one of the files must have.
    """
    if (a.width, a.height) != (b.width, b.height):
        text = f"another size: {b.width}x{b.height} instead of {a.width}x{a.height}"
        values = {"a": [a.width, a.height], "b": [b.width, b.height]}
        yield Finding("another size", text, values)
    elif resized:
        text = f"another size of {_list(resized)}"
        yield Finding("another size", text, {"channels": list(resized)})
    for word, one, other in (("missing", a, b), ("further", b, a)):
        names = [n for n in one.planes if n not in other.planes and n not in lone]
        if names:
            text = f"{word} channel{'s' * (len(names) > 1)} {_list(names)}"
            yield Finding(f"{word} channel", text, {"channels": names})


def _compare_primaries(
    a: DecodedPicture, b: DecodedPicture, ignored: Sequence[str]
) -> Iterator[Finding]:
    """The finding that the files declare different primaries: equal numbers are other colours."""
    counts = _heeded({"chromaticities": ""}, ignored)
    if counts and any(color_layers([*a.planes])) and not same_primaries(a.primaries, b.primaries):
        old, new = (primaries_name(each.primaries) for each in (a, b))
        text = f"other primaries declared: {new} instead of {old}"
        yield Finding("other primaries declared", text, {"a": old, "b": new})


def _compare_samples(a: DecodedPicture, b: DecodedPicture) -> Iterator[Finding]:
    """Differences of the samples of two deep pictures; empty if there are none, or one is flat."""
    if not a.samples or not b.samples:
        return
    old, new = (each.samples[""] for each in (a, b))
    if not np.array_equal(old, new):
        places, owners = np.unique(np.concatenate([old, new]), return_inverse=True)
        counts = [np.bincount(of, minlength=len(places)) for of in np.split(owners, [len(old)])]
        pixels = int(np.count_nonzero(counts[0] != counts[1]))
        text = f"deep samples: another number in {counted(pixels, 'pixel')}"
        yield Finding("deep samples", text, {"pixels": pixels})
        return
    greatest = {
        name: float(np.abs(b.samples[name].astype("f8") - values).max(initial=0.0))
        for name, values in a.samples.items()
        if name in b.samples and not np.array_equal(values, b.samples[name], equal_nan=True)
    }
    if greatest:
        each = ", ".join(f"{name} by up to {maximum:.3g}" for name, maximum in greatest.items())
        yield Finding("deep samples", f"deep samples: other values, {each}", {"max": greatest})


def _depths_of_samples(a: DecodedPicture, b: DecodedPicture) -> list[str]:
    """Channels of depth that the deep one of two pictures must have, and the flat one lacks."""
    if bool(a.samples) == bool(b.samples):
        return []
    deep, flat = (a, b) if a.samples else (b, a)
    names = set(deep.planes) - set(flat.planes)
    return sorted(name for name in names if name.rpartition(".")[2] in _DEPTHS)


def _heeded(metadata: Mapping[str, str], ignored: Sequence[str]) -> dict[str, str]:
    patterns = [pattern.lower() for pattern in (*_OF_A_RUN, *ignored)]

    def counts(name: str) -> bool:
        full = name.lower()
        return not any(
            fnmatchcase(full, p) or fnmatchcase(re.split("[/:]", full)[-1], p) for p in patterns
        )

    return {name: text for name, text in metadata.items() if counts(name)}


def _list(names: Sequence[str]) -> str:
    more = f" and {len(names) - 8} more" if len(names) > 8 else ""
    return ", ".join(names[:8]) + more


def _notes_of(a: DecodedPicture, b: DecodedPicture, lone: Sequence[str]) -> list[str]:
    """Notes on differences that change no pixel; ``lone``: channels that only a deep file has."""
    types: dict[tuple[str, str], list[str]] = {}
    for name in a.planes:
        old, new = a.types[name], b.types.get(name)
        if new is not None and new != old:
            types.setdefault((old, new), []).append(name)
    notes = [f"{_list(names)} {new} instead of {old}" for (old, new), names in types.items()]
    flat = [f"flattened, without {_list(lone)}"] if lone else []
    if a.layout.get("format") != b.layout.get("format"):
        return [*notes, f"{b.layout.get('format')} instead of {a.layout.get('format')}", *flat]
    said = {"channel order"} if set(a.planes) != set(b.planes) else set()
    if (a.width, a.height) != (b.width, b.height):
        said |= {key for key in a.layout if "window" in key}
    layouts = ({k: v for k, v in each.layout.items() if k not in said} for each in (a, b))
    return [*notes, *_differing(*layouts), *flat]


def _differing(a: Mapping[str, str], b: Mapping[str, str]) -> list[str]:
    lines = []
    for key in sorted({*a, *b}):
        if a.get(key) != b.get(key):
            texts = (d.get(key, "nothing") for d in (a, b))
            old, new = (text if len(text) <= 60 else f"{text[:57]}…" for text in texts)
            lines.append(f"{key} {new} instead of {old}")
    return lines


def of_another_size(a: DecodedPicture, b: DecodedPicture) -> Iterator[Finding]:
    """The finding that explains another size of B, if any: a crop of A, or a turn by 90°."""
    sides = []
    for side in (a, b):
        size = (side.height, side.width)
        sides.append({n: plane for n, plane in side.planes.items() if plane.shape == size})
    names = [name for name in sides[0] if name in sides[1]]
    if not names:
        return
    old, new = (np.stack([np.nan_to_num(side[name]) for name in names]) for side in sides)
    for turns, way in ((1, "left"), (-1, "right")):
        if np.array_equal(np.rot90(old, turns, (1, 2)), new):
            yield Finding("rotated", f"rotated by 90° to the {way}")
    large, small = (old, new) if old.shape[1] >= new.shape[1] else (new, old)
    (height, width), (high, wide) = large.shape[1:], small.shape[1:]
    if (high, wide) == (height, width) or high > height or wide > width:
        return
    for x, y in _corners(large, small):
        if np.array_equal(large[:, y : y + high, x : x + wide], small):
            which = "a crop" if small is new else "A is a crop of B"
            text = f"{which}: {wide}x{high} at {x},{y} of {width}x{height}"
            yield Finding("crop", text, {"window": [x, y, wide, high]})
            return


def _corners(large: NDArray[Any], small: NDArray[Any]) -> Iterator[tuple[int, int]]:
    """The positions of a smaller picture in a larger one at which 81 of its pixels match."""
    (height, width), (high, wide) = large.shape[1:], small.shape[1:]
    same = np.ones((height - high + 1, width - wide + 1), bool)
    rows, columns = (np.linspace(0, side - 1, 9).astype(int) for side in (high, wide))
    for row, column in product(rows, columns):
        part = large[:, row : row + len(same), column : column + len(same[0])]
        same &= (part == small[:, row, column][:, None, None]).all(axis=0)
    yield from ((int(x), int(y)) for y, x in np.argwhere(same)[:64])

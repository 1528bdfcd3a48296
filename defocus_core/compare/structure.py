"""Structure of two files: what makes them different, and what is noted and no more.

Another size and a missing or further channel are differences. Another number type, order of
channels, codec or data window is a note. Metadata that differs is listed apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from defocus_core.compare.findings.finding import Finding
from defocus_core.compare.picture import DecodedPicture


@dataclass(frozen=True)
class Structure:
    """How two files differ apart from the values of their pixels.

    Attributes:
        findings: another size, missing and further channels.
        notes: differences that change no pixel, in words.
        metadata: attributes that differ, in words.
        common: names of the channels of the size of the picture that both have.
        apart: names of the common channels of another size, as those of a thumbnail.
    """

    findings: tuple[Finding, ...]
    notes: tuple[str, ...]
    metadata: tuple[str, ...]
    common: tuple[str, ...]
    apart: tuple[str, ...]


def compare_structure(a: DecodedPicture, b: DecodedPicture) -> Structure:
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
    missing = [name for name in a.planes if name not in b.planes]
    further = [name for name in b.planes if name not in a.planes]
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
        notes=tuple(_notes(a, b)),
        metadata=tuple(_differing(a.metadata, b.metadata)),
        common=tuple(name for name in same if a.planes[name].shape == shown),
        apart=tuple(name for name in same if a.planes[name].shape != shown),
    )


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

"""What happened to B: causes tried in turn, and the one that leaves least is the finding.

A cause is a row of a table: its model, what it may leave, and its rivals. Where a rival explains
about as much, the word for both is said. Where none explains enough, the place of the difference
is, if it has one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from defocus_core.compare.findings.evidence import Evidence, Explanation
from defocus_core.compare.findings.places import place_of
from defocus_core.compare.findings.softness import has_room, is_large, white_noise
from defocus_core.compare.findings.table import CAUSES, Cause, Finding
from defocus_core.compare.pairing import partners
from defocus_core.compare.picture import DecodedPicture, in_linear_light, read_picture
from defocus_core.compare.pixels import Pixels
from defocus_core.errors import InputError

# Attributes of a render by what follows if they differ.
_OF_A_LENS = {
    "another CoC": ("fnumber", "focus", "focal_length", "coc_px"),
    "another bokeh shape": ("blades", "blade_rotation"),
}
# What changes light by that name, and other numbers by another.
_OF_NUMBERS = {
    "another exposure": "multiplied",
    "raised blacks": "offset",
    "lowered blacks": "offset",
}
_SPREADS = ("another CoC", "another CoC or bokeh shape", "spread otherwise")
_LAST_BITS = 2e-5  # largest difference that is that of another machine, on no scale to be seen
_PLACED_TOO = "spread otherwise"  # says how, and no cause
_NEEDS: dict[str, Callable[[Evidence], bool]] = {
    "": lambda evidence: True,
    "light": lambda evidence: bool(evidence.pixels.color),
    "no noise": lambda evidence: bool(evidence.pixels.color) and not white_noise(evidence),
    "room": has_room,
    "noise": is_large,
}
_LEFT_OF_FEW = 0.06  # greatest share that a cause leaves of a picture of few pixels
_LAST_TURN = 3
_RIVAL = 0.8  # greatest share that a cause leaves of what each of its rivals leaves
_FLOOR = 0.02  # left by causes that both explain all
_CERTAIN = 0.03  # left of a difference, below which nothing else is tried


def diagnose(
    pixels: Pixels,
    a: DecodedPicture,
    b: DecodedPicture,
    corner: tuple[int, int] = (0, 0),
) -> list[Finding]:
    """The cause of the differences of a pair that has some, or their place, or nothing."""
    codecs = a.layout.get("compression", ""), b.layout.get("compression", "")
    evidence = Evidence(pixels, b.types, _others(pixels, a.path), codecs)
    old, new = (evidence.scaled(side) for side in evidence.sampled)
    if old.size and float(abs(new - old).max()) < _LAST_BITS:
        return []
    chosen = _chosen(evidence)
    findings = []
    if chosen is not None:
        finding = _by_metadata(_by_channels(chosen.finding, evidence), a.metadata, b.metadata)
        findings = [replace(finding, explained=round(max(0.0, 1 - chosen.left), 4))]
        if finding.name != _PLACED_TOO:
            return findings
    if evidence.is_slight:
        return [Finding("too small to name", "too small to name")]
    place = place_of(evidence, (a, b), corner)
    return findings if place is None else [*findings, place]


def _chosen(evidence: Evidence) -> Explanation | None:
    """The explanation that leaves least; later turns are tried where it leaves something."""
    good: list[Explanation] = []
    chosen = None
    for turn in range(_LAST_TURN + 1):
        if chosen is None or (chosen.rank > _CERTAIN and turn < _LAST_TURN):
            rows = [row for row in CAUSES if row.turn == turn]
            good += [each for row in rows for each in _explanations(row, evidence)]
            chosen = min(good, key=lambda each: each.rank, default=None)
    return None if chosen is None else among_rivals(chosen, good)


def _explanations(row: Cause, evidence: Evidence) -> Iterator[Explanation]:
    """The fits of a cause to a pair that explain enough to be named."""
    limit = min(row.left, _LEFT_OF_FEW) if evidence.is_small else row.left
    if _NEEDS[row.needs](evidence) and (row.local or not evidence.is_rectangle):
        module, _, name = row.model.partition(".")
        model = getattr(import_module(f"{__package__}.{module}"), name)
        fits = (each for each in model(evidence) if each.left <= limit)
        yield from (replace(each, rivals=row.rivals) for each in fits)


def among_rivals(chosen: Explanation, good: Sequence[Explanation]) -> Explanation:
    """The explanation, or the word for it and for what explains about as much."""
    word, name = chosen.rivals, chosen.name
    most = max(chosen.left, _FLOOR) / _RIVAL
    names = {each.name for each in good if each.rivals == word and each.left < most}
    names = {each for each in names if each not in name and name not in each}
    if not word or not names:
        return chosen
    possible = [name, *sorted(names)]
    return replace(
        chosen, name=word, how=f": {' or '.join(possible)}", values={"possible": possible}
    )


def _by_channels(finding: Finding, evidence: Evidence) -> Finding:
    """A finding in words of numbers where no light differs, or of the channels at fault."""
    names = ", ".join(evidence.names)
    colors = [name for layer in evidence.pixels.color for name in layer]
    if colors and set(colors) <= set(evidence.names):
        return finding
    values = finding.values
    if finding.name in _OF_NUMBERS and not set(colors) & set(evidence.names):
        name = _OF_NUMBERS[finding.name]
        changes = [f"x {values['factor']:.4g}"] if values.get("factor", 1.0) != 1.0 else []
        changes += [f"{values['offset']:+.3g}"] if "offset" in values else []
        # Each channel may have a factor of its own.
        said = f"{names} {', '.join(changes)}" if changes else finding.text.partition(": ")[2]
        return replace(finding, name=name, text=f"{name}: {said}")
    if not colors or set(evidence.names) <= set(values) or "factors" in values:
        return finding
    verb = finding.text.partition(" ")[0].rstrip(":").endswith("ed")
    return replace(finding, text=f"{names}{' ' if verb else ': '}{finding.text}")


def _by_metadata(finding: Finding, a: Mapping[str, str], b: Mapping[str, str]) -> Finding:
    """Light that is spread otherwise, by the lens that the metadata of two renders name."""
    if finding.name not in _SPREADS:
        return finding
    for name, attributes in _OF_A_LENS.items():
        changes = [
            f"{key} {b[full]} instead of {a[full]}"
            for key in attributes
            for full in [f"defocus:{key}"]
            if full in a and full in b and a[full] != b[full]
        ]
        if changes:
            how = finding.text.partition(": ")[2]
            said = f"{name}: {how} ({', '.join(changes)}, by the metadata)"
            return Finding(name, said, finding.values)
    return finding


def _others(pixels: Pixels, file_a: Path | None) -> dict[str, dict[str, Any]]:
    """Channels of files beside that of A, by the finding that B is one of these."""
    others = {}
    for name, path in partners(file_a):
        try:
            picture = read_picture(path)
        except InputError:  # it is judged as a pair of its own
            continue
        linear = pixels.gamma == 1.0
        others[name] = dict((in_linear_light(picture) if linear else picture).planes)
    return others

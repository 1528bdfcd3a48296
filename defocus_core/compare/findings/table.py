"""Findings: a row for each model of a cause, and the places of unexplained differences.

A row has the findings of a model, with their evidence, as in `defocus help compare`. Rows are tried
in order, simpler ones first. Names of rules, help and tests come from these rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Cause:
    """A possible cause of a difference, and its evidence."""

    name: str  # the fixed words of the finding
    words: str  # its evidence
    model: str  # module of this folder and function that fits it to a pair, in one or several ways
    # Simpler causes that the model includes: it replaces one if its residual is at most half, and
    # is not its rival
    beyond: tuple[str, ...] = ()
    left: float = 0.35  # largest residual, as a share of the difference, at which it is named
    light: bool = False  # whether it applies to colour alone
    looks: bool = False  # whether it is tried if no other row is named


FACTOR = ("another exposure", "multiplied")
_LINEAR = (*FACTOR, "channels swapped", "premultiplication")
_TONES = (*_LINEAR, "offset or contrast", "inverted", "another gamma", "clipped", "normalised")
_MOVED = ("shifted", "scaled")
_AXIS = "along rays instead of along the axis, by which focal length"
_VIEW = "B is the other view: a file `left`/`right` beside A, or channels"
_MIXED = "a matrix: which primaries, or the factor"
_SUM = "A times a factor, and a constant: of light or of a screen"
_ALPHA = "colour divided or multiplied by alpha once more"
_COC = "either, where metadata, recipes or CoC maps say so"
CAUSES = (
    # Values in place.
    Cause("empty", "one value everywhere, or 0 in a rectangle", "tone.empty"),
    Cause("rounded to half", "to the numbers of 16 bits", "tone.quantised"),
    Cause("clipped", "at which limit, from above or from below", "tone.clipped"),
    Cause("quantised", "to the levels of how many bits", "tone.quantised", ("rounded to half",)),
    Cause("channels swapped", "which", "tone.exchanged"),
    Cause("left and right swapped", _VIEW, "tone.exchanged"),
    Cause("layers exchanged", "channels of one layer in the place of another", "tone.exchanged"),
    Cause("ids exchanged", "the same numbers, in other places", "tone.exchanged_ids"),
    Cause("another exposure", "brighter or darker: the factor, of all or of each", "tone.summed"),
    Cause("multiplied", "the same of channels that are not light, like depth", "tone.summed"),
    Cause("normalised", "0…1 of other numbers, like depth; or their inverse", "tone.summed"),
    Cause("another gamma", "the power; sRGB encoded or decoded once more", "tone.summed", FACTOR),
    Cause("offset or contrast", _SUM, "tone.summed", (*FACTOR, "normalised")),
    Cause("inverted", "the same with a factor below 0", "tone.summed", FACTOR),
    Cause("radial depth", _AXIS, "tone.radial"),
    Cause("planar depth", "along the axis instead of along rays", "tone.radial"),
    Cause("premultiplication", _ALPHA, "tone.premultiplied", light=True),
    Cause("primaries or saturation", _MIXED, "tone.mixed_channels", _LINEAR, light=True),
    Cause("another tone curve", "a curve that rises", "tone.curve", _TONES, light=True),
    # Places.
    Cause("another view or frame", "a file beside A", "geometry.other_file"),
    Cause("flipped", "how", "geometry.flipped"),
    Cause("rotated", "by right angles", "geometry.flipped"),
    Cause("crop", "which part of A it is", "geometry.cropped", ("empty",)),
    Cause("shifted", "by px, fractions included", "geometry.moved", ("flipped", "rotated"), 0.4),
    Cause("scaled", "by a factor", "geometry.moved", ("flipped", "rotated"), 0.4),
    # Patterns.
    Cause("fireflies or few pixels", "how many, brighter or darker", "traces.sparks"),
    # Sharpness.
    Cause(
        "softer", "blurred, by how many px, or without its noise", "softness.softened", _MOVED, 0.6
    ),
    Cause("sharper", "the reverse, or more detail", "softness.softened", _MOVED, 0.6),
    Cause("another CoC", _COC, "softness.softened", _MOVED, 0.6),
    Cause("lower resolution", "of which size", "softness.softened", left=0.25),
    # Known by the looks of a difference.
    Cause("compressed with losses", "blocks of 8 px", "traces.compressed", left=0.8, looks=True),
    Cause("seams", "lines of a period, or tiles of another exposure", "traces.seams", looks=True),
    Cause("noise", "added, or in another pattern", "traces.noise", looks=True),
)
LEFT = {row.name: row.left for row in CAUSES}
BEYOND = {row.name: row.beyond for row in CAUSES}
# Findings without a model.
STRUCTURE = {
    "NaN": "on one side only",
    "Inf": "on one side only",
    "missing channel": "which",
    "further channel": "which",
    "another size": "which",
    "deep samples": "their number, or their values",
    "renamed": "bytes of A, or inputs and settings, under another name",
    "other primaries declared": "which the headers name",
    "too small to name": "rounding to the steps of the file makes about as much of a difference",
}
PLACES = {
    "at silhouettes": "jumps of the CoC or of depth, and what lies within 2 px or the largest blur",
    "at edges": "the steepest tenth of the picture, and the pixels beside it",
    "in highlights": "light of A beyond 1 (0.9 of integers)",
    "at the border": "within 1 to 16 px",
    "in one region": "the rectangle that holds most of it, or all of it amid detail that is equal",
}
EVIDENCE = STRUCTURE | {row.name: row.words for row in CAUSES}
FINDINGS = (*EVIDENCE, *PLACES)  # first words of all names, for rules like found:clipped


@dataclass(frozen=True)
class Finding:
    """A finding on the cause of a difference."""

    name: str  # the cause in fixed words, like ``shifted`` or ``clipped at 1``
    text: str  # the cause with its numbers, for people
    values: Mapping[str, Any] = field(default_factory=dict)  # the numbers, for programs
    explained: float | None = None  # share of the RMSE that the cause explains, if it has one

    @property
    def code(self) -> str:
        """The kind of finding in one word, like ``clipped`` or ``at-silhouettes``."""
        return kind_of(self.name).replace(" ", "-").lower()


def kind_of(name: str) -> str:
    """The fixed words of a name, like ``clipped`` of ``clipped at 1``."""
    kinds = [kind for kind in FINDINGS if f"{name} ".startswith(f"{kind} ")]
    return max(kinds, key=len, default=name)


def is_place(name: str) -> bool:
    """Whether a finding is a place, and not a cause."""
    return name in PLACES

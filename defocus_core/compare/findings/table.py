"""Findings: a row for each cause of a difference, and the places of differences without a cause.

Rows are tried in order, simpler ones first. Rules on findings take their names from
these rows; `defocus help compare` tells the evidence of each.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Cause:
    """A possible cause of a difference."""

    name: str  # the fixed words of the finding
    model: str  # module of this folder and function that fits it to a pair, in one or several ways
    # Simpler causes that the model includes: it replaces one if its residual is at most half, and
    # is not its rival
    beyond: tuple[str, ...] = ()
    left: float = 0.35  # largest residual, as a share of the difference, at which it is named
    looks: bool = False  # whether it is tried only if no other is named


FACTOR = ("another exposure", "multiplied")
_LINEAR = (*FACTOR, "channels swapped", "premultiplication")
_TONES = (*_LINEAR, "offset or contrast", "inverted", "another gamma", "clipped", "normalised")
_TURNED, _MOVED = ("flipped", "rotated"), ("shifted", "scaled")
CAUSES = (
    # Values in place.
    Cause("empty", "tone.empty"),
    Cause("rounded to half", "tone.quantised"),
    Cause("clipped", "tone.clipped"),
    Cause("quantised", "tone.quantised", ("rounded to half",)),
    Cause("channels swapped", "tone.exchanged"),
    Cause("left and right swapped", "tone.exchanged"),
    Cause("layers exchanged", "tone.exchanged"),
    Cause("ids exchanged", "tone.exchanged_ids"),
    *(Cause(name, "tone.summed") for name in (*FACTOR, "normalised")),
    Cause("another gamma", "tone.summed", FACTOR),
    Cause("offset or contrast", "tone.summed", (*FACTOR, "normalised")),
    Cause("inverted", "tone.summed", FACTOR),
    Cause("radial depth", "tone.radial"),
    Cause("planar depth", "tone.radial"),
    Cause("premultiplication", "tone.premultiplied"),
    Cause("primaries or saturation", "tone.mixed_channels", _LINEAR),
    Cause("another tone curve", "tone.curve", _TONES),
    # Places.
    Cause("another view or frame", "geometry.other_file"),
    *(Cause(name, "geometry.flipped") for name in _TURNED),
    Cause("crop", "geometry.cropped", ("empty",)),
    *(Cause(name, "geometry.moved", _TURNED, 0.4) for name in _MOVED),
    # Patterns.
    Cause("fireflies or few pixels", "traces.sparks"),
    # Sharpness.
    *(Cause(n, "softness.softened", _MOVED, 0.7) for n in ("softer", "sharper", "another CoC")),
    Cause("lower resolution", "softness.softened", left=0.25),
    # Known by the looks of a difference.
    Cause("compressed with losses", "traces.compressed", left=0.8, looks=True),
    Cause("seams", "traces.seams", looks=True),
    Cause("noise", "traces.noise", looks=True),
)
LEFT = {row.name: row.left for row in CAUSES}
BEYOND = {row.name: row.beyond for row in CAUSES}
# Findings without a model.
_STRUCTURE = (
    *("NaN", "Inf", "missing channel", "further channel", "another size", "deep samples"),
    *("renamed", "other primaries declared", "too small to name"),
)
_PLACES = ("at silhouettes", "at edges", "in highlights", "at the border", "in one region")
FINDINGS = (*_STRUCTURE, *LEFT, *_PLACES)  # first words of all names, for rules like found:clipped


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
        return fixed_words(self.name).replace(" ", "-").lower()


def fixed_words(name: str) -> str:
    """The fixed words at the beginning of a name, like ``clipped`` of ``clipped at 1``."""
    kinds = [kind for kind in FINDINGS if f"{name} ".startswith(f"{kind} ")]
    return max(kinds, key=len, default=name)


def is_place(name: str) -> bool:
    """Whether a finding is a place, and not a cause."""
    return name in _PLACES

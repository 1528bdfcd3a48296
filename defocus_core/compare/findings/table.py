"""Findings: a row for each model of a cause, and the places of what no cause explains.

A row says which findings its model makes, and what is evidence for each, as `defocus help compare`
has it. Rows stand in the order in which they are tried, the simpler ones first. Names of rules,
help and tests are made of these rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Cause:
    """A model of what may have happened to B.

    Attributes:
        model: module of this folder and function that fits it to a pair, in one way or several.
        findings: names that it gives, each with the evidence for it.
        beyond: names of simpler causes that the model can make, too: it is named in the place of
            one of these where it leaves at most half as much, and is no rival to it.
        light: whether it is one of colour alone.
        left: largest share of a difference that it may leave, if it is to be named.
        turn: 1 for what is looked for where no row of turn 0 is named.
    """

    model: str
    findings: dict[str, str]
    beyond: tuple[str, ...] = ()
    light: bool = False
    left: float = 0.4
    turn: int = 0


_LINEAR = ("another exposure", "multiplied", "channels swapped", "premultiplication")
_TONES = (*_LINEAR, "offset or contrast", "inverted", "another gamma", "clipped", "normalised")
CAUSES = (
    # Values in place.
    Cause("tone.empty", {"empty": "one value everywhere, or 0 in a rectangle"}),
    Cause("tone.rounded", {"rounded to half": "to the numbers of 16 bits"}),
    Cause("tone.clipped", {"clipped": "at which limit, from above or from below"}),
    Cause("tone.quantised", {"quantised": "to the levels of how many bits"}, ("rounded to half",)),
    Cause(
        "tone.exchanged",
        {
            "channels swapped": "which",
            "left and right swapped": "B is the other view: a file `left`/`right` beside A, "
            "channels, or halves of the picture",
            "layers exchanged": "channels of one layer in the place of another",
        },
    ),
    Cause("tone.exchanged_ids", {"ids exchanged": "the same numbers, in other places"}),
    Cause(
        "tone.exposed",
        {
            "another exposure": "brighter or darker: the factor, of all channels or of each",
            "multiplied": "the same of channels that are not light, like depth",
        },
    ),
    Cause("tone.normalised", {"normalised": "0…1 of other numbers, like depth; or their inverse"}),
    Cause(
        "tone.radial",
        {
            "radial depth": "along rays instead of along the axis, by which focal length",
            "planar depth": "along the axis instead of along rays",
        },
    ),
    Cause(
        "tone.premultiplied",
        {"premultiplication": "colour divided or multiplied by alpha once more"},
        light=True,
    ),
    Cause(
        "tone.another_gamma",
        {"another gamma": "the power; sRGB encoded or decoded once more"},
        ("another exposure", "multiplied"),
    ),
    Cause(
        "tone.offset",
        {
            "offset or contrast": "A times a factor, and a constant: of light or of a screen",
            "inverted": "the same with a factor below 0",
        },
        ("another exposure", "multiplied", "normalised"),
    ),
    Cause(
        "tone.mixed_channels",
        {"primaries or saturation": "a matrix: which primaries, the factor, or grey"},
        _LINEAR,
        light=True,
    ),
    Cause("tone.curve", {"another tone curve": "a curve that rises"}, _TONES, light=True),
    # Places.
    Cause("geometry.other_file", {"another view or frame": "a file beside A"}),
    Cause("geometry.flipped", {"flipped": "how", "rotated": "by right angles"}),
    Cause("geometry.cropped", {"crop": "which part of A it is"}, ("empty",)),
    Cause(
        "geometry.moved",
        {"shifted": "by px, fractions included", "scaled": "by a factor"},
        ("flipped", "rotated"),
        left=0.2,
    ),
    # Patterns.
    Cause("traces.sparks", {"fireflies or few pixels": "how many, brighter or darker"}),
    Cause(
        "traces.overlay", {"overlay": "text or a watermark: one colour over a part"}, (), True, 0.15
    ),
    # Sharpness.
    Cause(
        "softness.filtered",
        {
            "softer": "blurred or denoised, by how many px",
            "sharper": "the reverse, or more detail",
            "another CoC": "either, where metadata, recipes or CoC maps say so",
        },
        light=True,
        left=0.68,
    ),
    Cause(
        "softness.resized",
        {"lower resolution": "of which size"},
        ("softer",),
        light=True,
        left=0.5,
    ),
    Cause(
        "softness.filtered_in_parts",
        {},
        ("softer", "sharper", "lower resolution", "shifted", "scaled"),
        light=True,
        left=0.68,
    ),
    # Known by how a difference looks.
    Cause(
        "traces.compressed",
        {"compressed with losses": "blocks of 8 px, or the header"},
        left=0.8,
        turn=1,
    ),
    Cause("traces.seams", {"seams": "on lines of a period, or tiles of another exposure"}, turn=1),
    Cause("traces.noise", {"noise": "added, or in another pattern"}, turn=1),
)
# What no model is fitted to.
STRUCTURE = {
    "NaN": "on one side only",
    "Inf": "on one side only",
    "missing channel": "which",
    "further channel": "which",
    "another size": "which",
    "deep samples": "their number, or their values",
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
EVIDENCE = STRUCTURE | {n: words for row in CAUSES for n, words in row.findings.items()}
FINDINGS = (*EVIDENCE, *PLACES)  # first words of all names, for rules like found:clipped


@dataclass(frozen=True)
class Finding:
    """What happened to B, as far as the pixels show.

    Attributes:
        name: the cause in fixed words, like ``shifted`` or ``clipped at 1``.
        text: the cause with its numbers, as a person reads it.
        values: the numbers, for programs.
        explained: share of the RMSE that the cause explains, 1 if it explains all; None where
            there is no such share.
    """

    name: str
    text: str
    values: Mapping[str, Any] = field(default_factory=dict)
    explained: float | None = None

    @property
    def code(self) -> str:
        """The kind of finding in one word, like ``clipped`` or ``at-silhouettes``."""
        return kind_of(self.name).replace(" ", "-").lower()


def kind_of(name: str) -> str:
    """The fixed words of a name, like ``clipped`` of ``clipped at 1``."""
    kinds = [kind for kind in FINDINGS if f"{name} ".startswith(f"{kind} ")]
    return max(kinds, key=len, default=name)


def is_place(name: str) -> bool:
    """Whether a finding says where a difference is, and no cause."""
    return name in PLACES

"""Findings: a row for each model of a cause, and the places of what no cause explains.

A finding is the name of a difference, with the evidence for it. A row says which findings its model
makes, and what is evidence for each, as `defocus help compare` has it; when it is tried; what it
may leave of a difference, if it is to be named; and its rivals. Names of rules, help and tests are
made of these rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

LEFT = 0.4  # largest share of a difference that an explanation may leave, if it is to be named
EXACT = 0.15  # the same for what predicts all values
_SOFT = "softened"  # the word for all that makes a picture softer


@dataclass(frozen=True)
class Cause:
    """A model of what may have happened to B.

    Attributes:
        model: module of this folder and function that fits it to a pair, in one way or several.
        findings: names that it gives, each with the evidence for it.
        turn: 0 is tried first; later turns only where the earlier ones leave something.
        left: largest share of a difference that it may leave, if it is to be named.
        rivals: the word for it and for all that can make the same picture, which is said where two
            of them explain about as much; empty if there are none.
        needs: ``light``; that of a difference that is ``no noise``; ``room`` for filters, or that
            without ``noise``; empty for any pair.
        local: whether it may befall a rectangle of the picture alone.
    """

    model: str
    findings: dict[str, str]
    turn: int = 0
    left: float = LEFT
    rivals: str = ""
    needs: str = ""
    local: bool = False


_COC = {
    "another CoC": "blurred more or less, everywhere alike or by as much as each part takes",
    "another CoC or bokeh shape": "which of both the metadata of renders says",
}
CAUSES = (
    # Values in place.
    Cause("tone.empty", {"empty": "one value everywhere, or 0 in a rectangle"}, local=True),
    Cause("tone.rounded", {"rounded to half": "to the numbers of 16 bits"}),
    Cause("tone.quantised", {"quantised": "to the levels of how many bits"}, left=EXACT),
    Cause("tone.clipped", {"clipped": "at which limit, from above or from below"}, left=EXACT),
    Cause("tone.swapped_channels", {"channels swapped": "which"}),
    Cause(
        "tone.exchanged_layers",
        {
            "left and right swapped": "B is the other view: a file `left`/`right` beside A, "
            "channels, or halves of the picture",
            "layers exchanged": "channels of one layer in the place of another",
            "missing layer": "A without one of its layers, like a specular pass",
        },
    ),
    Cause(
        "tone.exchanged_ids",
        {"ids exchanged": "the same numbers, in other places"},
        left=EXACT,
        local=True,
    ),
    Cause(
        "tone.normalised",
        {"normalised": "0…1 of other numbers, like depth; or their inverse"},
        left=EXACT,
    ),
    Cause(
        "tone.radial",
        {
            "radial depth": "along rays instead of along the axis, by which focal length",
            "planar depth": "along the axis instead of along rays",
        },
        left=EXACT,
    ),
    Cause(
        "tone.premultiplied",
        {"premultiplication": "colour divided or multiplied by alpha once more"},
        needs="light",
    ),
    Cause("tone.sign_reversed", {"sign reversed": "all numbers"}),
    Cause(
        "tone.exposed",
        {
            "another exposure": "the factor, of all channels or of each",
            "multiplied": "the same of channels that are not light, like depth",
        },
    ),
    Cause("tone.another_gamma", {"another gamma": "the power; sRGB encoded or decoded once more"}),
    Cause(
        "tone.raised",
        {
            "raised blacks": "the offset, of light or of what a screen shows",
            "lowered blacks": "the same, darker",
            "another contrast": "the factor and what it turns around",
            "offset": "the same of channels that are not light, like depth",
        },
    ),
    Cause("tone.vignette", {"vignette": "darker corners, or one side"}, needs="light"),
    Cause(
        "tone.mixed_channels",
        {
            "another saturation": "the factor",
            "monochrome": "the sum of channels",
            "other primaries": "which, as of ACES AP1, P3 or Rec. 2020, or that of a matrix",
        },
        needs="light",
    ),
    Cause("tone.curve", {"another tone curve": "a curve that rises"}, left=0.3, needs="no noise"),
    # Places.
    Cause("geometry.other_file", {"another view or frame": "a file beside A, or parts moved"}, 1),
    Cause(
        "geometry.flipped",
        {
            "flipped": "how",
            "rotated": "by right angles or degrees",
            "fields exchanged": "rows in pairs",
        },
        1,
    ),
    Cause("geometry.cropped", {"crop": "which part of A it is"}, 1, local=True),
    Cause("geometry.tiles", {"tiles exchanged": "tiles of which side"}, 1, EXACT, local=True),
    Cause(
        "geometry.moved",
        {
            "shifted": "by px, fractions included",
            "scaled": "by a factor, or by more at the sides, as a lens distorts",
            "sheared": "by px",
            "chromatic aberration": "each channel scaled about the middle",
        },
        1,
    ),
    Cause("geometry.moved_in_parts", {}, 1, 0.62, needs="light"),
    Cause("geometry.displaced", {"doubled": "a copy of its light, moved by px"}, 1, needs="light"),
    Cause("geometry.eroded", {"eroded": "by how many px", "dilated": "the same"}, 1, EXACT),
    # Patterns.
    Cause(
        "traces.sparks",
        {"fireflies": "few bright pixels", "dropped pixels": "few dark ones"},
        1,
        0.3,
        local=True,
    ),
    Cause("traces.lines", {"damaged lines": "rows or columns of other values"}, 1, local=True),
    Cause("traces.seams", {"seams": "on lines of a period, or tiles of another exposure"}, 1),
    Cause("traces.gains_of_tiles", {}, 1, 0.3, needs="light"),
    Cause("traces.halo", {"halo": "a band of some px along edges"}, 1, needs="light"),
    Cause(
        "traces.overlay",
        {"overlay": "text or a watermark: one colour and opacity over a part"},
        1,
        EXACT,
        needs="light",
        local=True,
    ),
    Cause(
        "traces.compressed",
        {"compressed with losses": "in blocks of 8 px, or by the header"},
        1,
        0.8,
        needs="light",
    ),
    Cause("traces.noise", {"noise": "added, or in another pattern"}, 1, 0.55),
    Cause("softness.bloom", {"bloom": "bright light spread far"}, 1, needs="room"),
    # Softer or sharper.
    Cause("softness.blurred_alike", _COC, 2, 0.3, _SOFT, "noise"),
    Cause(
        "softness.blurred_in_parts",
        {"another bokeh shape": "the same light within some px"},
        2,
        0.62,
        _SOFT,
        "noise",
    ),
    Cause(
        "softness.motion_blurred", {"motion blur": "its length and angle"}, 2, 0.3, _SOFT, "noise"
    ),
    Cause("softness.motion_in_parts", {}, 2, 0.62, _SOFT, "noise"),
    Cause("softness.resized", {"lower resolution": "of which size"}, 2, 0.75, needs="room"),
    Cause("softness.denoised", {"noise removed": "gone, as by a denoiser"}, 2, 0.62, _SOFT, "room"),
    Cause("softness.sharpened", {"sharpened": "by how much"}, 2, 0.3, needs="noise"),
    Cause(
        "softness.spread",
        {"spread otherwise": "the same light within some px"},
        3,
        0.25,
        needs="noise",
    ),
)
# What no model is fitted to.
STRUCTURE = {
    "NaN": "on one side only",
    "Inf": "on one side only",
    "missing channel": "which",
    "further channel": "which",
    "another size": "which",
    "apart": "values of channels of another size than the picture",
    "deep samples": "their number, or their values",
    "other primaries declared": "which the headers name",
    "softened": "two causes that soften tie: which",
    "too small to name": "rounding to the steps of the file makes about as much of a difference",
}
PLACES = {
    "in focus only": "a radius of up to 1 px",
    "out of focus only": "a radius of more than 1 px",
    "at silhouettes": "jumps of the CoC or of depth, and what lies within 2 px or the largest blur",
    "at edges": "the steepest tenth of the picture, and the pixels beside it",
    "in highlights": "light of A beyond 1 (0.9 of integers)",
    "in shadows": "below 0.1 as a screen shows it",
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
        kinds = [kind for kind in FINDINGS if f"{self.name} ".startswith(f"{kind} ")]
        return max(kinds, key=len, default=self.name).replace(" ", "-").lower()


def is_place(name: str) -> bool:
    """Whether a finding says where a difference is, and no cause."""
    return name in PLACES

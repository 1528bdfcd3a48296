"""The name of a difference whose cause is known, with the evidence for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


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


# Places of what no cause explains.
_PLACES = (
    *("in focus only", "out of focus only", "at silhouettes", "at edges", "in highlights"),
    *("in shadows", "at the border", "in one region"),
)
# First words of all names, for rules like found:clipped.
FINDINGS = (
    *("NaN", "Inf", "missing channel", "further channel", "another size", "apart", "deep samples"),
    *("clipped", "quantised", "rounded to half", "empty", "sign reversed", "channels swapped"),
    *("another exposure", "another gamma", "another tone curve", "another contrast"),
    *("raised blacks", "lowered blacks", "another saturation", "other primaries", "vignette"),
    *("premultiplication", "shifted", "rotated", "scaled", "flipped", "crop", "fields exchanged"),
    *("tiles exchanged", "left and right swapped", "another view or frame", "another CoC"),
    *(
        "motion blur",
        "sharpened",
        "lower resolution",
        "another bokeh shape",
        "spread otherwise",
        "seams",
        "halo",
    ),
    *("softened", "noise removed", "monochrome", "too small to name"),
    *("multiplied", "offset", "fireflies", "dropped pixels", "compressed with losses", "noise"),
    *_PLACES,
)


def is_place(name: str) -> bool:
    """Whether a finding says where a difference is, and no cause."""
    return name in _PLACES

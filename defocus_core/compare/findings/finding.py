"""The name of a difference whose cause is known, with the evidence for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from defocus_core.compare.findings.table import FINDINGS, PLACES


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

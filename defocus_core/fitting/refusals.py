"""What explains two pictures better than a blur does, or that nothing does."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from defocus_core.fitting.residual import Optics, Residual
from defocus_core.fitting.unknowns import Candidate


class Refusal(NamedTuple):
    """Why a blur is not what two pictures differ by.

    Attributes:
        code: A word of `defocus_core.errors.CODES`.
        problem: In words, without a full stop.
        remedy: What to do about it; options stand in angle quotes.
    """

    code: str
    problem: str
    remedy: str


def explained_by(residual: Residual, point: Candidate, optics: Optics) -> float:
    """The share of the difference between the pictures that a blur explains."""
    return 0.0


def refusals_of(
    residual: Residual, point: Candidate, optics: Optics, explained: float
) -> Iterator[Refusal]:
    """Why a point is not the lens of two pictures."""
    return iter(())

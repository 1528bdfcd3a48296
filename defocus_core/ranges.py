"""What random lenses are drawn from: ranges of two ends, and numbers of blades."""

from __future__ import annotations

import math
from collections.abc import Sequence

from defocus_core.aperture import Aperture
from defocus_core.guards import number

Range = tuple[float, float]


def interval(name: str, ends: Range, most: float | None = None) -> Range:
    """Two ends in order: above 0, or from 0 to the most.

    Raises:
        ValueError: If they are not.
    """
    try:
        low, high = (number(name, end) for end in ends)
        fits = 0 < low <= high < math.inf if most is None else 0 <= low <= high <= most
    except (TypeError, ValueError):
        fits = False
    if not fits:
        where = "above 0" if most is None else f"from 0 to {most:g}"
        raise ValueError(
            f"{name} must be (low, high) {where}, got {ends}; equal ends fix the value"
        )
    return low, high


def choices(blades: Sequence[int]) -> tuple[int, ...]:
    """Numbers of blades that an aperture may have, at least one.

    Raises:
        ValueError: If there is none, or one is no number of blades.
    """
    try:
        counts = [Aperture(count).blades for count in blades]
    except TypeError:
        counts = []
    if not counts:
        raise ValueError(f"blades must hold numbers to choose from, got {blades}; (0,) is round")
    return tuple(map(int, counts))


def logarithmic(ends: Range, share: float) -> float:
    """The value at a share of a range, even in the logarithm."""
    low, high = ends
    return low * math.pow(high / low, share)

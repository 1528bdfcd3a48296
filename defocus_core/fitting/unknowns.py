"""The unknowns of a pair of pictures, and points: a value of each."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from defocus_core.optics.aperture import Aperture

MAX_SHIFT = 16.0  # px
MAX_MAGNIFICATION = 1.02  # or its inverse: about twice a camera's between near and far focus
_TURN = 30.0  # degrees


@dataclass(frozen=True)
class Candidate:
    """A value of each unknown."""

    strength: float  # k, px of radius for a disparity of 1, in the sharp picture
    focus: float  # d₀, the disparity in focus
    gamma: float = 1.0  # power of the numbers of the pictures that is linear light
    across: float = 0.0  # px by which the blurred picture lies to the right of the sharp one
    down: float = 0.0  # px by which it lies below
    # Size of things in the blurred picture over that in the sharp one, about the middle
    magnification: float = 1.0
    rotation: float = 0.0  # degrees by which the pupil is turned
    # How far left and right are apart, in the distance of halves of the pupil that share no
    # light; below 0 they are exchanged
    separation: float = 1.0

    def turned(self, aperture: Aperture) -> Aperture:
        """The pupil with its rotation."""
        turn = self.rotation
        return replace(aperture, rotation=aperture.rotation + turn) if turn else aperture

    @property
    def rendered(self) -> Candidate:
        """What of it needs a rendering: registration and crosstalk need none."""
        return replace(self, across=0.0, down=0.0, magnification=1.0, separation=1.0)


@dataclass(frozen=True)
class Unknown:
    """An unknown, in units of which one is a large change."""

    name: str  # an attribute of `Candidate`
    unit: float  # of its value; of a ratio, of its logarithm
    probe: float  # difference that derivatives are taken over, in units
    maximum: float  # greatest step, in units
    is_ratio: bool = False  # whether steps multiply it
    # Greatest value, with either sign; of a ratio, greatest factor either way
    bound: float = math.inf

    def moved(self, value: float, step: float) -> float:
        """The value after a step."""
        if self.is_ratio:
            return min(max(value * math.exp(step * self.unit), 1 / self.bound), self.bound)
        return min(max(value + step * self.unit, -self.bound), self.bound)


def unknowns(span: float, names: Iterable[str]) -> list[Unknown]:
    """The unknowns of these names, for a range of disparity."""
    rows = [
        Unknown("strength", 1.0, 0.02, 0.5, is_ratio=True),
        Unknown("focus", span, 0.02, 0.25),
        Unknown("gamma", 1.0, 0.03, 0.2, is_ratio=True, bound=4.0),
        *(Unknown(name, 1.0, 0.25, 2.0, bound=MAX_SHIFT) for name in ("across", "down")),
        Unknown("magnification", 0.01, 0.1, 0.5, is_ratio=True, bound=MAX_MAGNIFICATION),
        Unknown("separation", 1.0, 0.1, 1.0, bound=1.2),
    ]
    wanted = set(names)
    return [row for row in rows if row.name in wanted]


def rotation_of(aperture: Aperture) -> Unknown:
    """The rotation of a pupil with blades as an unknown."""
    return Unknown("rotation", _TURN, 0.1, 90 / (aperture.blades * _TURN))


def moved(point: Candidate, free: Iterable[Unknown], steps: Sequence[float]) -> Candidate:
    """A point after a step in each of the unknowns that are free."""
    pairs = zip(free, steps, strict=True)
    return replace(point, **{u.name: u.moved(getattr(point, u.name), by) for u, by in pairs})

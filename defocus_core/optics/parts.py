"""Parts of the pupil: halves, quarters and sixteenths, their areas and weights."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor

from defocus_core.optics.outline import Outline
from defocus_core.optics.sensitivity import Sensitivity
from defocus_core.tensors.bands import Scalar

# Cuts between sixteen parts, along both axes; the outer parts of a disc are then about as large.
_CUTS = (-1.0, -0.45, 0.0, 0.45, 1.0)
# The least share of the pupil that is a part.
_MIN_PART = 1e-3
# Pixels across the pupil with which the weight of a part of a gaussian pupil is summed.
_WEIGHING_RADIUS = 256.0


@dataclass(frozen=True)
class Part:
    """An axis-parallel part of the pupil in lens coordinates: x0 <= u.x <= x1, y0 <= u.y <= y1.

    What lies in it counts 1 + lean u.x times, or as often as the sensitivity of a photodiode says;
    of a squeezed pupil, u before it is squeezed.
    """

    x0: float = -1.0
    x1: float = 1.0
    y0: float = -1.0
    y1: float = 1.0
    lean: float = 0.0
    sensitivity: Sensitivity | None = None

    @property
    def is_uneven(self) -> bool:
        """Whether some of it counts more often than the rest."""
        return bool(self.lean) or self.sensitivity is not None

    @property
    def is_left(self) -> bool:
        """Whether it belongs to the left of two halves."""
        return self.x1 <= 0 or self.lean < 0 or bool(self.sensitivity and self.sensitivity.is_left)

    def counted(self, u: Tensor, narrowing: tuple[Scalar, Scalar]) -> Tensor:
        """How often the light counts between corners u [..., n]: [..., n - 1, n - 1] or alike."""
        if self.sensitivity is None:
            return 1 + self.lean * narrowing[0] * middles(u)[..., None, :]
        x, y = ((u * times).clamp(-1, 1) for times in narrowing)
        return 2 * self.sensitivity.between(x, y)

    def clamp(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Lens coordinates, moved into the part."""
        return x.clamp(self.x0, self.x1), y.clamp(self.y0, self.y1)


FULL = Part()
LEFT = Part(x1=0.0)
RIGHT = Part(x0=0.0)


@lru_cache(maxsize=256)
def parts_of(outline: Outline, count: int) -> tuple[Part, ...]:
    """The parts of a pupil, first those of the LEFT half."""
    if count == 1:
        return (FULL,)
    if count == 2:
        return LEFT, RIGHT
    minimum = _MIN_PART * area_of(outline, FULL)
    if count == 4:
        cuts = [(half, _bisecting_height(outline, half)) for half in (LEFT, RIGHT)]
        return tuple(p for half, y in cuts for p in (replace(half, y1=y), replace(half, y0=y)))
    sides = list(pairwise(_CUTS))
    parts = (Part(x0, x1, y0, y1) for x0, x1 in sides for y0, y1 in sides)
    return tuple(part for part in parts if area_of(outline, part) > minimum)


def _bisecting_height(outline: Outline, part: Part) -> float:
    """The y of the level cut that halves a part's area, by bisection."""
    low, high, half = part.y0, part.y1, area_of(outline, part) / 2
    for _ in range(50):
        middle = (low + high) / 2
        if abs(excess := area_of(outline, replace(part, y1=middle)) - half) < 1e-14:
            return middle
        low, high = (middle, high) if excess < 0 else (low, middle)
    return (low + high) / 2


@lru_cache(maxsize=4096)
def area_of(outline: Outline, part: Part) -> Any:
    """Area of the part in units of the lens radius squared, a number unless it has a gradient."""
    x = torch.tensor([part.x0, part.x1], dtype=torch.float64, device="cpu")
    y = torch.tensor([part.y0, part.y1], dtype=torch.float64, device="cpu")
    area = outline.areas(x, y)
    return area[0, 0] if area.requires_grad else float(area)


@lru_cache(maxsize=256)
def weight_of(outline: Outline, part: Part) -> Any:
    """Area of the part times the gaussian profile, as `area_of`."""
    u = torch.arange(-_WEIGHING_RADIUS, _WEIGHING_RADIUS + 1, dtype=torch.float64, device="cpu")
    u = u / _WEIGHING_RADIUS
    weight = (outline.areas(*part.clamp(u, u)) * gaussian(u)).sum()
    return weight if weight.requires_grad else float(weight)


def gaussian(u: Tensor) -> Tensor:
    """exp(-|u|² / 2) at the middle of each pixel, [..., n] corners to [..., n - 1, n - 1].

    Corners are clamped to the unit square, which keeps it positive for any radius.
    """
    middle = middles(u)
    fall = torch.exp(-(middle**2) / 2)
    return fall[..., :, None] * fall[..., None, :]


def middles(u: Tensor) -> Tensor:
    """Lens points in the middle of what of each pixel [..., n - 1] lies between -1 and 1."""
    inside = u.clamp(-1, 1)
    return (inside[..., 1:] + inside[..., :-1]) / 2

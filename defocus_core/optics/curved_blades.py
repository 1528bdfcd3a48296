"""Curved blades: a polygon whose edges are arcs of circles, between straight and the disc."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from defocus_core.optics.outline import Outline, Polygon
from defocus_core.tensors.source import Scalar

# Below this curvature areas are interpolated: the sagitta is below 4e-4 of the radius.
_STRAIGHT = 1e-3


@dataclass(frozen=True)
class CurvedPolygon(Outline):
    """A polygon inscribed in the unit disc, whose edges are arcs through its vertices."""

    sides: int
    # Angle of one vertex in degrees, counter-clockwise from +x as seen in the image
    rotation: float
    curvature: Scalar  # 1 / radius of the arcs, within [0, 1]; 0 is straight, and 1 is the disc

    def cumulative_area(self, x: Tensor, y: Tensor) -> Tensor:
        """That within arcs; within hardly curved ones between it and that within straight edges.

        Areas beside arcs of very large circles lose digits, and bulge in proportion to curvature.
        """
        curvature = torch.as_tensor(self.curvature, dtype=x.dtype, device=x.device)
        if self.curvature >= _STRAIGHT:
            return self._within_arcs(x, y, 1 / curvature)
        straight = Polygon(self.sides, self.rotation).cumulative_area(x, y)
        bulging = self._within_arcs(x, y, torch.full_like(curvature.detach(), 1 / _STRAIGHT))
        return torch.lerp(straight, bulging, curvature / _STRAIGHT)

    def _within_arcs(self, x: Tensor, y: Tensor, radius: Tensor) -> Tensor:
        """The sum over arcs of the integral of min(y, height of the arc) up to x.

        It counts as positive for the arcs that bound the area at large y, as for `Polygon`.
        """
        apothem, half = math.cos(math.pi / self.sides), math.sin(math.pi / self.sides)
        # from the middle of the pupil to the centre of an arc's circle; 0 or negative
        distance = apothem - (radius * radius - half * half).sqrt()
        span = float(torch.asin(half / radius.detach()))
        total = torch.zeros((), dtype=x.dtype, device=x.device)
        for k in range(self.sides):
            start, middle, end = (
                math.radians(self.rotation + 360.0 * (k + part) / self.sides)
                for part in (0.0, 0.5, 1.0)
            )
            across, down = distance * math.cos(middle), -distance * math.sin(middle)
            t, height = x - across, y - down
            upright = _upright(middle - span, middle + span)
            cuts = [
                math.cos(start) - across,
                *(radius * math.cos(angle) for angle in upright),
                math.cos(end) - across,
            ]
            angles = [middle - span, *upright, middle + span]
            for side, limits in zip(pairwise(angles), pairwise(cuts), strict=True):
                left, right = sorted(limits, key=Tensor.item)
                # where it ends at the cut, a gradient moves the cut
                piece = torch.where(t < right, torch.where(t > left, t, left), right)
                if math.sin(sum(side) / 2) < 0:  # y is downwards
                    total = total + _up_to_arc(piece, height, radius)
                else:
                    total = total - height * piece - _up_to_arc(piece, -height, radius)
        return total


def inradius(sides: int, curvature: float) -> float:
    """The distance from the middle of the pupil to the middle of an edge."""
    half = math.sin(math.pi / sides)
    sagitta = curvature * half**2 / (1 + math.sqrt(1 - (curvature * half) ** 2))
    return math.cos(math.pi / sides) + sagitta


def _upright(start: float, end: float) -> list[float]:
    """Angles between two at which a circle is upright: between them a height for each x is left."""
    first, last = math.floor(start / math.pi) + 1, math.ceil(end / math.pi) - 1
    return [k * math.pi for k in range(first, last + 1)]


def _up_to_arc(t: Tensor, height: Tensor, radius: Tensor) -> Tensor:
    """The integral of min(height, sqrt(radius² - t²)) over t, up to terms in the height alone."""
    chord = torch.where(height > 0, _half_chord(height, radius), radius)
    area, low, high = (_area(s, radius) for s in (t, -chord, chord))
    level = height * torch.where(t.abs() < chord, t, torch.where(t > 0, chord, -chord))
    return level + torch.minimum(area, low) + torch.maximum(area, high)


def _area(t: Tensor, radius: Tensor) -> Tensor:
    """Integral of sqrt(radius² - t²) from 0 to t."""
    h = _half_chord(t, radius)
    return (t * h + radius * radius * torch.atan2(t, h)) / 2


def _half_chord(t: Tensor, radius: Tensor) -> Tensor:
    """sqrt(radius² - t²), with gradient 0 instead of infinity at |t| = radius."""
    squared = radius * radius - t * t
    inside = squared > 0
    return torch.where(inside, torch.where(inside, squared, 1.0).sqrt(), 0.0)

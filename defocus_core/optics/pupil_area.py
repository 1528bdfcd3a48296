"""The outline of the pupil, a disc or a polygon, and exact areas within it.

Areas come from G(x, y), the area left of x and above y, differenced over corners.
"""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor

# A flatter edge is taken as level at its mean height: 1/slope would cost more than it gains.
_LEVEL_SLOPE = 1e-6
# What differences of areas, of about 1, may be off by; and the share of the rectangle between that
# counts, where this is so small.
_ROUNDING, _LEAST_SHARE = 2e-15, 1e-2


def areas(blades: int, rotation: float, x: Tensor, y: Tensor) -> Tensor:
    """Areas of the pupil between consecutive x and consecutive y, all within [-1, 1].

    Args:
        blades: 0 for the disc, N for a polygon inscribed in it.
        rotation: Of a vertex in degrees, counter-clockwise from +x.
        x: [..., n], ascending or descending together with y.
        y: [..., m].

    Returns:
        [..., m - 1, n - 1] in units of the lens radius squared.
    """
    x, y = x[..., None, :], y[..., :, None]
    below = _polygon_area(blades, rotation, x, y) if blades else _disc_area(x, y)
    found = below.diff(dim=-1).diff(dim=-2)
    # outside, rounding is all that is left
    least = (_LEAST_SHARE * (x.diff(dim=-1) * y.diff(dim=-2)).abs()).clamp(max=_ROUNDING)
    return torch.where(found > least, found, 0.0)


def _disc_area(x: Tensor, y: Tensor) -> Tensor:
    """G of the unit disc, up to terms in x alone or y alone, which the differences remove.

    G is the integral over x' <= x of clip(y, -h, h) with h = sqrt(1 - x'²); it follows the rim
    for |x'| beyond a = sqrt(1 - y²) and is level between.
    """
    a = _half_chord(y)
    rim, rim_at_a = _half_disc_area(x), _half_disc_area(a)
    along_rim = torch.minimum(rim, math.pi / 2 - rim_at_a) + torch.maximum(rim, rim_at_a)
    return y.sign() * along_rim + y * torch.maximum(torch.minimum(x, a), -a)


def _half_disc_area(x: Tensor) -> Tensor:
    """Integral of sqrt(1 - t²) from -1 to x."""
    h = _half_chord(x)
    return (x * h + torch.atan2(x, h) + math.pi / 2) / 2


def _half_chord(x: Tensor) -> Tensor:
    """sqrt(1 - x²), with gradient 0 instead of infinity at |x| = 1."""
    squared = 1 - x * x
    inside = squared > 0
    return torch.where(inside, torch.where(inside, squared, 1.0).sqrt(), 0.0)


def _polygon_area(blades: int, rotation: float, x: Tensor, y: Tensor) -> Tensor:
    """G of the polygon, up to terms in x alone or y alone, which the differences remove.

    Green's theorem: the sum over edges of the integral of min(y, edge height) up to x, taken
    positive on the edges that bound the polygon at large y.
    """
    total: Tensor | None = None
    width = torch.zeros_like(x)  # what multiplies y
    for sign, left, right, height, slope in _edges(blades, rotation):
        reach = x.clamp(left, right)
        width = width + sign * reach
        if abs(slope) < _LEVEL_SLOPE:
            middle = height + slope * (right - left) / 2
            term = sign * reach * (middle - y).clamp(max=0)
        else:
            drop = (height + slope * (reach - left) - y).clamp(max=0)
            term = drop * drop * (sign / (2 * slope))
        total = term if total is None else total + term
    assert total is not None
    return total + width * y


@lru_cache(maxsize=64)
def _edges(blades: int, rotation: float) -> tuple[tuple[float, float, float, float, float], ...]:
    """Edges that are not vertical: (sign, left x, right x, y at the left, slope)."""
    angles = [math.radians(rotation + 360.0 * k / blades) for k in range(blades)]
    vertices = [(math.cos(a), -math.sin(a)) for a in angles]
    edges = []
    for start, end in zip(vertices, vertices[1:] + vertices[:1], strict=True):
        (x0, y0), (x1, y1) = sorted((start, end))
        if x1 - x0 > 1e-12:
            sign = 1.0 if end[0] > start[0] else -1.0
            edges.append((sign, x0, x1, y0, (y1 - y0) / (x1 - x0)))
    return tuple(edges)

"""A blur by its radii: focus and strength for which a depth map has the radii asked for.

The radius is affine in disparity, r = k (d₀ - d), so the radii of a picture are k times the
distances of its disparities from d₀: each d₀ has the k that suits it best in closed form, and d₀ is
searched among the disparities of the picture and beyond both ends of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

_SAMPLES = 1025  # quantiles that stand for the disparities of a picture
_POSITIONS = 257  # d₀ tried evenly over the range of disparity, and as many at quantiles
_BEYOND = torch.logspace(-2, 1.5, 48, dtype=torch.float64)  # d₀ beyond the range, in ranges
_SEEN = 0.5  # px: radii that differ by much less look the same, so that they count less
_MINIMUM = 1e-3  # px, of a picture that is sharp everywhere


class MatchedBlur(NamedTuple):
    """A blur, and the radii without sign that it gives a picture.

    Attributes:
        strength: k, px of radius for a disparity of 1.
        focus: d₀, the disparity in focus.
        radii: Their mean, median and 99th percentile in px.
    """

    strength: float
    focus: float
    radii: tuple[float, float, float]


def matched_blur(
    disparity: Tensor, radii: tuple[float, float, float], *, nearest: float = math.inf
) -> MatchedBlur:
    """The blur whose radii are nearest to those asked for, in the sum of squared log ratios.

    Two numbers cannot meet three in every picture: a picture without a plane that is in focus as a
    whole cannot have a median of 0 px.

    Args:
        disparity: Of any shape and unit, at least 0.
        radii: Mean, median and 99th percentile of the radii without sign, in px.
        nearest: Greatest disparity that may be in focus.

    Raises:
        ValueError: If a disparity is not finite or below 0, or a radius negative, or there is none;
            or if all are one that alone may be in focus, which no lens blurs.
    """
    if not disparity.numel() or not bool((torch.isfinite(disparity) & (disparity >= 0)).all()):
        raise ValueError("disparity must be finite and at least 0; infinitely far is 0")
    if not all(0 <= radius < math.inf for radius in radii):
        raise ValueError(f"radii must be finite and at least 0 px, got {radii}")
    values = disparity.flatten().double().cpu().sort().values
    ranks = torch.linspace(0, len(values) - 1, min(_SAMPLES, len(values)), dtype=torch.float64)
    sample = values[ranks.round().long()]
    positions = _positions(sample, nearest)
    sizes = _radii((positions[:, None] - sample).abs())  # [P, 3], for a strength of 1
    if not bool(sizes.any()):
        raise ValueError("disparity must differ from the only one that may be in focus")
    asked = torch.tensor(radii, dtype=torch.float64).clamp_min(_MINIMUM)
    weight = asked / (asked + _SEEN)
    ratio = (asked / sizes.clamp_min(1e-300)).log()
    strength = (ratio @ weight) / weight.sum()
    error = (ratio - strength[:, None]) ** 2 @ weight
    best = int(error.argmin())
    fitted, focus = math.exp(float(strength[best])), float(positions[best])
    mean, median, maximum = _radii(fitted * (focus - values).abs()[None])[0].tolist()
    return MatchedBlur(fitted, focus, (mean, median, maximum))


def fnum_of_strength(strength: float, focus: float, foclen: float, pixel_size: float) -> float:
    """The f-number of a lens, k = f² / (2 p N (1 - f d₀)) (`thin_lens`) solved for N.

    Args:
        strength: px of radius for a disparity of 1 per mm.
        focus: Disparity in focus per mm, less than 1 / foclen.
        foclen: mm.
        pixel_size: mm.
    """
    return foclen**2 / (2 * pixel_size * strength * (1 - foclen * focus))


def _positions(sample: Tensor, nearest: float) -> Tensor:
    """Disparities in focus to try [P]."""
    low, high = float(sample[0]), float(sample[-1])
    span = max(high - low, 0.01 * high, 1e-12)
    steps = torch.linspace(0, 1, _POSITIONS, dtype=torch.float64)
    quantiles = sample[(steps * (len(sample) - 1)).round().long()]
    positions = torch.cat(
        [low + span * steps, quantiles, high + span * _BEYOND, low - span * _BEYOND]
    )
    within = positions[(positions >= 0) & (positions <= nearest)]
    return within if len(within) else torch.tensor([max(min(low, nearest), 0.0)]).double()


def _radii(sizes: Tensor) -> Tensor:
    """Mean, median and 99th percentile [P, 3] of radii [P, N], as numpy takes them."""
    parts = torch.tensor([0.5, 0.99], dtype=sizes.dtype)
    ordered = sizes.sort(dim=1).values
    ranks = parts * (sizes.shape[1] - 1)
    low = ranks.floor().long()
    fraction = ranks - low
    high = (low + 1).clamp_max(sizes.shape[1] - 1)
    fitted = ordered[:, low] * (1 - fraction) + ordered[:, high] * fraction
    return torch.cat([sizes.mean(1, keepdim=True), fitted], 1)

"""Moments of the pupil and of its parts: area, centroid."""

from __future__ import annotations

import math
from functools import lru_cache

import torch

from defocus_core.optics.aperture import Aperture, Part, kernel

# Radius in px of the kernel of which a centroid is taken.
_SAMPLED = 48.0


@lru_cache(maxsize=256)
def centroid(aperture: Aperture, part: Part) -> tuple[float, float]:
    """The mean lens point (u.x, u.y) of a part of the pupil, to about 1e-4."""
    x, y = first_moments(_SAMPLED, aperture, part)
    return x / _SAMPLED, y / _SAMPLED


def first_moments(r: float, aperture: Aperture, part: Part) -> tuple[float, float]:
    """Of the kernel of a part: mean px to the right and downwards."""
    extent = math.ceil(abs(r))
    shares = kernel(torch.tensor(r, dtype=torch.float64), 2 * extent + 1, aperture, part)
    offset = torch.arange(-extent, extent + 1, dtype=shares.dtype)
    return float(shares.sum(0) @ offset), float(shares.sum(1) @ offset)

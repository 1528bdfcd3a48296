"""PSNR and structural similarity of NumPy arrays or tensors.

Z. Wang et al.: Image quality assessment: from error visibility to structural similarity, 2004.
"""

from __future__ import annotations

import math
from typing import Any

# A window is 11 x 11 px, weighted by a gaussian of sigma 1.5 px.
REACH, _SIGMA = 5, 1.5
# PSNR in dB of equal pictures, whose mean squared error is below 1e-10.
EQUAL = 99.0


def psnr(mean: float) -> float:
    """The PSNR in dB of a mean squared error, for a peak of 1; 99 dB below an error of 1e-10."""
    return EQUAL if mean < 1e-10 else -10 * math.log10(mean)


def similarity(a: Any, b: Any) -> Any:
    """The structural similarity of two pictures in each window, with C1 = 0.01², C2 = 0.03².

    `a`, `b`: [H, W] in 0…1, float64. Returns [H - 10, W - 10], a value for the middle of each
    window that lies within the pictures.
    """
    mean_a, mean_b, square, product = (_smooth(v) for v in (a, b, a * a + b * b, a * b))
    both, squares = mean_a * mean_b, mean_a * mean_a + mean_b * mean_b
    light = (2 * both + 1e-4) / (squares + 1e-4)
    structure = (2 * (product - both) + 9e-4) / (square - squares + 9e-4)
    return light * structure


def _smooth(values: Any) -> Any:
    """The gaussian-weighted mean of each window that lies within an array [h, w]."""
    weights = [math.exp(-(k**2) / (2 * _SIGMA * _SIGMA)) for k in range(REACH + 1)]
    total = weights[0] + 2 * sum(weights[1:])
    for _ in range(2):  # down, then across
        last = len(values) - REACH
        mean = weights[0] / total * values[REACH:last]
        for offset in range(1, REACH + 1):
            pair = values[REACH - offset : last - offset] + values[REACH + offset :][: len(mean)]
            pair *= weights[offset] / total
            mean += pair
        values = mean.T
    return values

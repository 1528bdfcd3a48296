"""Depth of a scene as networks estimate it for photographs: soft at edges, half the size, 8 bits.

The numbers are disparity, 0 at the farthest and 255 at the nearest pixel: what
`defocus render --depth-kind disparity --depth-range NEAR FAR --resize-depth guided` reads.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from surfaces import Array

SOFTNESS = 1.0  # standard deviation of the softened edges, in pixels of the half size


def estimated(depth: Array) -> tuple[NDArray[np.uint8], float, float]:
    """Levels [H / 2, W / 2] of disparity, and the depths of 255 and of 0.

    Args:
        depth: [H, W], inf is sky; both sides are even.
    """
    height, width = depth.shape
    disparity = (1 / depth).reshape(height // 2, 2, width // 2, 2).mean((1, 3))
    soft = softened(softened(disparity, 0), 1)
    minimum, maximum = float(soft.min()), float(soft.max())
    levels = np.round((soft - minimum) / (maximum - minimum) * 255).astype(np.uint8)
    return levels, 1 / maximum, 1 / minimum if minimum else math.inf


def softened(values: Array, axis: int) -> Array:
    """Values smoothed along an axis by a Gaussian; beyond the border the last value goes on."""
    reach = math.ceil(4 * SOFTNESS)
    weights = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * SOFTNESS**2))
    pad = [(reach, reach) if each == axis else (0, 0) for each in range(values.ndim)]
    padded = np.pad(values, pad, mode="edge")
    smooth = [np.convolve(line, weights / weights.sum(), "valid") for line in _lines(padded, axis)]
    return np.stack(smooth, 1 - axis)


def _lines(values: Array, axis: int) -> Array:
    """The lines of an array [H, W] along an axis, one after another."""
    return values if axis == 1 else values.T

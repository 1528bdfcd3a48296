"""Noise of a photograph, added again where blur has removed it.

The variance of the noise is a + b L at light L, as of a sensor. It is measured where the photograph
is in focus and smooth. Blur of radius r px averages about pi r² pixels, so that 1 / (pi r²) of the
variance remains.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.exr.writing import clamped_half
from defocus_core.picture.take import Take

# Side in px of the squares in which noise is measured; greatest blur radius of a sharp one in px.
_SIDE, _SHARP = 8, 0.5
# Light below which pixels count as black and above which as clipped; least number of squares.
_BLACK, _WHITE, _ENOUGH = 0.002, 0.9, 16
# Number of brightness classes; quantile of the variances in a class that is taken, as few squares
# are flat; and the ratio of the variance of white noise to that quantile.
_BINS, _FLAT, _GREATER = 12, 0.25, 1.32


def grain_of(take: Take) -> list[tuple[float, float]]:
    """Coefficients (a, b) of the variance a + b L of noise at light L, for each colour channel."""
    color = take.inputs.color
    sharp = _squares(np.abs(take.shown)).max(1) <= _SHARP
    found = [_variance(np.asarray(plane, np.float32), sharp) for plane in color.light]
    if any(each is None for each in found):
        problem = "has no sharp place that is flat enough to measure its noise"
        remedy = "give the noise as ELECTRONS:READ, like 4000:3"
        raise InputError("empty", problem, remedy, path=color.path)
    return [each for each in found if each is not None]


def grained(
    plane: Any, noise: tuple[float, float], radius: Any, seed: int, *, is_half: bool
) -> NDArray[Any]:
    """Add noise to a blurred plane [H, W], so that it is as noisy as the sharp photograph.

    `noise` are the coefficients (a, b) of its variance a + b L at light L; `radius` are blur radii
    [H, W] px; `is_half` tells whether the plane is a view through half of the lens.
    """
    light = np.asarray(plane, np.float32)
    averaged = np.maximum(math.pi * np.square(radius) / (2 if is_half else 1), 1)
    variance = (noise[0] + noise[1] * light.clip(min=0)) * (1 - 1 / averaged)
    random = np.random.default_rng(seed).standard_normal(light.shape, np.float32)
    noisy = (light + np.sqrt(variance) * random).astype(np.float32)
    return clamped_half(noisy)[0] if plane.dtype == np.float16 else noisy


def _variance(light: NDArray[np.float32], sharp: NDArray[np.bool_]) -> tuple[float, float] | None:
    """Coefficients (a, b) of the variance of noise, a + b L, in light [H, W].

    They are fitted to squares that are `sharp` and smooth; None if there are too few. Second
    differences respond to noise, but not to constant or linear light (Immerkaer, "Fast noise
    variance estimation", 1996).
    """
    across = light[:, :-2] - 2 * light[:, 1:-1] + light[:, 2:]
    rough = np.zeros_like(light)
    rough[1:-1, 1:-1] = (across[:-2] - 2 * across[1:-1] + across[2:]) / 6
    level, variance = _squares(light).mean(1), np.square(_squares(rough)).mean(1)
    usable = sharp & (level > _BLACK) & (_squares(light).max(1) < _WHITE) & (variance > 0)
    if np.count_nonzero(usable) < _ENOUGH:
        return None
    level, variance = level[usable], variance[usable]
    order = np.argsort(level)
    levels, noises = [], []
    for some in np.array_split(order, min(_BINS, len(order) // _ENOUGH)):
        levels.append(float(level[some].mean()))
        noises.append(_GREATER * float(np.quantile(variance[some], _FLAT)))
    x, y = np.array(levels), np.array(noises)
    weights = 1 / y  # the error of a variance grows with it
    b, a = np.polyfit(x, y, 1, w=weights) if len(x) > 1 else (0.0, y[0])
    if a < 0:
        a, b = 0.0, np.average(y / x, weights=x * weights)
    if b < 0:
        a, b = np.average(y, weights=weights), 0.0
    return float(a), float(b)


def _squares(plane: NDArray[Any]) -> NDArray[Any]:
    """Cut a plane [H, W] into squares of 8 by 8 px, [n, 64]; incomplete squares are left out."""
    rows, columns = (n // _SIDE for n in plane.shape)
    cut = plane[: rows * _SIDE, : columns * _SIDE].reshape(rows, _SIDE, columns, _SIDE)
    return cut.swapaxes(1, 2).reshape(rows * columns, _SIDE * _SIDE)

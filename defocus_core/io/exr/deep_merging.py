"""Merging of the samples of deep pixels that have more of them than there are layers.

Of a pixel the two neighbours nearest to each other in 1 / distance become one, until there are few
enough: blur is linear in 1 / distance. The nearer one weakens the light of the farther one by its
alpha, and both count by what shows of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.exr.deep_samples import BACK, DEPTH, FRONT, Strip

MAX_LAYERS = 12
_MERGED = 1 << 12  # pixels merged at once


def merged(strip: Strip, light: tuple[str, ...]) -> tuple[Strip, int]:
    """The strip with `MAX_LAYERS` samples a pixel at most, and how many pixels had more."""
    crowded = np.unique(strip.pixel[strip.rank >= MAX_LAYERS])
    if not len(crowded):
        return strip, 0
    kept = ~np.isin(strip.pixel, crowded)
    pieces = [(strip.pixel[kept], strip.rank[kept], {n: strip.values[n][kept] for n in light})]
    depths = [strip.values[DEPTH][kept]]
    for first in range(0, len(crowded), _MERGED):
        some = crowded[first : first + _MERGED]
        values, near = _merge_pixels(strip, some, light)
        alive = near >= 0
        rank = np.cumsum(alive, 1) - 1
        pieces.append(
            (
                np.repeat(some, alive.sum(1)),
                rank[alive],
                {n: each[alive] for n, each in zip(light, values, strict=True)},
            )
        )
        with np.errstate(divide="ignore"):
            depths.append((1 / near[alive]).astype(np.float32))
    pixel, rank = (np.concatenate([piece[k] for piece in pieces]) for k in (0, 1))
    merged = {n: np.concatenate([piece[2][n] for piece in pieces]).astype("f4") for n in light}
    merged[DEPTH] = np.concatenate(depths)
    for name in (n for n in (FRONT, BACK) if n in strip.values):
        merged[name] = np.concatenate([strip.values[name][kept], *depths[1:]])
    return Strip(strip.window, pixel, rank, merged), len(crowded)


def _merge_pixels(
    strip: Strip, pixels: NDArray[Any], light: tuple[str, ...]
) -> tuple[list[NDArray[Any]], NDArray[Any]]:
    """Values [P, K] of pixels, and 1 / distance; -1 where a sample was merged into the one before.

    Args:
        strip: the samples.
        pixels: [P] pixels that have too many.
        light: channels to merge, alpha the last.
    """
    chosen = np.flatnonzero(np.isin(strip.pixel, pixels))
    at = np.searchsorted(pixels, strip.pixel[chosen]), strip.rank[chosen]
    shape = len(pixels), int(strip.rank[chosen].max()) + 1
    near = np.full(shape, -1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        near[at] = np.nan_to_num(1 / strip.values[DEPTH][chosen], nan=0, posinf=0)
    values = [np.zeros(shape) for _ in light]
    for name, each in zip(light, values, strict=True):
        each[at] = strip.values[name][chosen]
    row = np.arange(len(pixels))
    while (many := (near >= 0).sum(1) > MAX_LAYERS).any():
        # living samples in order, then the pair with the least step
        order = np.argsort(near < 0, axis=1, kind="stable")
        near = np.take_along_axis(near, order, 1)
        values = [np.take_along_axis(each, order, 1) for each in values]
        step = np.where(near[:, 1:] >= 0, near[:, :-1] - near[:, 1:], np.inf)
        one = step.argmin(1)[many]
        two, which = one + 1, row[many]
        left = 1 - values[-1][which, one]
        weights = values[-1][which, one], values[-1][which, two] * left
        total = np.maximum(weights[0] + weights[1], 1e-30)
        near[which, one] = (weights[0] * near[which, one] + weights[1] * near[which, two]) / total
        for each in values:
            each[which, one] += each[which, two] * left
        near[which, two] = -1
    return values, near

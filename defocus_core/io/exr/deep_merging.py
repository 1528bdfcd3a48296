"""Merging of the samples of deep pixels that have more of them than there are layers.

Of a pixel the two neighbours nearest to each other in 1 / distance become one, until there are few
enough: blur is linear in 1 / distance. The nearer one weakens the light of the farther one by its
alpha, and both count by what shows of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.exr.deep_samples import BACK, DEPTH, FRONT, Strip

MAX_LAYERS = 12
_MERGED = 1 << 18  # samples merged at once, were each pixel to have as many


def merged(strip: Strip, light: tuple[str, ...]) -> tuple[Strip, int]:
    """The strip with `MAX_LAYERS` samples a pixel at most, and how many pixels had more."""
    crowded = np.unique(strip.pixel[strip.rank >= MAX_LAYERS])
    if not len(crowded):
        return strip, 0
    kept = ~np.isin(strip.pixel, crowded)
    pieces = [(strip.pixel[kept], strip.rank[kept], {n: strip.values[n][kept] for n in light})]
    depths = [strip.values[DEPTH][kept]]
    for some in _alike(crowded, np.bincount(strip.pixel)[crowded]):
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


def _alike(pixels: NDArray[Any], counts: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Pixels in order, some at a time, that have about as many samples."""
    order, first = np.argsort(counts, kind="stable"), 0
    while first < len(order):
        sizes = counts[order[first : first + _MERGED]]
        fit = np.searchsorted(sizes * np.arange(1, len(sizes) + 1), _MERGED, "right")
        end = first + max(int(fit), 1)
        yield np.sort(pixels[order[first:end]])
        first = end


def _merge_pixels(
    strip: Strip, pixels: NDArray[Any], light: tuple[str, ...]
) -> tuple[list[NDArray[Any]], NDArray[Any]]:
    """Values [P, K] of pixels, and 1 / distance; -1 where a sample was merged into the one before.

    `pixels`: [P] pixels that have too many.
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
    while (excess := (near >= 0).sum(1) - MAX_LAYERS).max() > 0:
        # living samples in order
        order = np.argsort(near < 0, axis=1, kind="stable")[:, : MAX_LAYERS + excess.max()]
        near = np.take_along_axis(near, order, 1)
        values = [np.take_along_axis(each, order, 1) for each in values]
        which, one = _nearest_pairs(near, excess)
        two, left = one + 1, 1 - values[-1][which, one]
        weights = values[-1][which, one], values[-1][which, two] * left
        total = np.maximum(weights[0] + weights[1], 1e-30)
        near[which, one] = (weights[0] * near[which, one] + weights[1] * near[which, two]) / total
        for each in values:
            each[which, one] += each[which, two] * left
        near[which, two] = -1
    return values, near


def _nearest_pairs(near: NDArray[Any], excess: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Pixel, and first sample, of pairs that are merged sooner or later if the nearest come first.

    A merged pair is no nearer to its neighbours than its samples were. So of `excess` merges none
    is of samples farther apart than as many steps are; up to there the pairs that are nearer to
    each other than to their neighbours are merged as they are, whichever comes first.

    `near`: [P, K] 1 / distance of samples in order, -1 behind the last; `excess`: [P] how many
    samples are to be merged into others.
    """
    step = np.where(near[:, 1:] >= 0, near[:, :-1] - near[:, 1:], np.inf)
    row = np.arange(len(near))
    limit = np.sort(step, 1)[row, np.maximum(excess, 1) - 1][:, None]
    beside = np.pad(step, ((0, 0), (1, 1)), constant_values=np.inf)
    # of equal steps in a row every other one is taken, from the first
    falls = beside[:, :-2] > step
    run = np.arange(step.shape[1]) - np.maximum.accumulate(
        np.where(beside[:, :-2] != step, np.arange(step.shape[1]), 0), 1
    )
    start = np.take_along_axis(falls, np.arange(step.shape[1]) - run, 1)
    local = (start & (run % 2 == 0) | ~start & (run % 2 == 1)) & (beside[:, 2:] >= step)
    local &= step <= limit
    ties = local & (step == limit)
    allowed = excess - (step < limit).sum(1)
    local &= ~ties | (np.cumsum(ties, 1) <= allowed[:, None])
    local &= excess[:, None] > 0
    which, first = np.nonzero(local)
    return which, first

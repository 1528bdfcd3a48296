"""Openings of the lens as spans of rows: where the disc of each radius begins and ends in a row."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# Radii are rounded to this share of a px.
STEPS = 16
# Radii in px of the discs near focus: a pixel between two is a mean of both that keeps the second
# moment of the blur, as the slices of the torch back. Up to SHARP it is a point.
NEAR, SHARP, SOFT = (0.75, 1.5), 0.15, 0.25
FIRST, SECOND = (round(r * STEPS) for r in NEAR)
# Heights at which the chords of a row are averaged.
_CHORDS = 8


class Opening(NamedTuple):
    """The spans of an opening, for radii of 0, 1 / STEPS, ... px up to `reach`."""

    spans: NDArray[np.float32]  # [2, n, 2 reach + 1, 2] px, nearer than focus and beyond it
    area: NDArray[np.float32]  # [n] one divided by the area in px
    left_area: NDArray[np.float32]  # [2, n] the same of the half whose lens points are u.x < 0
    # [n] of the disc, near focus of the next one of NEAR; the rest is of the one before, or a point
    share: NDArray[np.float32]
    # [2, n] px by which pixels move the light of the left half too little: near focus alone, where
    # a shift within a pixel is lost
    lost: NDArray[np.float32]
    reach: int


# Radius in px from which on no lost shifts are made up for: less than 0.03 px is lost there.
LOST = 2.25


def _lost(spans: NDArray[np.float32], share: NDArray[np.float64]) -> NDArray[np.float32]:
    """The `lost` shifts of an opening."""
    count = min(math.ceil(LOST * STEPS), len(share))
    moved = np.zeros((2, count))  # mean place of the light of left halves, as pixels have it
    middle = np.zeros(2)  # the same of a lens, for a radius of 1 px
    pixel = np.arange(-4, 5)
    for side in (0, 1):
        begin, end = spans[side, :, :, 0], spans[side, :, :, 1]
        begin, end = (begin, end.clip(max=0)) if side else (begin.clip(min=0), end)
        end = np.maximum(begin, end).astype(np.float64)
        most = spans.shape[1] - 2
        middle[side] = ((end**2 - begin**2) / 2)[most].sum() / (end - begin)[most].sum()
        middle[side] /= most / STEPS
        for k in range(count):
            edges = np.stack([begin[k], end[k]])[..., None]
            within = edges.clip(pixel - 0.5, pixel + 0.5)
            moved[side, k] = ((within[1] - within[0]) * pixel).sum() / (end - begin)[k].sum()
    r = np.arange(count) / STEPS
    begun = ((r - SHARP) / (SOFT - SHARP)).clip(0, 1)
    first, second = moved[:, min(FIRST, count - 1), None], moved[:, min(SECOND, count - 1), None]
    part = share[:count]
    apparent = np.where(
        r < NEAR[0],
        part * first,
        np.where(r < NEAR[1], (1 - part) * first + part * second, moved),
    )
    lost = np.zeros((2, len(share)), np.float32)
    lost[:, :count] = begun * r * middle[:, None] - apparent
    return lost


@lru_cache(maxsize=8)
def disc(reach: int) -> Opening:
    """A round opening up to a radius of `reach` px."""
    n, reach = reach * STEPS + 2, reach + 1
    radii = np.maximum(np.arange(n) / STEPS, NEAR[0])
    y = np.arange(-reach, reach + 1)[:, None] + (np.arange(_CHORDS) + 0.5) / _CHORDS - 0.5
    spans = np.zeros((2, n, 2 * reach + 1, 2), np.float32)
    for k, r in enumerate(radii):
        half = np.sqrt(np.maximum(r * r - y * y, 0)).mean(1)
        spans[:, k, :, 0], spans[:, k, :, 1] = -half, half
    width = spans[0, :, :, 1].sum(1, dtype=np.float64)
    share = np.ones(n)
    share[:SECOND] = _near_focus(np.arange(SECOND) / STEPS)[:n]
    left = np.stack([1 / width, 1 / width])
    return Opening(
        spans,
        (0.5 / width).astype(np.float32),
        left.astype(np.float32),
        share.astype(np.float32),
        _lost(spans, share),
        reach,
    )


def _near_focus(r: NDArray[np.float64]) -> NDArray[np.float64]:
    """The share of the next disc of NEAR in the blur of radii in px below the last of them."""
    rising = ((SOFT / NEAR[0]) * (r - SHARP) / (SOFT - SHARP)) ** 2
    first = np.where(r <= SHARP, 0.0, np.where(r < SOFT, rising, (r / NEAR[0]) ** 2))
    squares = [radius**2 for radius in NEAR]
    return np.where(r < NEAR[0], first, (r * r - squares[0]) / (squares[1] - squares[0]))

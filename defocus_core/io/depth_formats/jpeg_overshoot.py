"""Overshoot of JPEG beside edges of depth: numbers beyond those of both surfaces.

JPEG codes blocks of 8×8 px. In a block with an edge the numbers oscillate about those of its two
surfaces; pixels beyond both would be sharp around a blurred face, or blurred around a sharp one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

_BLOCK = 8  # px
_AROUND = 2  # blocks to each side of one with an edge in which its surfaces are seen
# Levels of 8 bits that a block of a single surface spans at most, and one with an edge at least;
# greatest overshoot, as a share of what a block spans: more is a thing of its own.
_SURFACE, _EDGE, _MOST = 6, 16, 0.25


def without_overshoot(values: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The numbers [H, W] of a JPEG, limited at edges to the range of the surfaces around."""
    height, width = values.shape
    padded = np.pad(values, [(0, -n % _BLOCK) for n in (height, width)], mode="edge")
    blocks = padded.reshape(len(padded) // _BLOCK, _BLOCK, -1, _BLOCK).astype(np.float32)
    clipped = blocks.clip(-_greatest(-blocks), _greatest(blocks))
    return clipped.astype(np.uint8).reshape(padded.shape)[:height, :width]


def _greatest(blocks: NDArray[np.float32]) -> NDArray[Any]:
    """The greatest number [h, 1, w, 1] in blocks [h, 8, w, 8], overshoot left out."""
    greatest, span = blocks.max((1, 3)), np.ptp(blocks, (1, 3))
    of_surfaces = np.where(span <= _SURFACE, greatest, -np.inf)
    framed = np.pad(of_surfaces, _AROUND, constant_values=-np.inf)
    around = sliding_window_view(framed, (2 * _AROUND + 1,) * 2).max((2, 3))
    overshoots = (span > _EDGE) & (greatest - around <= _MOST * span)
    limit: NDArray[Any] = np.where(overshoots, around, greatest)
    return limit[:, None, :, None]

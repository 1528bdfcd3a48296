"""Overshoot of JPEG at edges of depth: numbers outside the range of the two surfaces.

JPEG codes blocks of 8×8 px. In a block with an edge the numbers oscillate about those of its two
surfaces. Pixels outside this range would be drawn sharp around a blurred face, or blurred around
a sharp one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

_BLOCK = 8  # px
_AROUND = 2  # distance in blocks up to which blocks of a single surface are looked for
# Greatest range, in levels of 8 bits, of a block with a single surface; range above which a block
# has an edge; greatest overshoot, as a share of a block's range: more is another surface.
_SURFACE, _EDGE, _MOST = 6, 16, 0.25


def without_overshoot(values: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The numbers [H, W] of a JPEG without overshoot.

    In blocks with an edge they are clipped to the range of the surfaces around.
    """
    height, width = values.shape
    padded = np.pad(values, [(0, -n % _BLOCK) for n in (height, width)], mode="edge")
    blocks = padded.reshape(len(padded) // _BLOCK, _BLOCK, -1, _BLOCK).astype(np.float32)
    clipped = blocks.clip(-_greatest(-blocks), _greatest(blocks))
    return clipped.astype(np.uint8).reshape(padded.shape)[:height, :width]


def _greatest(blocks: NDArray[np.float32]) -> NDArray[Any]:
    """The upper limit [h, 1, w, 1] of blocks [h, 8, w, 8]: their maximum without overshoot."""
    greatest, span = blocks.max((1, 3)), np.ptp(blocks, (1, 3))
    of_surfaces = np.where(span <= _SURFACE, greatest, -np.inf)
    framed = np.pad(of_surfaces, _AROUND, constant_values=-np.inf)
    around = sliding_window_view(framed, (2 * _AROUND + 1,) * 2).max((2, 3))
    overshoots = (span > _EDGE) & (greatest - around <= _MOST * span)
    limit: NDArray[Any] = np.where(overshoots, around, greatest)
    return limit[:, None, :, None]

"""Positions of coarse pixels at half the resolution, a quarter, and so on.

They are symmetric about the middle of the frame, as in `tensors/pyramid.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Coarse(NamedTuple):
    """The coarse pixels of each level, down and across; level 0 is the frame itself."""

    length: NDArray[np.int64]  # [levels, 2]
    before: NDArray[np.int64]  # [levels, 2] pixels missing before the first one of the finer level
    odd: NDArray[np.int64]  # [2] whether a coarse pixel is a pixel and half of each neighbour
    origin: NDArray[np.float64]  # [levels, 2] position of pixel 0 of the frame, in coarse pixels


def coarse_pixels(size: tuple[int, ...], levels: int) -> Coarse:
    """The coarse pixels of levels 0 to `levels` of a frame of `size` (height, width)."""
    length, middle = np.array(size), np.array(size) // 2
    odd, origin = length % 2, np.zeros(2)
    every = [(length, 0 * length, origin)]
    for _ in range(levels):
        before = middle % 2
        after = (length + before + odd) % 2
        origin = (origin + before) / 2 - np.where(odd, 0, 0.25)
        length, middle = (length + before + after + odd) // 2, (middle + before) // 2
        every.append((length, before, origin))
    lengths, before, origins = (np.stack(each) for each in zip(*every, strict=True))
    return Coarse(lengths, before, odd, origins)

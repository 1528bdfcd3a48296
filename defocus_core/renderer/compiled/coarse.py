"""Where coarse pixels lie, of half the resolution, a quarter, and so on.

As those of `tensors/pyramid.py`.
"""

from __future__ import annotations

from typing import NamedTuple


class CoarseAxis(NamedTuple):
    """The coarse pixels of a level along an axis, symmetric about the middle of the frame."""

    length: int
    origin: float  # the place of the middle of pixel 0 of the frame among coarse pixels
    before: int  # pixels missing before the first one of the next finer level
    odd: bool  # whether every second pixel makes one, with half of its neighbours


def coarse_axes(length: int, levels: int) -> list[CoarseAxis]:
    """The levels of an axis, the frame itself first."""
    odd, middle = length % 2 == 1, length // 2
    origin, every = 0.0, [CoarseAxis(length, 0.0, 0, odd)]
    for _ in range(levels):
        before = middle % 2
        after = (length + before + odd) % 2
        origin = (origin + before) / 2 - (0 if odd else 0.25)
        length, middle = (length + before + after + odd) // 2, (middle + before) // 2
        every.append(CoarseAxis(length, origin, before, odd))
    return every

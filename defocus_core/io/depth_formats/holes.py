"""Pixels without depth: refused, taken as infinitely far, or filled from the farther neighbour."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.arrays import bands


def set_far(metres: Any, rows: slice) -> None:
    """Make invalid pixels of some rows infinitely far, in place."""
    band = metres[rows]
    metres[rows] = np.where(band > 0, band, np.float32(np.inf))


def set_outside(metres: Any, within: tuple[slice, slice]) -> None:
    """Make the depth invalid outside some rows and columns."""
    (height, width), (rows, columns) = metres.shape, within
    for outside in (
        (slice(0, rows.start), slice(0, width)),
        (slice(rows.stop, height), slice(0, width)),
        (rows, slice(0, columns.start)),
        (rows, slice(columns.stop, width)),
    ):
        if all(cut.stop > cut.start for cut in outside):
            metres[outside] = np.full([c.stop - c.start for c in outside], np.nan, np.float32)


def fill_from_farther(metres: Any) -> bool:
    """Give invalid pixels the farther of the depths next to them in their row, in place.

    A hole is nearly always behind the edge that made it (shadows of stereo, laser and structured
    light). Rows without any depth take the farther of the nearest rows above and below.

    Returns:
        Whether there was any depth to fill from.
    """
    height, _ = metres.shape
    empty = np.ones(height, bool)
    for rows in bands(metres.shape):
        band = metres[rows]
        valid = band > 0
        empty[rows] = ~valid.any(axis=1)
        if not valid.all():
            metres[rows] = _filled_along_rows(band, valid)
    full = np.flatnonzero(~empty)
    if not full.size:
        return False
    for y in np.flatnonzero(empty):
        place = int(np.searchsorted(full, y))
        beside = full[max(place - 1, 0) : place + 1]
        metres[y : y + 1] = np.max([metres[n : n + 1] for n in beside], axis=0)
    return True


def _filled_along_rows(band: NDArray[np.float32], valid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Rows whose invalid pixels have the farther of the nearest valid ones left and right."""
    columns = np.arange(band.shape[1])
    left = np.maximum.accumulate(np.where(valid, columns, -1), axis=1)
    right = np.where(valid, columns, band.shape[1])[:, ::-1]
    right = np.minimum.accumulate(right, axis=1)[:, ::-1]
    known = np.where(valid, band, np.float32(0))
    padded = np.pad(known, ((0, 0), (0, 1)))  # the columns −1 and W hold 0
    sides = [np.take_along_axis(padded, side, axis=1) for side in (left, right)]
    filled: NDArray[np.float32] = np.where(valid, band, np.maximum(*sides))
    return filled

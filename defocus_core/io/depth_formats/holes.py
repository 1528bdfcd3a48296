"""Pixels without depth: taken as infinitely far, or filled from the farther neighbour.

Both take distances, of which those above 0 are valid, or relative disparity, of which all that is
finite is: its farthest number stands for infinity.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.arrays import bands

Valid = Callable[[slice], NDArray[np.bool_]]  # where some rows have a depth


def set_far(metres: Any, valid: Valid, far: float = np.inf) -> None:
    """Make invalid pixels as far as ``far``, in place."""
    for rows in bands(metres.shape):
        metres[rows] = np.where(valid(rows), metres[rows], np.float32(far))


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


def fill_from_farther(metres: Any, valid: Valid, farther: np.ufunc = np.maximum) -> None:
    """Give invalid pixels, which are not all, the farther of those next to them in their row.

    A hole is nearly always behind the edge that made it (shadows of stereo, laser and structured
    light). Rows without any depth take the farther of the nearest rows above and below.

    `metres`: [H, W].
    """
    height, _ = metres.shape
    empty = np.ones(height, bool)
    for rows in bands(metres.shape):
        known = valid(rows)
        empty[rows] = ~known.any(axis=1)
        if not known.all():
            metres[rows] = _filled_along_rows(metres[rows], known, farther)
    full = np.flatnonzero(~empty)
    for y in np.flatnonzero(empty):
        place = int(np.searchsorted(full, y))
        beside = full[max(place - 1, 0) : place + 1]
        metres[y : y + 1] = farther.reduce([metres[n : n + 1] for n in beside])


def _filled_along_rows(
    band: NDArray[np.float32], valid: NDArray[np.bool_], farther: np.ufunc
) -> NDArray[np.float32]:
    """Rows whose invalid pixels have the farther of the nearest valid ones left and right."""
    columns = np.arange(band.shape[1])
    left = np.maximum.accumulate(np.where(valid, columns, -1), axis=1)
    right = np.where(valid, columns, band.shape[1])[:, ::-1]
    right = np.minimum.accumulate(right, axis=1)[:, ::-1]
    none = np.float32(-np.inf if farther is np.maximum else np.inf)  # nearer than all
    known = np.where(valid, band, none)
    padded = np.pad(known, ((0, 0), (0, 1)), constant_values=none)  # the columns −1 and W
    sides = [np.take_along_axis(padded, side, axis=1) for side in (left, right)]
    filled: NDArray[np.float32] = np.where(valid, band, farther(*sides))
    return filled

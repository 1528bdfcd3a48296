"""Parts of a picture, each with parameters of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

PART = 32  # px of a side of a part


def sums_of_parts(values: NDArray[Any], side: int = PART) -> NDArray[Any]:
    """Sums [h, w] over the parts of values [H, W]."""
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], side), axis=0)
    return np.add.reduceat(rows, np.arange(0, values.shape[1], side), axis=1)


def fitted_in_parts(
    columns: Sequence[NDArray[Any]],
    aim: NDArray[Any],
    chooses: NDArray[np.bool_],
    side: int = PART,
) -> NDArray[Any]:
    """The sum [h, w] of multiples of columns [h, w] that each part of a picture has for itself.

    The multiples are those of least squares at the pixels that choose, with a little of a ridge.
    """
    square = np.stack(
        [[sums_of_parts(one * other * chooses, side) for other in columns] for one in columns]
    )
    sums = np.stack([sums_of_parts(one * aim * chooses, side) for one in columns])
    square, sums = np.moveaxis(square, (0, 1), (-2, -1)), np.moveaxis(sums, 0, -1)
    scale = np.trace(square, axis1=-2, axis2=-1)
    ridge = (1e-3 * scale + 1e-3 * scale.mean() + 1e-30)[..., None, None]
    solved = np.linalg.solve(square + ridge * np.eye(len(columns)), sums[..., None])[..., 0]
    total = np.zeros_like(aim)
    height, width = aim.shape
    for k, column in enumerate(columns):
        each = np.repeat(np.repeat(solved[..., k], side, axis=0), side, axis=1)
        total += each[:height, :width] * column
    return total

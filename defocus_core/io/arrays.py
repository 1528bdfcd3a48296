"""Functions of arrays [H, W] of decoded pictures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

_GRID = 1 << 16  # approximate number of pixels in a sample of a picture
BAND = 1 << 20  # pixels of a band of rows


def computed(function: Callable[..., Any], *arrays: Any) -> Any:
    """The result of an elementwise function of arrays [H, W], computed in bands to save memory."""
    shape = arrays[0].shape
    parts = [function(*(array[rows] for array in arrays)) for rows in bands(shape)]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def times(array: NDArray[Any], factor: float) -> NDArray[Any]:
    """The product of an array and a factor, in the array's type; the array itself for factor 1."""
    return array if factor == 1 else array * array.dtype.type(factor)


def block_of(planes: Sequence[Any]) -> NDArray[Any]:
    """Arrays [H, W] joined to one [C, H, W].

    If all are consecutive views of such an array, it is returned itself, else a copy.
    """
    block = planes[0].base
    if isinstance(block, np.ndarray) and block.shape == (len(planes), *planes[0].shape):
        starts = [part.ctypes.data for part in block]
        if [plane.ctypes.data for plane in planes] == starts and block.dtype == planes[0].dtype:
            return block
    return np.stack(planes)


def bands(shape: Sequence[int]) -> list[slice]:
    """Slices of rows that together cover an array [H, W, …]."""
    height, width = shape[:2]
    count = max(1, BAND // max(1, width))
    return [slice(*pair) for pair in pairwise([*range(0, height, count), height])]


def count_of(mask: NDArray[np.bool_]) -> tuple[int, str]:
    """The number of True pixels in a mask [H, W], and the first of them as text "x,y" or ""."""
    count = int(np.count_nonzero(mask))
    y, x = np.unravel_index(int(mask.argmax()), mask.shape) if count else (0, 0)
    return count, f"{x},{y}" if count else ""


def sample_plane(plane: Any) -> Any:
    """About 65536 values of an array [H, W], evenly spaced, as an array [h, w]."""
    step = max(1, math.isqrt(plane.size // _GRID))
    return plane[::step, ::step]

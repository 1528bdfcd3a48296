"""Arrays [H, W] of decoded pictures, and functions of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

_GRID = 1 << 16  # pixels of a sample of a picture, about
BAND = 1 << 20  # pixels of a band of rows


class LazyArray:
    """An array that is computed where it is read: by slices, like one in memory.

    Attributes:
        shape: of the whole array.
        dtype: of the numbers.
        device: of tensors; None of NumPy's arrays.
    """

    def __init__(
        self, shape: Sequence[int], dtype: Any, read: Callable[[Any], Any], device: Any = None
    ) -> None:
        self.shape, self.dtype, self.device = tuple(shape), dtype, device
        self._read = read

    def __getitem__(self, window: Any) -> Any:
        return self._read(window)


def computed(function: Callable[..., Any], *arrays: Any, dtype: Any = None) -> LazyArray:
    """A function of the pixels of arrays [H, W]; of the type of the first if none is named."""
    first = arrays[0]
    dtype = first.dtype if dtype is None else dtype
    return LazyArray(first.shape, dtype, lambda window: function(*(a[window] for a in arrays)))


def times(array: Any, factor: float, offset: float = 0.0) -> Any:
    """An array [H, W] times a factor and then plus an offset, computed where it is read.

    The array itself if the factor is 1 and the offset 0.
    """
    if factor == 1 and offset == 0:
        return array
    factor, offset = array.dtype.type(factor), array.dtype.type(offset)
    return computed(lambda values: values * factor + offset if offset else values * factor, array)


def stacked(planes: Sequence[Any]) -> LazyArray:
    """C arrays [H, W] as one [H, W, C], read by slices of rows."""
    shape = (*planes[0].shape, len(planes))
    return LazyArray(
        shape, planes[0].dtype, lambda rows: np.stack([plane[rows] for plane in planes], axis=2)
    )


def bands(shape: Sequence[int], pixels: int = 0) -> list[slice]:
    """Bands of rows that together are an array [H, W, …]."""
    height, width = shape[:2]
    count = max(1, (pixels or BAND) // max(1, width))
    return [slice(*pair) for pair in pairwise([*range(0, height, count), height])]


def count_of(masks: Iterable[tuple[NDArray[np.bool_], int]]) -> tuple[int, str]:
    """Number of true pixels in bands [h, W], each with its first row, and the first as x,y."""
    count, first = 0, ""
    for band, top in masks:
        if not count and band.any():
            y, x = np.unravel_index(int(band.argmax()), band.shape)
            first = f"{x},{y + top}"
        count += int(np.count_nonzero(band))
    return count, first


def sample_plane(plane: Any) -> Any:
    """About `_GRID` values of an array [H, W], evenly spread."""
    height, width = plane.shape
    step = max(1, math.isqrt(height * width // _GRID))
    rows = [np.asarray(plane[row : row + 1])[:, ::step] for row in range(0, height, step)]
    return np.concatenate(rows)

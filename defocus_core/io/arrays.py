"""Arrays [H, W] in memory or, where they would not fit, in a scratch file.

A scratch file has no name, so that nothing of it stays however the process ends. It is mapped, and
only a band of the window that is read or written is in memory: mapped pages count as memory of the
process, which ‹memory› limits, until they are given back.
"""

from __future__ import annotations

import math
import mmap
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, reason

_GRID = 1 << 16  # pixels of a sample of a picture, about
BAND = 1 << 20  # pixels of a band of rows
_LASTING = Path("/var/tmp")


class Scratch:
    """An array [H, W] in a file without a name, read and filled by slices like one in memory.

    Attributes:
        shape: (height, width).
        dtype: of the numbers.
    """

    def __init__(self, shape: tuple[int, int], dtype: Any) -> None:
        self.shape, self.dtype = shape, np.dtype(dtype)
        size, folder = math.prod(shape) * self.dtype.itemsize, scratch_folder()
        try:
            with tempfile.TemporaryFile(dir=folder, buffering=0) as file:
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(file.fileno(), 0, size)
                else:  # a hole that finds no room when it is filled would end the process
                    for start in range(0, size, BAND):
                        file.write(bytes(min(BAND, size - start)))
                self._mapped = np.memmap(file, self.dtype, "r+", shape=shape)
                self._pages: Any = self._mapped.base
        except OSError as error:
            problem = f"has no room for {size / 10**6:.3g} MB of scratch: {reason(error)}"
            remedy = "free some, let TMPDIR name another directory, or allow more ‹memory›"
            raise InputError("no-space", problem, remedy, path=folder) from None

    def __getitem__(self, window: Any) -> NDArray[Any]:
        mapped = self._mapped[window]
        values = np.empty(mapped.shape, self.dtype)
        for rows in self._bands(mapped):
            values[rows] = mapped[rows]
        return values

    def __setitem__(self, window: Any, values: NDArray[Any]) -> None:
        mapped = self._mapped[window]
        values = np.broadcast_to(values, mapped.shape)
        for rows in self._bands(mapped):
            mapped[rows] = values[rows]

    def _bands(self, mapped: NDArray[Any]) -> Iterator[slice]:
        """Rows of a part of the file; the pages of each band are given back after it was used."""
        height, width = mapped.shape
        for rows in bands((height, self.shape[1])) if width else ():
            yield rows
            self._pages.madvise(mmap.MADV_DONTNEED)


@dataclass(frozen=True)
class Keeping:
    """Where the arrays of a picture are kept."""

    scratch: bool = False
    strip_bytes: int = 1 << 23  # of pixels that are decoded at once

    def new(self, shape: tuple[int, int], dtype: Any) -> Any:
        """An array [H, W] of zeros."""
        return Scratch(shape, dtype) if self.scratch else np.zeros(shape, dtype)


IN_MEMORY = Keeping()


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


def scratch_folder() -> Path:
    """Where scratch files lie: $TMPDIR, or else /var/tmp."""
    if not os.environ.get("TMPDIR") and os.access(_LASTING, os.W_OK):
        return _LASTING
    return Path(tempfile.gettempdir())


def sample_plane(plane: Any) -> Any:
    """About `_GRID` values of an array [H, W], evenly spread."""
    height, width = plane.shape
    step = max(1, math.isqrt(height * width // _GRID))
    rows = [np.asarray(plane[row : row + 1])[:, ::step] for row in range(0, height, step)]
    return np.concatenate(rows)

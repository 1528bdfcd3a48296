"""The numbers of a depth file as they stand in it, and the type of the file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.arrays import Keeping, bands

# Alpha of an edge whose numbers tell if they were multiplied, and of the whole pixel beside it.
_EDGE, _WHOLE = (0.05, 0.9), 0.995
# Edge pixels that are enough to judge by, and the share of them that must look multiplied.
_ENOUGH, _MAXIMUM = 12, 0.8


@dataclass(frozen=True)
class DepthNumbers:
    """The numbers of a depth file."""

    # [H, W], or [H, W, C] of pixels that are bits; of the type they have in the file, an array
    # or something else that rows can be cut from
    values: Any
    type: str  # of the file and its numbers, as the rows of the table have it
    words: str  # type of the file and of its numbers, for people
    channel: str = ""  # name in the file; empty where it has none
    metadata: Mapping[str, Any] = field(default_factory=dict)  # of the file, by key
    # Pixels of an alpha of 0, where that means sky, [H, W]
    nothing: NDArray[np.bool_] | None = None
    # Pixels without depth by another array of the file, [H, W]
    holes: NDArray[np.bool_] | None = None
    # Rows and columns that the file has; the others have no depth. None of all
    within: tuple[slice, slice] | None = None
    data_window: str = ""  # its data window in words, if it does not cover the picture

    @property
    def width(self) -> int:
        """Of the map in px."""
        return int(self.values.shape[1])

    @property
    def top(self) -> float:
        """The greatest number of the type: 255, 65535, …; 1 of floats."""
        dtype = np.dtype(self.values.dtype)
        return 1.0 if dtype.kind == "f" else float(np.iinfo(dtype).max)

    @property
    def is_integer(self) -> bool:
        """Whether the numbers are integers."""
        return self.values.dtype.kind in "iu"


def divided(path: Path, values: Any, alpha: Any, how: str, keeping: Keeping) -> tuple[Any, str]:
    """The numbers of a depth file without the alpha in them, and what was done, in words.

    `values`: its numbers [H, W]; `alpha`: [H, W] of the colour; None if it has none.
    """
    usable = alpha is not None and tuple(alpha.shape) == tuple(values.shape[:2])
    if how == "on" and not usable:
        problem = "cannot be divided by alpha: the colour has no alpha of its size"
        raise InputError("no-such-channel", problem, "leave ‹unpremultiply-depth› out", path=path)
    if not usable or how == "off" or (how == "auto" and not _is_multiplied(values, alpha)):
        return values, ""
    result = keeping.new(tuple(values.shape), np.float32)
    for rows in bands(values.shape):
        fraction = np.asarray(alpha[rows], np.float32)
        numbers = np.asarray(values[rows], np.float32)
        result[rows] = np.divide(numbers, fraction, out=numbers.copy(), where=fraction > 0)
    return result, "divided by alpha"


def _is_multiplied(values: Any, alpha: Any) -> bool:
    """Whether edges have the depth beside them times alpha, and not the depth itself."""
    multiplied = plain = 0
    for fraction, numbers in _overlapping(alpha, values):
        edge = (fraction > _EDGE[0]) & (fraction < _EDGE[1])
        if not edge.any():
            continue
        whole = (fraction >= _WHOLE) & np.isfinite(numbers) & (numbers > 0)
        for step in (1, 2):
            for axis in (0, 1):
                for away in (-step, step):
                    at = edge & np.roll(whole, away, axis)
                    beside, own = np.roll(numbers, away, axis)[at], numbers[at]
                    times = fraction[at] * beside
                    nearer = np.abs(own - times) < np.abs(own - beside)
                    multiplied += int(np.count_nonzero(nearer & (own > 0)))
                    plain += int(np.count_nonzero(~nearer & (own > 0)))
    return multiplied >= _ENOUGH and multiplied > _MAXIMUM * (multiplied + plain)


def _overlapping(*arrays: Any) -> Iterator[list[NDArray[np.float32]]]:
    """Bands of arrays [H, W], each with two rows of the next."""
    for rows in bands(arrays[0].shape):
        wide = slice(rows.start, rows.stop + 2)
        yield [np.asarray(array[wide], np.float32) for array in arrays]

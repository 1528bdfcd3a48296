"""The pixels of two pictures that are compared, and their differences.

What looks at all pixels goes strip by strip: a strip stays in the cache, and a whole plane of
differences does not. Differences are float32 and their sums float64.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.picture import color_layers, is_map

_STRIP = 2**17  # pixels of a channel that are looked at together
_LARGEST = 1e18  # value whose square float32 holds


@cache
def halves() -> NDArray[np.float32]:
    """All numbers of 16 bits, by their code."""
    return np.arange(2**16, dtype=np.uint16).view(np.float16).astype(np.float32)


@dataclass(frozen=True)
class Differences:
    """The differences of a pair in numbers."""

    greatest: NDArray[Any]  # the greatest absolute difference of the channels of each pixel, [H, W]
    largest: dict[str, float]  # the greatest absolute difference of each channel
    magnitude: float  # the sum of all absolute differences
    squares: float  # the sum of all squared differences
    level: float  # the sum of the absolute values of A, where differences count


@dataclass(frozen=True)
class Pixels:
    """The common channels of a pair, in the same units."""

    names: tuple[str, ...]
    a: tuple[NDArray[Any], ...]  # [H, W] of each channel of A, any type
    b: tuple[NDArray[Any], ...]  # the same of B
    # Exponent of the power law that decodes the colour, 1 for linear, None for sRGB
    gamma: float | None
    selected: NDArray[np.bool_] | None = None  # pixels that are compared, [H, W]; None for all

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        height, width = self.a[0].shape
        return height, width

    @cached_property
    def ranges(self) -> tuple[dict[str, tuple[float, float]], dict[str, tuple[float, float]]]:
        """The least and the greatest value of each channel of A and of B; NaN where one is NaN."""
        a, b = (dict(zip(self.names, map(_range, side), strict=True)) for side in (self.a, self.b))
        return a, b

    @cached_property
    def finite(self) -> NDArray[np.bool_] | None:
        """Selected pixels that are finite in all channels of A and B, [H, W]; None for all."""
        finite = None if self.selected is None else self.selected.copy()
        for side, planes in zip(self.ranges, (self.a, self.b), strict=True):
            for name, plane in zip(self.names, planes, strict=True):
                if not all(map(math.isfinite, side[name])):
                    ok = np.isfinite(plane)
                    finite = ok if finite is None else finite & ok
        return finite

    def strips(self) -> Iterator[slice]:
        """Rows of the picture that are looked at together."""
        height, width = self.shape
        step = max(1, _STRIP // width)
        return (slice(top, min(top + step, height)) for top in range(0, height, step))

    def difference(self, name: str, *cut: slice) -> NDArray[Any]:
        """B − A of a channel within rows and columns; 0 where not compared or not finite."""
        a, b = self.plane("a", name), self.plane("b", name)
        with np.errstate(invalid="ignore"):
            values: NDArray[Any] = np.subtract(b[cut], a[cut], dtype=self._type)
        if self.finite is not None:
            values[~self.finite[cut]] = 0.0
        return values

    @cached_property
    def _type(self) -> Any:
        """The number type of differences."""
        ends = [end for side in self.ranges for both in side.values() for end in both]
        kinds = {plane.dtype.name for plane in (*self.a, *self.b)}
        narrow = kinds <= {"float16", "float32", "uint8", "uint16"}
        large = any(abs(end) > _LARGEST for end in ends)
        return np.float32 if narrow and not large else np.float64

    @cached_property
    def differences(self) -> Differences:
        """The differences in numbers, of one pass over all pixels."""
        greatest = np.zeros(self.shape, self._type)
        largest = dict.fromkeys(self.names, 0.0)
        magnitude = squares = level = 0.0
        same = all(a is b for a, b in zip(self.a, self.b, strict=True))
        for rows in () if same else self.strips():
            ok = None if self.finite is None else self.finite[rows]
            for name, *sides in zip(self.names, self.a, self.b, strict=True):
                a, b = (self._numbers(side[rows]) for side in sides)
                level += float(np.abs(a if ok is None else a[ok]).sum(dtype=np.float64))
                values = np.abs(b - a)
                if ok is not None:
                    values[~ok] = 0.0
                largest[name] = max(largest[name], float(values.max()))
                np.maximum(greatest[rows], values, out=greatest[rows])
                magnitude += float(values.sum(dtype=np.float64))
                squares += float(np.square(values, out=values).sum(dtype=np.float64))
        return Differences(greatest, largest, magnitude, squares, level)

    def _numbers(self, plane: NDArray[Any]) -> NDArray[Any]:
        """Values in the number type of differences."""
        if plane.dtype == np.float16:  # a look-up is three times as fast as a conversion
            plane = halves().take(plane.view(np.uint16))
        return np.asarray(plane, self._type)

    @property
    def greatest(self) -> NDArray[Any]:
        """The greatest absolute difference of the channels of each pixel, [H, W]."""
        return self.differences.greatest

    @property
    def differ(self) -> bool:
        """Whether a value differs."""
        return any(self.differences.largest.values())

    @property
    def color(self) -> tuple[tuple[str, ...], ...]:
        """The channels of each colour layer."""
        return () if is_map(self.names) else tuple(color_layers(self.names))

    def plane(self, side: str, name: str) -> NDArray[Any]:
        """A channel of side ``a`` or ``b``."""
        planes: tuple[NDArray[Any], ...] = getattr(self, side)
        return planes[self.names.index(name)]

    def within(self, selected: NDArray[np.bool_]) -> Pixels:
        """The pair with the selected pixels alone."""
        both = selected if self.selected is None else selected & self.selected
        return replace(self, selected=both)


def _range(plane: NDArray[Any]) -> tuple[float, float]:
    """The least and the greatest value of a plane, NaN if one is NaN."""
    if plane.dtype != np.float16:
        return float(plane.min()), float(plane.max())
    # Codes of 16 bits are compared much faster than numbers. As integers with a sign, those of
    # positive numbers come last; as integers without one, those of negative numbers, in reverse.
    signed, unsigned = plane.view(np.int16), plane.view(np.uint16)
    high = signed.max() if signed.max() >= 0 else unsigned.min()
    low = unsigned.max() if unsigned.max() >= 2**15 else unsigned.min()
    least, greatest = np.array([low, high]).astype(np.uint16).view(np.float16)
    return float(least), float(greatest)

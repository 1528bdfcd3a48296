"""The compared pixels of two pictures, and their differences.

Passes over all pixels go strip by strip: a strip stays in the cache, a whole plane does not.
Differences are float32 and their sums float64.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.table import Finding
from defocus_core.compare.picture import color_layers, is_map
from defocus_core.system.text import counted

_KINDS = {"nan": "NaN", "inf": "Inf"}
_STRIP = 2**17  # pixels of a channel in a strip
_LARGEST = 1e18  # greatest value with a finite square in float32
# The step of number types: by the power of 2 below a value, and the least.
_HALF = (2.0**-10, 2.0**-24)
_STEPS = {
    **{"half": _HALF, "float16": _HALF, "bfloat16": (2.0**-7, 0.0)},
    # tolerance in steps, as sums are rounded more than once
    **dict.fromkeys(("float", "float32"), (2.0**-20, 0.0)),
    **{"uint8": (0.0, 1 / 255), "uint16": (0.0, 1 / 65535)},
}


@cache
def halves() -> NDArray[np.float32]:
    """All 65536 half floats; the index is the bit pattern of the number."""
    return np.arange(2**16, dtype=np.uint16).view(np.float16).astype(np.float32)


@dataclass(frozen=True)
class Differences:
    """The differences of a pair in numbers."""

    greatest: NDArray[Any]  # the greatest absolute difference of the channels of each pixel, [H, W]
    largest: dict[str, float]  # the greatest absolute difference of each channel
    magnitude: float  # the sum of all absolute differences
    squares: dict[str, float]  # the sum of the squared differences of each channel
    level: float  # the sum of the absolute values of A, where differences count


@dataclass(frozen=True)
class Pixels:
    """The common channels of a pair, in the same units."""

    names: tuple[str, ...]
    a: tuple[NDArray[Any], ...]  # [H, W] of each channel of A, any type
    b: tuple[NDArray[Any], ...]  # the channels of B
    # Exponent of the power law that decodes the colour, 1 for linear, None for sRGB
    gamma: float | None
    selected: NDArray[np.bool_] | None = None  # compared pixels, [H, W]; None for all

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
        """Mask [H, W] of selected pixels that are finite in all channels of both; None for all."""
        finite = None if self.selected is None else self.selected.copy()
        for side, planes in zip(self.ranges, (self.a, self.b), strict=True):
            for name, plane in zip(self.names, planes, strict=True):
                if not all(map(math.isfinite, side[name])):
                    ok = np.isfinite(plane)
                    finite = ok if finite is None else finite & ok
        return finite

    def strips(self) -> Iterator[slice]:
        """The rows of each strip."""
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
        """The differences in numbers, from one pass over all pixels."""
        greatest = np.zeros(self.shape, self._type)
        largest = dict.fromkeys(self.names, 0.0)
        squares, magnitude, level = dict.fromkeys(self.names, 0.0), 0.0, 0.0
        same = all(  # comparing integers is faster
            a.dtype == b.dtype
            and np.array_equal(a.view(f"u{a.itemsize}"), b.view(f"u{a.itemsize}"))
            for a, b in zip(self.a, self.b, strict=True)
        )
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
                squares[name] += float(np.square(values, out=values).sum(dtype=np.float64))
        return Differences(greatest, largest, magnitude, squares, level)

    def _numbers(self, plane: NDArray[Any]) -> NDArray[Any]:
        """Values in the number type of differences."""
        if plane.dtype == np.float16:  # a look-up is three times as fast as a conversion
            plane = halves().take(plane.view(np.uint16))
        return np.asarray(plane, self._type)

    @property
    def greatest(self) -> NDArray[Any]:
        """The greatest absolute difference of any channel at each pixel, [H, W]."""
        return self.differences.greatest

    @property
    def color(self) -> tuple[tuple[str, ...], ...]:
        """The channels of each colour layer."""
        return () if is_map(self.names) else tuple(color_layers(self.names))

    def plane(self, side: str, name: str) -> NDArray[Any]:
        """A channel of side ``a`` or ``b``."""
        return (self.a if side == "a" else self.b)[self.names.index(name)]

    def visible(self) -> tuple[Pixels, int]:
        """The pair, with the colours of A in B where both have alpha 0.

        Returns the number of pixels that this changes, too.
        """
        planes, unseen = dict(zip(self.names, self.b, strict=True)), np.zeros(self.shape, bool)
        for layer in self.color:
            alpha = f"{layer[0][:-1]}A"
            if alpha not in self.names:
                continue
            clear = (self.plane("a", alpha) == 0) & (self.plane("b", alpha) == 0)
            for name in layer if clear.any() else ():
                was, now = self.plane("a", name), self.plane("b", name)
                other = clear & (was != now) & np.isfinite(was) & np.isfinite(now)
                planes[name], unseen = np.where(other, was, now), unseen | other
        if not unseen.any():
            return self, 0
        return replace(self, b=tuple(planes.values())), int(np.count_nonzero(unseen))

    def beyond_a_step(self, types: Mapping[str, Collection[str]]) -> Pixels:
        """The pair, with the values of A in B where they differ by at most a step of their type.

        `types`: number types of each channel in the files. Another processor may round to the next
        step.
        """
        planes = []
        for name, a, b in zip(self.names, self.a, self.b, strict=True):
            steps = [_STEPS[kind] for kind in types[name] if kind in _STEPS]
            if not steps or np.array_equal(a, b):
                planes.append(b)
                continue
            share, least = (max(values) for values in zip(*steps, strict=True))
            level = np.maximum(np.abs(a), np.abs(b)).astype("f4")
            step = np.maximum(share * 2.0 ** np.floor(np.log2(level)), least)
            planes.append(np.where(np.abs(np.subtract(a, b, dtype="f4")) <= 1.01 * step, a, b))
        return replace(self, b=tuple(planes))


def _range(plane: NDArray[Any]) -> tuple[float, float]:
    """The least and the greatest value of a plane, NaN if one is NaN."""
    if plane.dtype == np.float16:  # numbers of 16 bits are compared slowly
        plane = plane.astype(np.float32)
    return float(plane.min()), float(plane.max())


@dataclass(frozen=True)
class Nonfinite:
    """Pixels that are not finite."""

    # counts by side and kind: ``a`` and ``b``, ``nan`` and ``inf``
    counts: Mapping[str, Mapping[str, int]]
    findings: Sequence[Finding] = ()  # of each kind that one side has where the other has not
    # Where a channel is NaN or infinite on one side and another value on the other, [H, W];
    # None if nowhere
    apart: Any = field(default=None, compare=False)

    def notes(self) -> list[str]:
        """Notes on the pixels that are not finite in both A and B."""
        both = {k: min(self.counts[side][k] for side in "ab") for k in _KINDS}
        return [f"{_KINDS[k]} in {counted(n, 'pixel')} of both" for k, n in both.items() if n]


def count_nonfinite(pixels: Pixels, corner: tuple[int, int] = (0, 0)) -> Nonfinite:
    """Count and compare the pixels of a pair that are not finite."""
    counts = {side: dict.fromkeys(_KINDS, 0) for side in "ab"}
    selected = np.bool_(True) if pixels.selected is None else pixels.selected
    if pixels.finite is None or np.array_equal(pixels.finite, selected):
        return Nonfinite(counts)
    codes = {side: [_codes(plane) for plane in getattr(pixels, side)] for side in "ba"}
    differ = [one != other for one, other in zip(*codes.values(), strict=True)]
    apart, findings = np.logical_or.reduce(differ) & selected, []
    for (side, of_side), (code, (kind, word)) in product(
        codes.items(), enumerate(_KINDS.items(), 1)
    ):
        has = [np.abs(each) == code for each in of_side]
        counts[side][kind] = int(np.count_nonzero(np.logical_or.reduce(has) & selected))
        alone = [each & other for each, other in zip(has, differ, strict=True)]
        where = np.argwhere(np.logical_or.reduce(alone) & selected)
        if len(where):
            x, y = int(where[0, 1]) + corner[0], int(where[0, 0]) + corner[1]
            of = "" if side == "b" else " of A alone"
            text = f"{word} in {counted(len(where), 'pixel')}{of}, the first at {x},{y}"
            values = {"pixels": len(where), "first": [x, y], "side": side}
            findings.append(Finding(word, text, values))
    return Nonfinite(counts, findings, apart if apart.any() else None)


def _codes(plane: NDArray[Any]) -> NDArray[np.int8]:
    """0 for a finite value, 1 for NaN, 2 for +inf and −2 for −inf."""
    codes: NDArray[np.int8] = np.isnan(plane).astype(np.int8)
    codes[np.isposinf(plane)], codes[np.isneginf(plane)] = 2, -2
    return codes

"""Sampled pixels of a pair, against which explanations of a difference are tried.

An explanation predicts B from A. Its residual is measured in arsinh of the values, so that a few
highlights do not decide. Where pictures are large, half of the samples are pixels that differ and
half are spread over the picture.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.finding import Finding
from defocus_core.compare.pixels import Pixels

_SAMPLES = 60_000
_LARGEST = 1e30  # value that is looked at: beyond it, arithmetic in float32 overflows
# Largest share of a difference that an explanation may leave.
LEFT = 0.1
# RMS of what number types round off: of 0…1 for integers, as a share of the level for others.
_STEPS = {"uint8": 0.35 / 255, "uint16": 0.35 / 65535}
_RELATIVE_STEPS = {"half": 4e-4, "float": 1e-6}


@dataclass(frozen=True)
class Explanation:
    """A finding, and which share of the difference it leaves unexplained."""

    finding: Finding
    left: float


class Evidence:
    """A pair as explanations see it.

    Attributes:
        names: of the channels that differ.
        a: their values [C, H, W] in A, float32, 0 where a pixel is not finite.
        b: the same of B.
        gamma: as of `Pixels`.
        types: number types of B.
    """

    def __init__(self, pixels: Pixels, types: Mapping[str, str]) -> None:
        differ = [bool(difference.any()) for difference in pixels.differences]
        self.pixels = pixels
        self.names = tuple(n for n, d in zip(pixels.names, differ, strict=True) if d)
        self.gamma = pixels.gamma
        self.types = {types[name] for name in self.names}
        self.a, self.b = (
            np.stack([self._filled(pixels.plane(side, name)) for name in self.names])
            for side in ("a", "b")
        )

    def _filled(self, plane: NDArray[Any]) -> NDArray[np.float32]:
        values: NDArray[np.float32] = np.clip(plane, -_LARGEST, _LARGEST).astype(np.float32)
        return values if self.pixels.finite is None else np.nan_to_num(values)

    @property
    def size(self) -> tuple[int, int]:
        """(height, width)."""
        return self.pixels.shape

    @cached_property
    def places(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns of the sampled pixels."""
        finite = self.pixels.finite
        every = np.arange(self.pixels.greatest.size) if finite is None else np.flatnonzero(finite)
        if every.size > _SAMPLES:
            differing = np.flatnonzero(self.pixels.greatest)
            generator = np.random.default_rng(0)
            half = min(_SAMPLES // 2, differing.size)
            chosen = differing[generator.integers(0, differing.size, half)]
            spread = every[generator.integers(0, every.size, _SAMPLES - half)]
            every = np.concatenate([chosen, spread])
        rows, columns = np.unravel_index(every, self.size)
        return rows, columns

    @cached_property
    def sampled(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Values of A and of B [C, N] at the sampled pixels."""
        rows, columns = self.places
        return self.a[:, rows, columns], self.b[:, rows, columns]

    @cached_property
    def step(self) -> float:
        """What the number type of B may round off, in arsinh of the values."""
        level = float(np.sqrt(np.square(compressed(self.sampled[1])).mean()))
        steps = [_STEPS.get(kind, _RELATIVE_STEPS.get(kind, 1e-6) * level) for kind in self.types]
        return max(steps, default=0.0)

    def left(
        self,
        predicted: NDArray[np.float32],
        where: NDArray[np.bool_] | None = None,
    ) -> float:
        """Share of the difference that is left if B were as predicted.

        Args:
            predicted: [C, N] at the sampled pixels.
            where: samples [N] or [C, N] at which there is a prediction; None for all.

        Returns:
            0 if all is explained up to the step of the number type, 1 or more if nothing.
        """
        a, b = self.sampled
        if where is not None:
            if np.count_nonzero(where) < max(16, where.size // 4):
                return math.inf
            where = np.broadcast_to(where, a.shape)
            predicted, a, b = predicted[where], a[where], b[where]
        aim = compressed(b)
        whole = _rms(compressed(a) - aim)
        rest = _rms(compressed(predicted) - aim)
        if rest == 0.0:
            return 0.0
        if whole < 2.5 * self.step:  # rounding alone would explain much of it
            return math.inf
        return max(rest - self.step, 0.0) / whole

    def gathered(
        self, planes: NDArray[np.float32], rows: Any, columns: Any
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Values [C, N] of planes at some places, and which of them are within the picture."""
        height, width = planes.shape[1:]
        within = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        return planes[:, rows.clip(0, height - 1), columns.clip(0, width - 1)], within


def compressed(values: NDArray[Any]) -> NDArray[Any]:
    """Values on a scale that is linear near 0 and logarithmic for highlights."""
    compressed_values: NDArray[Any] = np.arcsinh(values)
    return compressed_values


def best(explanations: Sequence[Explanation], most: float = LEFT) -> Explanation | None:
    """The explanation that leaves least, the first of equals; None if all leave too much."""
    good = [each for each in explanations if each.left <= most]
    return min(good, key=lambda each: round(each.left, 2)) if good else None


def _rms(values: NDArray[Any]) -> float:
    return math.sqrt(float(np.square(values, dtype=np.float64).mean())) if values.size else 0.0

"""The pixels of two pictures that are compared, and their differences."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.picture import color_layers, is_map


@dataclass(frozen=True)
class Pixels:
    """The common channels of a pair, in the same units.

    Attributes:
        names: of the channels.
        a: [H, W] of each channel of A, any type.
        b: the same of B.
        gamma: exponent of the power law that decodes the colour, 1 for linear, None for sRGB.
        selected: pixels that are compared, [H, W]; None for all.
    """

    names: tuple[str, ...]
    a: tuple[NDArray[Any], ...]
    b: tuple[NDArray[Any], ...]
    gamma: float | None
    selected: NDArray[np.bool_] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        height, width = self.a[0].shape
        return height, width

    @cached_property
    def finite(self) -> NDArray[np.bool_] | None:
        """Selected pixels that are finite in all channels of A and B, [H, W]; None for all."""
        finite = None if self.selected is None else self.selected.copy()
        for plane in (*self.a, *self.b):
            if plane.dtype.kind == "f" and not math.isfinite(float(plane.sum(dtype=np.float64))):
                ok = np.isfinite(plane)
                finite = ok if finite is None else finite & ok
        return finite

    @cached_property
    def differences(self) -> tuple[NDArray[np.float64], ...]:
        """B − A of each channel [H, W]; 0 where not compared or not finite."""
        differences = []
        with np.errstate(invalid="ignore"):
            for a, b in zip(self.a, self.b, strict=True):
                difference = np.subtract(b, a, dtype=np.float64)
                if self.finite is not None:
                    difference[~self.finite] = 0.0
                differences.append(difference)
        return tuple(differences)

    @cached_property
    def greatest(self) -> NDArray[np.float64]:
        """The greatest absolute difference of the channels of each pixel, [H, W]."""
        greatest = np.abs(self.differences[0])
        for difference in self.differences[1:]:
            np.maximum(greatest, np.abs(difference), out=greatest)
        return greatest

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

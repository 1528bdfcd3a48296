"""Highlights that were cut off, which no screen shows and no rule on a screen's values notices."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from defocus_core.compare.findings.finding import Finding

if TYPE_CHECKING:
    from defocus_core.compare.pixels import Pixels

_SAME = 2e-3  # greatest relative difference from the limit
_CUT = 0.95  # least share of the pixels beyond the limit that are at it
_MORE = 1.05  # what was cut off is brighter than the limit by this


def clipped(pixels: Pixels) -> list[Finding]:
    """The limit that the light of B was clipped at, if it was; looked for in every pair."""
    tops = {}
    for layer in pixels.color:
        sides = [[pixels.plane(side, name) for name in layer] for side in ("a", "b")]
        high, maximum = (max(_greatest(plane) for plane in planes) for planes in sides)
        tops[layer] = (high, maximum)
    found = []
    for layer, (high, limit) in tops.items():
        if not (math.isfinite(high) and high > _MORE * limit > 0):
            continue
        beyond, cut, between = 0, 0, 0
        for name in layer:
            a, b = pixels.plane("a", name), pixels.plane("b", name)
            over = a > (1 + _SAME) * limit
            old, new = a[over].astype(np.float64), b[over].astype(np.float64)
            at_limit = np.abs(new - limit) <= _SAME * limit
            beyond += new.size
            cut += int(np.count_nonzero(at_limit))
            between += int(np.count_nonzero(at_limit & (old < 0.98 * high)))
        plain = abs(limit - 1.0) <= _SAME
        if beyond and cut >= _CUT * beyond and (plain or between >= 3):
            name = f"clipped at {limit:.4g}"
            found.append(Finding(name, name, {"limit": limit, "values": beyond}))
    return found[:1]


def has_negatives(pixels: Pixels) -> bool:
    """Whether a number of A is below 0, which B may have cut off; so may −0 be, and NaN."""
    return any(bool(np.signbit(plane).any()) for plane in pixels.a)


def _greatest(plane: object) -> float:
    """The greatest number of a plane, NaN aside; by their codes, those of 16 bits are fast."""
    values = np.asarray(plane)
    if values.dtype == np.float16:
        codes = np.ascontiguousarray(values).view(np.int16)
        codes = codes[codes <= 0x7C00] if (codes > 0x7C00).any() else codes
        return float(codes.max(initial=0).view(np.float16)) if codes.size else 0.0
    return float(np.nanmax(values)) if values.size else 0.0

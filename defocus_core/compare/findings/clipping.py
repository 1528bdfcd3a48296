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
    found = []
    for layer in pixels.color:
        high, limit = (max(_high(pixels, side, name) for name in layer) for side in "ab")
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


def may_be_cut_below(pixels: Pixels) -> bool:
    """Whether numbers of A below 0 are no longer there in B."""
    ends = [(pixels.ranges[0][name][0], pixels.ranges[1][name][0]) for name in pixels.names]
    return any(old < new <= 0 or math.isnan(old + new) for old, new in ends)


def _high(pixels: Pixels, side: str, name: str) -> float:
    """The greatest number of a channel, NaN aside."""
    high = pixels.ranges["ab".index(side)][name][1]
    return float(np.nanmax(pixels.plane(side, name))) if math.isnan(high) else high

"""NaN and infinite pixels of a pair: how many, where, and whether both sides have the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.finding import Finding
from defocus_core.compare.pixels import Pixels
from defocus_core.system.text import counted


@dataclass(frozen=True)
class Nonfinite:
    """Pixels that are not finite."""

    # Pixels by side and kind: ``a`` and ``b``, ``nan`` and ``inf``
    counts: Mapping[str, Mapping[str, int]]
    # Pixels of each kind that one side has and the other has not, by side and kind, with column
    # and row of the first
    lone: Mapping[tuple[str, str], tuple[int, int, int]] = field(default_factory=dict)
    # Where a channel is NaN or infinite on one side and another value on the other, [H, W];
    # None if nowhere
    apart: Any = field(default=None, compare=False)

    def findings(self) -> list[Finding]:
        """A finding for each kind that one side has alone."""
        findings = []
        for (side, kind), (count, x, y) in self.lone.items():
            word = {"nan": "NaN", "inf": "Inf"}[kind]
            alone = "" if side == "b" else " of A alone"
            text = f"{word} in {counted(count, 'pixel')}{alone}, the first at {x},{y}"
            values = {"pixels": count, "first": [x, y], "side": side}
            findings.append(Finding(word, text, values))
        return findings

    def notes(self) -> list[str]:
        """What both sides have, in words."""
        both = {
            kind: min(self.counts[side][kind] for side in ("a", "b")) for kind in ("nan", "inf")
        }
        words = {"nan": "NaN", "inf": "Inf"}
        return [f"{words[kind]} in {counted(n, 'pixel')} of both" for kind, n in both.items() if n]


def count_nonfinite(pixels: Pixels, corner: tuple[int, int] = (0, 0)) -> Nonfinite:
    """Count and compare the pixels of a pair that are not finite."""
    blank = {side: {"nan": 0, "inf": 0} for side in ("a", "b")}
    if pixels.finite is None or (
        pixels.selected is not None and np.array_equal(pixels.finite, pixels.selected)
    ):
        return Nonfinite(blank)
    selected = True if pixels.selected is None else pixels.selected
    masks = {
        (side, kind): np.logical_or.reduce([test(plane) for plane in getattr(pixels, side)])
        & selected
        for side in ("a", "b")
        for kind, test in (("nan", np.isnan), ("inf", np.isinf))
    }
    apart = np.zeros(pixels.shape, bool)
    lone_masks = {key: np.zeros(pixels.shape, bool) for key in masks}
    for a, b in zip(pixels.a, pixels.b, strict=True):
        codes = [_codes(plane) for plane in (a, b)]
        differs = (codes[0] != codes[1]) & selected
        apart |= differs
        for side, side_codes in zip(("a", "b"), codes, strict=True):
            lone_masks[side, "nan"] |= differs & (side_codes == _NAN)
            lone_masks[side, "inf"] |= differs & (np.abs(side_codes) == 1)
    lone = {}
    for key in (("b", "nan"), ("b", "inf"), ("a", "nan"), ("a", "inf")):
        if lone_masks[key].any():
            y, x = (int(index) for index in np.argwhere(lone_masks[key])[0])
            count = int(np.count_nonzero(lone_masks[key]))
            lone[key] = (count, x + corner[0], y + corner[1])
    return Nonfinite(
        {
            side: {kind: int(np.count_nonzero(masks[side, kind])) for kind in ("nan", "inf")}
            for side in ("a", "b")
        },
        lone,
        apart if apart.any() else None,
    )


_NAN = 2


def _codes(plane: NDArray[Any]) -> NDArray[np.int8]:
    """0 for a finite value, 1 and −1 for the infinities, 2 for NaN."""
    codes = np.zeros(plane.shape, np.int8)
    if plane.dtype.kind == "f":
        codes[np.isposinf(plane)] = 1
        codes[np.isneginf(plane)] = -1
        codes[np.isnan(plane)] = _NAN
    return codes

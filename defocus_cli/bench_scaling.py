"""How times grow: exponents of pixels, of the radius and of the number of slices.

An exponent is the slope of log(seconds) over the logarithm of one quantity, while all else of a
case stays as it is: each group of such cases has an intercept of its own, all share the slope.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from statistics import fmean
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from defocus_cli.bench_time import Timing

QUANTITIES = ("pixels", "radius", "slices")


def exponents(timings: Sequence[Timing]) -> list[dict[str, Any]]:
    """For each kind of scene the three exponents; None where too little was varied."""
    return [
        {"kind": kind, **{name: _exponent(own, name) for name in QUANTITIES}}
        for kind in dict.fromkeys(timing.case.kind for timing in timings)
        for own in [[timing for timing in timings if timing.case.kind == kind]]
    ]


def _exponent(timings: Sequence[Timing], quantity: str) -> float | None:
    """The common slope of all groups in which only the quantity differs."""
    value, key = _VARIED[quantity]
    groups: dict[Hashable, list[tuple[float, float]]] = {}
    for timing in timings:
        if value(timing) > 0:
            point = (math.log(value(timing)), math.log(timing.seconds))
            groups.setdefault(key(timing), []).append(point)
    above = below = 0.0
    for points in groups.values():
        x0, y0 = (fmean(axis) for axis in zip(*points, strict=True))
        above += sum((x - x0) * (y - y0) for x, y in points)
        below += sum((x - x0) ** 2 for x, y in points)
    return above / below if below > 0 else None


def _all_but_the_radius(timing: Timing) -> Hashable:
    case = timing.case
    return case.size, case.quality, case.outputs


def _all_but_the_size(timing: Timing) -> Hashable:
    case = timing.case
    return case.radius, case.quality, case.outputs


# What is varied, and what is kept. The number of slices is varied by the radius.
_VARIED: dict[str, tuple[Callable[[Timing], float], Callable[[Timing], Hashable]]] = {
    "pixels": (lambda timing: timing.case.size[0] * timing.case.size[1], _all_but_the_size),
    "radius": (lambda timing: timing.case.radius, _all_but_the_radius),
    "slices": (lambda timing: timing.stats["slices"], _all_but_the_radius),
}

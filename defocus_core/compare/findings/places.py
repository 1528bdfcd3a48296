"""Where a difference lies that no cause explains: rows of a table of places.

A place is said if it tells something: much more of the squared difference lies there than of the
pixels. How much it tells is the relative entropy of the two shares, in nats. What is chosen by the
difference itself, like a region, is measured at pixels that did not choose it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.compare.findings.evidence import blocks_in_turn
from defocus_core.compare.findings.finding import Finding
from defocus_core.compare.selection import beside_jumps, widened

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from defocus_core.compare.findings.evidence import Evidence

    _Mask = NDArray[np.bool_]

_LOOKED_AT = 2**19  # pixels, of which every n-th row and column are kept
_TELLS = 0.35  # least relative entropy of a place, in nats
_MOST, _ONLY = 0.75, 0.9  # least shares of the difference
_FEWEST = 12.0  # pixels that would hold the difference if each held as much
_SHARP = 1.0  # px of the largest radius in focus
_EDGE_REACH = 2  # px around a silhouette
_BRIGHT, _BRIGHT_ON_SCREEN, _DARK = 1.0, 0.9, 0.1  # values as a screen shows them
_STEEPEST = 0.9  # quantile of the gradient beyond which there is an edge
_JUMP = 0.05  # of the range of inverse depth
_BORDERS = (1, 2, 4, 8, 16)  # px
_TAILS = 0.06  # share of the difference that lies beyond each end of a region
_ONE_SIGN = 0.9  # share of the squared difference that makes it brighter, or darker


@dataclass(frozen=True)
class LocatedPair:
    """A pair where its difference is looked at, and what is known of its scene."""

    evidence: Evidence
    radius: NDArray[Any] | None = None  # signed radius [H, W] in px, if a CoC map is at hand
    depth: NDArray[Any] | None = None  # [H, W], if that is

    @cached_property
    def cut(self) -> tuple[slice, slice]:
        """The rows and columns that are looked at."""
        height, width = self.evidence.size
        step = slice(None, None, max(1, math.ceil(math.sqrt(height * width / _LOOKED_AT))))
        return step, step

    @cached_property
    def sides(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """A and B [C, h, w] on the scale of differences."""
        a, b = (self.evidence.scaled(self.evidence.at(side, *self.cut)) for side in "ab")
        return a, b

    @cached_property
    def power(self) -> NDArray[np.float64]:
        """The squared difference [h, w], with the sign of the difference."""
        difference = (self.sides[1] - self.sides[0]).astype(np.float64)
        total = np.copysign(np.square(difference), difference).sum(axis=0)
        finite = self.evidence.pixels.finite
        power: NDArray[np.float64] = total if finite is None else total * finite[self.cut]
        return power

    @cached_property
    def light(self) -> NDArray[Any]:
        """The brightest channel [h, w] of A or B."""
        light: NDArray[Any] = np.maximum(*self.sides).max(axis=0)
        return light


def _in_focus(shown: LocatedPair) -> Iterator[tuple[str, _Mask]]:
    if shown.radius is not None:
        yield "", np.abs(shown.radius[shown.cut]) <= _SHARP


def _out_of_focus(shown: LocatedPair) -> Iterator[tuple[str, _Mask]]:
    if shown.radius is not None:
        yield "", np.abs(shown.radius[shown.cut]) > _SHARP


def _at_silhouettes(shown: LocatedPair) -> Iterator[tuple[str, _Mask]]:
    """Within few pixels of a jump of depth, or within the largest blur of one."""
    reaches = [_EDGE_REACH]
    if shown.radius is not None:
        jumps = beside_jumps(shown.radius)
        reaches.append(math.ceil(float(np.abs(shown.radius).max())))
    elif shown.depth is not None:
        inverse = 1 / np.maximum(shown.depth, 1e-9)
        low, high = np.quantile(inverse[shown.cut], (0.01, 0.99))
        jumps = beside_jumps(inverse, max(_JUMP * float(high - low), 1e-9))
    else:
        return
    for reach in reaches:
        yield f", within {reach} px", widened(jumps, reach)[shown.cut]


def _at_edges(shown: LocatedPair) -> Iterator[tuple[str, _Mask]]:
    """Where A is steep, whatever the depth is."""
    if shown.evidence.pixels.color:
        light = shown.sides[0].mean(axis=0)
        steep = np.hypot(*np.gradient(light))
        yield "", widened(steep > np.quantile(steep, _STEEPEST), 1)


def _in_highlights(shown: LocatedPair) -> Iterator[tuple[str, _Mask]]:
    if shown.evidence.pixels.color:
        linear = shown.evidence.gamma == 1.0
        yield "", shown.light > (_BRIGHT if linear else _BRIGHT_ON_SCREEN)


def _in_shadows(shown: LocatedPair) -> Iterator[tuple[str, _Mask]]:
    if shown.evidence.pixels.color:
        yield "", shown.light < _DARK


def _at_the_border(shown: LocatedPair) -> Iterator[tuple[str, _Mask]]:
    for wide in _BORDERS:
        inner = np.zeros(shown.evidence.size, bool)
        inner[wide:-wide, wide:-wide] = True
        yield f", within {wide} px", ~inner[shown.cut]


def _in_one_region(shown: LocatedPair) -> Iterator[tuple[str, _Mask]]:
    """The rectangle that holds most of the difference in the blocks that choose it."""
    chooses = blocks_in_turn(shown.evidence.size)[shown.cut]
    power = np.abs(shown.power) * chooses
    ends = []
    for axis, step in zip((1, 0), shown.cut, strict=True):
        total = np.cumsum(power.sum(axis=axis))
        if not total[-1] > 0:
            return
        first, last = np.searchsorted(total, (_TAILS * total[-1], (1 - _TAILS) * total[-1]))
        ends.append((int(first) * step.step, (int(last) + 1) * step.step))
    (top, bottom), (left, right) = ends
    bottom, right = min(bottom, shown.evidence.size[0]), min(right, shown.evidence.size[1])
    within = np.zeros(shown.evidence.size, bool)
    within[top:bottom, left:right] = True
    yield f" of {right - left}x{bottom - top} at {left},{top}", within[shown.cut]


@dataclass(frozen=True)
class PlaceRow:
    """A row of the table."""

    name: str
    # The pixels [h, w] that are there, each with what is said of them
    masks: Callable[[LocatedPair], Iterator[tuple[str, _Mask]]]
    least: float = _MOST  # share of the difference that must lie there
    chosen: bool = False  # whether the difference chooses the place in every other block


PLACES = (
    PlaceRow("in focus only", _in_focus, _ONLY),
    PlaceRow("out of focus only", _out_of_focus, _ONLY),
    PlaceRow("at silhouettes", _at_silhouettes),
    PlaceRow("at edges", _at_edges),
    PlaceRow("in highlights", _in_highlights),
    PlaceRow("in shadows", _in_shadows),
    PlaceRow("at the border", _at_the_border),
    PlaceRow("in one region", _in_one_region, chosen=True),
)


def place_of(shown: LocatedPair) -> Finding | None:
    """The place that tells most of where the difference lies; None if none tells enough."""
    power = np.abs(shown.power)
    total = float(power.sum())
    if shown.evidence.is_small or total**2 < _FEWEST * float(np.square(power).sum()):
        return None
    measures = ~blocks_in_turn(shown.evidence.size)[shown.cut]
    told = []
    for place in PLACES:
        for how, mask in place.masks(shown):
            used = measures if place.chosen else np.ones(mask.shape, bool)
            there = mask & used
            every = float(power[used].sum())
            share = float(power[there].sum()) / every if every else 0.0
            area = np.count_nonzero(there) / np.count_nonzero(used)
            if share >= place.least and 0 < area < 1:
                told.append((_entropy(share, area), place.name, how, share, area, mask))
    if not told:
        return None
    tells, name, how, share, area, mask = max(told, key=lambda each: each[0])
    if tells < _TELLS:
        return None
    sign = float(shown.power[mask].sum()) / float(power[mask].sum())
    kind = "brighter" if sign > _ONE_SIGN else "darker" if sign < -_ONE_SIGN else ""
    words = f"{share:.0%} of the difference in {area:.1%} of the pixels"
    text = f"{name}{how}: {words}" + (f", {kind}" if kind else "")
    return Finding(name, text, {"share": round(share, 4), "area": round(area, 4), "kind": kind})


def _entropy(share: float, area: float) -> float:
    """The relative entropy of two shares, in nats."""
    ends = ((share, area), (1 - share, 1 - area))
    return sum(p * math.log(p / q) for p, q in ends if p > 0)

"""Slots: layers of visible radii and octaves of hidden ones, each blurred separately.

As in the torch back, a layer spans 0.75 px of radius near focus, and a constant ratio of radii
beyond 2 px. Layers with wide discs are blurred at reduced resolution.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.renderer.compiled.openings import HALF, NEAR, STEPS
from defocus_core.renderer.layers.slice_radii import ALONE
from defocus_core.tensors.ties import off_round

# Distance in px of the radii of layers near focus.
_DISTANCE = 0.75
# Radius in px at which the first octave of hidden surfaces begins.
_OCTAVE = off_round(ALONE)
# Greatest ratio of radii within a wider one: radii have one layer here, and no shares in two.
_RATIO = 1.4
_FIRST_WIDE = round(ALONE / _DISTANCE)
# Radius in coarse pixels up to which a layer is spread at a resolution.
WIDEST = 27.0


class Slots(NamedTuple):
    """Visible layers, nearest first, then octaves of hidden surfaces, nearest first."""

    least: list[float]  # px, signed, the radius of each visible layer closest to focus
    octaves: dict[int, int]  # the slot of each octave
    levels: NDArray[np.int64]  # how many times resolution is halved to spread each slot
    widest: list[float]  # px, the greatest radius of each
    ends: list[float]  # px, unsigned, the radius of each visible layer farthest from focus
    visible: NDArray[np.int16]  # [2, n] slots of radii nearer than focus and beyond, see `_table`
    hidden: NDArray[np.int16]  # the same for hidden octaves

    @property
    def sides(self) -> NDArray[np.int64]:
        """For each slot, -1, 0 or 1 as the side of focus of a hidden octave; 2 if it is visible."""
        of_octaves = [(octave > 0) - (octave < 0) for octave in self.octaves]
        return np.array([2] * len(self.least) + of_octaves, np.int64)

    @property
    def needed(self) -> NDArray[np.uint8]:
        """For each slot, the least `sight` (farthest slot that the lens sees) at which it shows.

        For a visible slot it is the slot itself, for an octave the first visible slot with radii of
        the octave.
        """
        begins = [r if r > 0 else -end for r, end in zip(self.least, self.ends, strict=True)]
        first = []
        for octave in self.octaves:
            size = _OCTAVE * 2.0 ** (abs(octave) - (octave > 0))
            radius = math.copysign(size, octave) if octave else -_OCTAVE
            first.append(max(sum(begin <= radius for begin in begins) - 1, 0))
        return np.array([*range(len(begins)), *first], np.uint8)

    def rows(self, level: int, which: set[int]) -> list[int]:
        """For each slot, the number of rows at a level that discs reach up and down.

        It is 0 for slots that are not in `which`.
        """
        reach = [math.ceil(max(w / (1 << level), NEAR[1])) + 2 for w in self.widest]
        return [n if s in which else 0 for s, n in enumerate(reach)]


def _layer_of(radius: NDArray[np.float64]) -> NDArray[np.int64]:
    """The number of the layer of each unsigned radius in px: 0 in focus."""
    wide = np.log(np.maximum(radius / ALONE, 1)) / math.log(_RATIO)
    near = np.floor(radius / _DISTANCE + 0.5)
    return np.where(near < _FIRST_WIDE, near, _FIRST_WIDE + np.floor(wide)).astype(np.int64)


def _begin_of(layer: int) -> float:
    """The least unsigned radius of a layer, in px."""
    size = abs(layer)
    return _DISTANCE * size if size < _FIRST_WIDE else ALONE * _RATIO ** (size - _FIRST_WIDE)


def _octave_of(radius: NDArray[np.float64]) -> NDArray[np.int64]:
    """The hidden octave of each unsigned radius in px: 0 below 2 px, 1 below 4 px, and so on."""
    return (np.floor(np.log2(np.maximum(radius, _OCTAVE / 2) / _OCTAVE)) + 1).astype(np.int64)


_Numbering = Callable[[NDArray[np.float64]], NDArray[np.int64]]


@cache
def _numbers(numbering: _Numbering, count: int) -> NDArray[np.int64]:
    """The numbers of layers or octaves for unsigned radii of 0, 1 / STEPS, ... px."""
    return numbering(np.arange(count) / STEPS)


def _table(
    numbering: _Numbering, ends: tuple[float, float]
) -> tuple[range, float, NDArray[np.int16]]:
    """The range of signed numbers of layers, the greatest unsigned radius in px, and a table.

    numbering: gives the number of a layer or octave; ends: least and greatest signed radius in px.
    The table [2, n] holds, for radii of 0, 1 / STEPS, ... px nearer than focus and beyond it, the
    number of the layer minus the first number.
    """
    steps = [int(abs(r) * STEPS + 1 - HALF) for r in ends]
    count = -(-max(steps) // STEPS) * STEPS + 2
    numbers = _numbers(numbering, 1 << count.bit_length())[:count]
    first, last = (int(numbers[q]) * (1 if r > 0 else -1) for q, r in zip(steps, ends, strict=True))
    table = (np.stack([-numbers, numbers]).clip(first, last) - first).astype(np.int16)
    return range(first, last + 1), max(steps) / STEPS, table


def slots_between(visible: tuple[float, float], hidden: tuple[float, float] | None) -> Slots:
    """The slots for visible and for hidden surfaces; `hidden` is None if there are none.

    visible, hidden: least and greatest signed radius in px.
    """
    layers, most, table = _table(_layer_of, visible)
    ends = [_begin_of(abs(layer) + 1) for layer in layers]
    levels = [max(0, math.ceil(math.log2(end / WIDEST))) for end in ends]
    widest = [min(end, most) for end in ends]
    octaves: dict[int, int] = {}
    of_hidden = np.full((2, 1), -1, np.int16)
    if hidden is not None:
        numbers, most, of_hidden = _table(_octave_of, hidden)
        of_hidden += len(layers)
        octaves = {octave: len(layers) + k for k, octave in enumerate(numbers)}
        levels += [1] * len(octaves)
        widest += [min(_OCTAVE * 2.0 ** abs(octave), most) for octave in octaves]
    begins = [math.copysign(_begin_of(layer), layer) for layer in layers]
    return Slots(begins, octaves, np.array(levels), widest, ends, table, of_hidden)

"""Slots: the layers that are spread on their own, by radius; and octaves of what is hidden.

As those of the torch back: near focus each 0.75 px of radius is a layer, beyond 2 px a layer holds
radii of a ratio. A layer whose discs are wide is spread at reduced resolution.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from defocus_core.renderer.compiled.openings import HALF, NEAR, STEPS
from defocus_core.tensors.ties import off_round

# Distance in px of the radii of layers near focus, and where wider ones begin.
_DISTANCE, ALONE = 0.75, 2.0
# Radius in px at which the first octave of what is hidden begins.
_OCTAVE = off_round(ALONE)
# Greatest ratio of radii within a wider one: radii have one layer here, and no shares in two.
_RATIO = 1.4
_FIRST_WIDE = round(ALONE / _DISTANCE)
# Radius in coarse pixels up to which a layer is spread at a resolution.
WIDEST = 27.0


class Slots(NamedTuple):
    """Visible layers, nearest first, then octaves of what is hidden, nearest first."""

    least: list[float]  # px, signed, the radius from which on pixels are of each visible layer
    octaves: dict[int, int]  # the slot of each octave
    level: list[int]  # how many times the resolution is halved at which each is spread
    widest: list[float]  # px, the greatest radius of each
    ends: list[float]  # px, where each visible layer ends, whatever the picture holds
    tables: list[NDArray[np.int16]]  # for each level, in its pixels, those of `slots_of`
    hidden: NDArray[np.int16]  # the same of octaves, at half of the resolution

    @property
    def visible(self) -> int:
        """The number of visible layers, which come first."""
        return len(self.least)

    @property
    def sides(self) -> NDArray[np.int64]:
        """The side of focus of each octave; 2 for visible layers."""
        of_octaves = [(octave > 0) - (octave < 0) for octave in self.octaves]
        return np.array([2] * self.visible + of_octaves, np.int64)

    def rows(self, level: int, which: list[int]) -> list[int]:
        """How many rows of a level the discs of slots reach; 0 of others than those asked for."""
        reach = [math.ceil(max(w / (1 << level), NEAR[1])) + 2 for w in self.widest]
        return [n if s in which else 0 for s, n in enumerate(reach)]

    def has_points(self, level: int) -> NDArray[np.bool_]:
        """Whether each slot has pixels of a level that stay near focus."""
        near = [abs(r) / (1 << level) <= NEAR[0] for r in self.least]
        return np.array(near + [abs(octave) <= 1 for octave in self.octaves])

    def first_of(self, octave: int) -> int:
        """The number of the first visible layer that holds radii of an octave or beyond."""
        size = _OCTAVE * 2.0 ** (abs(octave) - (octave > 0))
        radius = math.copysign(size, octave) if octave else -_OCTAVE
        return max(sum(least <= radius for least in self._begins) - 1, 0)

    @property
    def _begins(self) -> list[float]:
        """The signed radius in px at which each visible layer begins, from the nearest end on."""
        own, ends = self.least, self.ends
        return [r if r > 0 else -end for r, end in zip(own, ends, strict=True)]


def _layer_of(radius: ArrayLike) -> NDArray[np.int64]:
    """The number of the layer of radii in px: 0 in focus, negative nearer."""
    r = np.asarray(radius, np.float64)
    wide = np.log(np.maximum(np.abs(r) / ALONE, 1)) / math.log(_RATIO)
    near = np.floor(np.abs(r) / _DISTANCE + 0.5)
    number = np.where(near < _FIRST_WIDE, near, _FIRST_WIDE + np.floor(wide))
    return (np.sign(r) * number).astype(np.int64)


def _begin_of(layer: int) -> float:
    """The radius in px, without sign, from which on radii are of a layer."""
    size = abs(layer)
    return _DISTANCE * size if size < _FIRST_WIDE else ALONE * _RATIO ** (size - _FIRST_WIDE)


def octave_of(radius: ArrayLike) -> NDArray[np.int64]:
    """The octave of a hidden surface: 0 below 2 px, 1 up to 4 px, ...; negative if nearer."""
    r = np.asarray(radius, np.float64)
    size = np.floor(np.log2(np.maximum(np.abs(r), _OCTAVE / 2) / _OCTAVE)) + 1
    octave: NDArray[np.int64] = (np.sign(r) * size).astype(np.int64)
    return octave


def _rounded(ends: tuple[float, float]) -> tuple[float, float]:
    """The ends of a range of radii in px, rounded as radii are."""
    least, greatest = (math.copysign(int(abs(r) * STEPS + 1 - HALF) / STEPS, r) for r in ends)
    return least, greatest


def slots_between(visible: tuple[float, float], hidden: tuple[float, float] | None) -> Slots:
    """The slots of visible radii from least to greatest in px, and of hidden ones, if any."""
    visible = _rounded(visible)
    first, last = _layer_of(visible).tolist()
    layers = range(first, last + 1)
    ends = [_begin_of(abs(layer) + 1) for layer in layers]
    level = [max(0, math.ceil(math.log2(end / WIDEST))) for end in ends]
    most = max(-visible[0], visible[1])
    widest = [min(end, most) for end in ends]
    tables = []
    for halvings in range(max(level) + 1):
        r = np.arange(math.ceil(most) * STEPS // (1 << halvings) + 2) * (1 << halvings) / STEPS
        numbers = np.stack([_layer_of(-r), _layer_of(r)])
        tables.append((numbers.clip(first, last) - first).astype(np.int16))
    octaves: dict[int, int] = {}
    of_hidden = np.full((2, 1), -1, np.int16)
    if hidden is not None:
        hidden = _rounded(hidden)
        lowest, highest = octave_of(hidden).tolist()
        octaves = {octave: len(layers) + k for k, octave in enumerate(range(lowest, highest + 1))}
        most = max(-hidden[0], hidden[1])
        r = np.arange(math.ceil(most) * STEPS // 2 + 2) * 2 / STEPS
        numbers = np.stack([octave_of(-r), octave_of(r)]).clip(lowest, highest)
        of_hidden = (numbers - lowest + len(layers)).astype(np.int16)
        level += [1] * len(octaves)
        widest += [min(_OCTAVE * 2.0 ** abs(octave), most) for octave in octaves]
    begins = [math.copysign(_begin_of(layer), layer) for layer in layers]
    return Slots(begins, octaves, level, widest, ends, tables, of_hidden)

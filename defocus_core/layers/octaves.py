"""Octaves of blur: which hidden surfaces occlude visible ones beyond them.

What is visible counts first, for it is known. But light of a surface that is far more blurred
spreads over what is hidden before it, and would be seen through it: a sign behind a fence would be
tinted by the sky.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from defocus_core.layers.ladder import ALONE

# How many times as blurred as the most blurred of an octave is what it comes before: surfaces that
# are alike cover each other by chance, and for these the order stays.
_MORE = 1.263
# Of what is too blurred to come before anything.
_REST = 64


class Turns(NamedTuple):
    """When it is the turn of what is hidden.

    Attributes:
        beyond: The number of the first visible layer beyond focus, which comes after what is in
            focus; greater than all if there is none.
        ahead: By octaves, nearest first, that of the first layer which comes after each; without
            those that come before none.
    """

    beyond: int
    ahead: dict[int, int]


def octaves(radii: tuple[float, ...]) -> list[int]:
    """For each slice 0 if |r| < 2 px, 1 up to 4 px, 2 up to 8 px; negative nearer than focus."""
    found = []
    for r in radii:
        octave = math.floor(math.log2(max(abs(r), ALONE / 2) / ALONE)) + 1
        found.append(octave if r > 0 else -octave)
    return found


def turns(radii: tuple[float, ...], numbers: list[int]) -> Turns:
    """Those of slices whose radii in px and numbers of layers, ascending, are these."""
    least: dict[int, float] = {}
    for r, number in zip(radii, numbers, strict=True):
        if r >= ALONE:
            least[number] = min(least.get(number, r), r)
    ahead = {}
    for octave in sorted({o for o in octaves(radii) if o}):
        most = ALONE * 2.0 ** abs(octave)
        later = [number for number, r in least.items() if r >= _MORE * most]
        if later:
            ahead[octave] = min(later)
    return Turns(min(least, default=len(radii)), ahead)


def kept_apart(radii: tuple[float, ...], ahead: dict[int, int]) -> list[int]:
    """For each slice its octave; one on each side of focus for all that come before nothing."""
    return [o if o == 0 or o in ahead else int(math.copysign(_REST, o)) for o in octaves(radii)]

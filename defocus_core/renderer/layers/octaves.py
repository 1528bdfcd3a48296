"""Octaves of blur: which hidden surfaces occlude visible ones beyond them.

Visible layers are composited first, for they are known. But light of a far more blurred surface
spreads over hidden surfaces in front of it, and would shine through them: a sign behind a fence
would be tinted by the sky. So such a hidden surface is composited before the more blurred one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from defocus_core.renderer.layers.ladder import ALONE

# A hidden octave comes before visible layers whose radius is this many times its greatest one.
# Surfaces of like radii cover each other by chance; for them the order stays.
_MORE = 1.263
# Octave of hidden slices too blurred to come before a visible layer.
_REST = 64


class Turns(NamedTuple):
    """The places of hidden octaves in the order of visible layers.

    Attributes:
        around: Number of the first visible layer that is not blurred nearer than focus.
        beyond: Number of the first visible layer beyond focus; greater than all numbers if there
            is none.
        ahead: For each hidden octave, nearest first, the number of the first visible layer that
            comes after it. Octaves that come before no visible layer are absent.
    """

    around: int
    beyond: int
    ahead: dict[int, int]


def octaves(radii: tuple[float, ...]) -> list[int]:
    """For each slice its octave: 0 if |r| < 2 px, 1 up to 4 px, ...; negative nearer than focus."""
    sizes = (math.floor(math.log2(max(abs(r), ALONE / 2) / ALONE)) + 1 for r in radii)
    return [size if r > 0 else -size for size, r in zip(sizes, radii, strict=True)]


def turns(radii: tuple[float, ...], numbers: list[int]) -> Turns:
    """The turns of hidden octaves, from the radii in px of slices and their numbers of layers."""
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
    around = sum(r <= -ALONE for r in radii)
    first = numbers[around] if around < len(radii) else len(radii)
    return Turns(first, min(least, default=len(radii)), ahead)


def kept_apart(radii: tuple[float, ...], ahead: dict[int, int]) -> list[int]:
    """For each slice its octave; octaves that come before no visible layer share one a side."""
    return [o if o == 0 or o in ahead else int(math.copysign(_REST, o)) for o in octaves(radii)]

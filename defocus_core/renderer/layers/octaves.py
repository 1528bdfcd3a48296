"""Octaves of blur: which hidden surfaces occlude visible ones beyond them.

Visible layers are composited first, for they are known. But light of a far more blurred surface
spreads over hidden surfaces in front of it, and would shine through them: a sign behind a fence
would be tinted by the sky. So such a hidden surface is composited before the more blurred one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from torch import Tensor

from defocus_core.renderer.layers.slice_radii import ALONE
from defocus_core.tensors.device_plan import sent

# A hidden octave comes before visible layers whose radius is this many times its greatest one.
# Surfaces of like radii cover each other by chance; for them the order stays.
_MORE = 1.263


class CompositeOrder(NamedTuple):
    """The places of hidden octaves in the order of visible layers."""

    around: int  # number of the first visible layer that is not blurred nearer than focus
    # Number of the first visible layer beyond focus; greater than all numbers if there is none
    beyond: int
    # For each hidden octave, nearest first, the number of the first visible layer that comes
    # after it. Octaves that come before no visible layer are absent
    ahead: dict[int, int]
    # For each picture of a batch, whose slices are those of all, the greatest octave that is
    # ahead by its own; empty where there is one picture
    greatest: tuple[int, ...] = ()

    def pictures_with(self, octave: int, like: Tensor) -> Tensor | None:
        """1 for pictures [B, 1, 1] in which an octave is ahead, else 0; None if it is in all."""
        if all(abs(octave) <= greatest for greatest in self.greatest):
            return None
        which = [float(abs(octave) <= greatest) for greatest in self.greatest]
        return sent(which, like)[:, None, None]


def octaves(radii: tuple[float, ...]) -> list[int]:
    """For each slice its octave: 0 if |r| < 2 px, 1 up to 4 px, ...; negative nearer than focus."""
    sizes = (math.floor(math.log2(max(abs(r), ALONE / 2) / ALONE)) + 1 for r in radii)
    return [size if r > 0 else -size for size, r in zip(sizes, radii, strict=True)]


def composite_order(radii: tuple[float, ...], layer_indices: list[int]) -> CompositeOrder:
    """The composite order of hidden octaves, by the radii in px and the layers of slices."""
    minimum: dict[int, float] = {}
    for r, number in zip(radii, layer_indices, strict=True):
        if r >= ALONE:
            minimum[number] = min(minimum.get(number, r), r)
    ahead = {}
    for octave in sorted({o for o in octaves(radii) if o}):
        maximum = ALONE * 2.0 ** abs(octave)
        later = [number for number, r in minimum.items() if r >= _MORE * maximum]
        if later:
            ahead[octave] = min(later)
    around = sum(r <= -ALONE for r in radii)
    first = layer_indices[around] if around < len(radii) else len(radii)
    return CompositeOrder(first, min(minimum, default=len(radii)), ahead)

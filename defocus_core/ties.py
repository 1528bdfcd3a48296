"""Comparisons of radii that rounding must not decide.

Depth in levels has radii in equal steps, and many are just as far from one surface as from another.
What is compared with them is no round number, here and where a constant is 1.013 and not 1: then
another device, whose last bit differs, sees the same surfaces.
"""

from __future__ import annotations

from torch import Tensor

# Where between two radii the border is that tells them apart.
_HALFWAY = 0.499


def halfway(near: Tensor, far: Tensor) -> Tensor:
    """The border between each near and far radius: what is as far from both belongs to the far."""
    return near + (far - near) * _HALFWAY

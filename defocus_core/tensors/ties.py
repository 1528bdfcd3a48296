"""Choices whose gradient, and thresholds whose outcome, do not depend on rounding.

Depth of few levels steps by round numbers of px: `off_round` keeps thresholds beside them. Values
that differ by rounding alone tie, whatever the order of sums, the device or the tile; the gradient
at a tie is that of both values, or of the intended one.
"""

from __future__ import annotations

import math

from defocus_core.tensors.later import Tensor, torch

# Values of order 1 tie if they differ by at most so many roundings, or by so much in any precision,
# as after a few sums.
_ROUNDINGS, _LEAST = 8, 2e-14


def off_round(bound: float) -> float:
    """A threshold slightly above a round number, by 0.013 of its power of ten."""
    return round(bound + 0.013 * 10.0 ** math.floor(math.log10(bound)), 9)


def tied(a: Tensor, b: Tensor | float) -> Tensor:
    """Whether values of two tensors are equal but for rounding: bool."""
    a = a.detach()
    difference = a - (b.detach() if isinstance(b, Tensor) else b)
    tolerance = max(_ROUNDINGS * torch.finfo(a.dtype).eps, _LEAST)
    return difference.abs() <= tolerance * a.abs().clamp(min=1)


def with_gradient(values: Tensor, of: Tensor) -> Tensor:
    """The values, with the gradient of `of`, which equals the values but for rounding."""
    return values.detach() + (of - of.detach())

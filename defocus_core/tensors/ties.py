"""Choices and thresholds whose results and gradients do not depend on rounding.

Differences of quantised depth are often round numbers of px: `off_round` moves thresholds off
them. Values that differ only by rounding count as equal, whatever the order of sums, the device or
the tile; where two values are equal, the gradient is that of both, or of the intended one.
"""

from __future__ import annotations

import math

from defocus_core.tensors.later import Tensor, torch

# Values of order 1 are equal if they differ by at most _ROUNDINGS units of rounding, or by _LEAST
# in any precision, as after a few sums.
_ROUNDINGS, _LEAST = 8, 2e-14


def off_round(bound: float) -> float:
    """A threshold slightly above a round number, by 0.013 of its power of ten: 0.2513 for 0.25."""
    return round(bound + 0.013 * 10.0 ** math.floor(math.log10(bound)), 9)


def tied(a: Tensor, b: Tensor | float) -> Tensor:
    """Whether the values of `a` and `b` are equal except for rounding: bool."""
    a = a.detach()
    difference = a - (b.detach() if isinstance(b, Tensor) else b)
    tolerance = max(_ROUNDINGS * torch.finfo(a.dtype).eps, _LEAST)
    return difference.abs() <= tolerance * a.abs().clamp(min=1)


def with_gradient(values: Tensor, of: Tensor) -> Tensor:
    """`values` with the gradient of the tensor `of`, which is equal except for rounding."""
    return values.detach() + (of - of.detach())

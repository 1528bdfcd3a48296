"""Ties: choices whose gradient, and thresholds whose outcome, does not hang on rounding.

Depth of few levels steps by round numbers of px: `off_round` keeps thresholds beside them.

At a tie the derivative has two one-sided values. Half of each lies between them, whatever the order
of sums, the device or the tile; the value that is chosen is that of torch's own function.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

# Values of order 1 that differ by at most so many roundings tie, and by so much in any precision:
# what differs by 1e-15 of a radius, after a few sums.
_ROUNDINGS, _LEAST = 8, 2e-14


def off_round(bound: float) -> float:
    """A threshold above a round one by 0.013 of its power of ten, which no round value meets."""
    return round(bound + 0.013 * 10.0 ** math.floor(math.log10(bound)), 9)


def tied(a: Tensor, b: Tensor | float) -> Tensor:
    """Where two values are equal but for rounding."""
    a = a.detach()
    difference = a - (b.detach() if isinstance(b, Tensor) else b)
    tolerance = max(_ROUNDINGS * torch.finfo(a.dtype).eps, _LEAST)
    return difference.abs() <= tolerance * a.abs().clamp(min=1)


def lesser(a: Tensor, b: Tensor) -> Tensor:
    """`torch.minimum`."""
    return _shared(torch.minimum(a, b), a, b)


def greater(a: Tensor, b: Tensor) -> Tensor:
    """`torch.maximum`."""
    return _shared(torch.maximum(a, b), a, b)


def positive(values: Tensor) -> Tensor:
    """`values.clamp(min=0)`."""
    return greater(values, torch.zeros_like(values))


def bounded(values: Tensor, minimum: float) -> Tensor:
    """`values.clamp(min=minimum)` of what rounding alone brings below: the gradient passes."""
    limited = values.clamp(min=minimum)
    if not (torch.is_grad_enabled() and values.requires_grad):
        return limited
    return torch.where(tied(values, minimum), with_gradient(limited, values), limited)


def within(values: Tensor, minimum: Tensor, maximum: Tensor) -> Tensor:
    """`values.clamp(minimum, maximum)`."""
    return lesser(greater(values, minimum), maximum)


def with_gradient(values: Tensor, of: Tensor) -> Tensor:
    """The values, with the gradient of others, which they equal but for rounding."""
    return values.detach() + (of - of.detach())


def _shared(chosen: Tensor, a: Tensor, b: Tensor) -> Tensor:
    if not (torch.is_grad_enabled() and chosen.requires_grad):
        return chosen
    return torch.where(tied(a, b), with_gradient(chosen, (a + b) / 2), chosen)

"""Slopes of the radius: how densely each side of the aperture sees a tilted surface.

Lens point u sees pixel q at q + r(q) u. Where the radius changes from pixel to pixel, this map
stretches or crowds the surface: pixels of it land 1 + u·∇r apart (the determinant of its
derivative). So a pixel stands for a share 1 + u·∇r of what u sees; without it a tilted surface is
seen too thin from one side and too thick from the other.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.neighbourhoods import range_of

# Slopes in px per px, below which the limiter is nearly a plain mean.
_SMALL = 0.05
# Half width in px of the square around a pixel, and the share of it that must be steep.
_AROUND = 5
_AREA = 0.345  # no share of whole pixels, so that rounding decides nothing
# Px around a pixel that decide its slope.
AROUND = _AROUND + 1


def slopes(signed_radius: Tensor, minimum: float = 0.0) -> Tensor | None:
    """∇r in px per px, x then y: [2, ..., H, W] of radii [..., H, W]; at most 1 long.

    At an edge of depth it is the slope of the pixel's own surface, to 0.01. Beyond a length of 1
    some lens points see its back.

    `signed_radius`: [..., H, W] px. Returns none if all slopes are 0.
    """
    x, y = _limited(signed_radius, -1), _limited(signed_radius, -2)
    square = torch.addcmul(x * x, y, y)
    lowest, highest = range_of(square.detach()).tolist()
    if highest <= minimum * minimum:
        return None
    steep = square.detach() > minimum * minimum
    some_flat = lowest <= minimum * minimum
    if minimum and some_flat:
        steep &= _many_around(steep)
        if not bool(steep.any()):
            return None
    if highest > 1:
        short = square.clamp(min=1).rsqrt()
        x, y = x * short, y * short
    gradient = torch.stack([x, y])
    return gradient * steep.to(gradient.dtype) if some_flat else gradient


def _many_around(mask: Tensor) -> Tensor:
    """Where enough of the square around each pixel, cut to the frame, is in a mask [..., H, W]."""
    count, area = mask.to(torch.int32), torch.ones((), device=mask.device)
    for dim in (-2, -1):
        n = mask.shape[dim]
        position = torch.arange(n, device=mask.device)
        first, end = (position - _AROUND).clamp(min=0), (position + _AROUND + 1).clamp(max=n)
        sums = pad(count.cumsum(dim, dtype=torch.int32), (1, 0) if dim == -1 else (0, 0, 1, 0))
        count = sums.index_select(dim, end) - sums.index_select(dim, first)
        area = area[..., None] * (end - first)
    return count > _AREA * area


def _limited(r: Tensor, dim: int) -> Tensor:
    """A mean of the differences to both neighbours, in which the lesser counts more.

    The limiter of van Albada et al. (1982), smooth at 0.
    """
    if r.shape[dim] == 1:
        return torch.zeros_like(r)
    n, step = r.shape[dim], r.diff(dim=dim)
    steps = torch.cat([step.narrow(dim, 0, 1), step, step.narrow(dim, -1, 1)], dim)
    pairs = ((x.narrow(dim, 0, n), x.narrow(dim, 1, n)) for x in (steps, _weights(steps)))
    return _mean(*pairs)


def _weights(steps: Tensor) -> Tensor:
    return torch.addcmul(sent(_SMALL**2, steps), steps, steps)


def _mean(steps: tuple[Tensor, Tensor], weights: tuple[Tensor, Tensor]) -> Tensor:
    """The mean of two steps, each weighted by the other's weight."""
    (a, b), (a2, b2) = steps, weights
    return torch.addcmul(a * b2, b, a2) / (a2 + b2)

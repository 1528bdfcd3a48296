"""Slopes of the radius: how densely a tilted surface is seen from each side of the aperture.

Lens point u sees pixel q at q + r(q) u. Where the radius changes from pixel to pixel, this map
stretches or crowds the surface: pixels of it land 1 + u·∇r apart (the determinant of its
derivative). So a pixel stands for a share 1 + u·∇r of what u sees; without it a tilted surface is
seen too thin from one side and too thick from the other.
"""

from __future__ import annotations

import torch
from torch import Tensor

# Slopes in px per px that may be a plain mean.
_SMALL = 0.05


def slopes(signed_radius: Tensor) -> Tensor:
    """∇r in px per px, x then y: [2, H, W] of radii [H, W]; at most 1 long.

    At an edge of depth it is the slope of the pixel's own surface. Beyond a length of 1 some lens
    points see its back.
    """
    gradient = torch.stack([_limited(signed_radius, -1), _limited(signed_radius, -2)])
    square = (gradient * gradient).sum(0)
    steep = square > 1
    return gradient * torch.where(steep, torch.where(steep, square, 1.0).rsqrt(), 1.0)


def _limited(r: Tensor, dim: int) -> Tensor:
    """A mean of the differences to both neighbours, in which the lesser counts more.

    The limiter of van Albada et al. (1982), smooth at 0.
    """
    if r.shape[dim] == 1:
        return torch.zeros_like(r)
    step = r.diff(dim=dim)
    first, last = step.narrow(dim, 0, 1), step.narrow(dim, -1, 1)
    a, b = torch.cat([first, step], dim), torch.cat([step, last], dim)
    a2, b2 = a * a + _SMALL**2, b * b + _SMALL**2
    return (a * b2 + b * a2) / (a2 + b2)

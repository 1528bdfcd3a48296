"""Slopes of the radius: how densely a tilted surface is seen from each side of the aperture.

Lens point u sees pixel q at q + r(q) u. Where the radius changes from pixel to pixel, this map
stretches or crowds the surface: pixels of it land 1 + u·∇r apart (the determinant of its
derivative). So a pixel stands for a share 1 + u·∇r of what u sees; without it a tilted surface is
seen too thin from one side and too thick from the other.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from defocus_core.tiling import BLOCK, Box

# Slopes in px per px that may be a plain mean.
_SMALL = 0.05
# Px to each side of a pixel, and the share of those that must be steep.
_AROUND = 5
_AREA = 0.345  # no share of whole pixels, so that rounding decides nothing
# Slopes that differ by less are the same.
_SAME = 1e-3
# Px around a pixel that decide its slope.
AROUND = _AROUND + 1


def slopes(signed_radius: Tensor, least: float = 0.0) -> Tensor | None:
    """∇r in px per px, x then y: [2, H, W] of radii [H, W]; at most 1 long.

    At an edge of depth it is the slope of the pixel's own surface. Beyond a length of 1 some lens
    points see its back.

    Args:
        signed_radius: [H, W] px.
        least: Slopes up to this are left out, and so are steep lines, like the limb of a ball:
            what is steep counts if it is a third of the pixels around.

    Returns:
        None if nothing is left.
    """
    gradient = torch.stack([_limited(signed_radius, -1), _limited(signed_radius, -2)])
    square = (gradient * gradient).sum(0)
    steep = square.detach() > least * least
    if not bool(steep.any()):
        return None
    if least and not bool(steep.all()):
        steep &= _share_around(steep) > _AREA
        if not bool(steep.any()):
            return None
    long = square > 1
    return gradient * torch.where(long, torch.where(long, square, 1.0).rsqrt(), 1.0) * steep


class Planes:
    """Where slices have the same slope all over: their kernels can be tilted instead of them."""

    def __init__(self, lowest: Tensor, highest: Tensor, blocks: Tensor) -> None:
        """Keep the range of slopes in each block.

        Args:
            lowest: [2, rows, columns], the least of the slopes.
            highest: The greatest.
            blocks: [K, rows, columns] bool, where slices are.
        """
        self._lowest, self._highest, self._blocks = lowest, highest, blocks

    def slope(self, number: int, box: Box) -> tuple[float, float] | None:
        """The slope of a slice, x and y, if it has but one within a rectangle of the frame."""
        top, left = max(box.top // BLOCK, 0), max(box.left // BLOCK, 0)
        below, beside = -(-(box.top + box.height) // BLOCK), -(-(box.left + box.width) // BLOCK)
        some = self._blocks[number, top:below, left:beside]
        lowest = self._lowest[:, top:below, left:beside][:, some]
        if not lowest.numel():
            return None
        low, high = lowest.amin(1), self._highest[:, top:below, left:beside][:, some].amax(1)
        if float((high - low).max()) > _SAME:
            return None
        x, y = ((low + high) / 2).tolist()
        return x, y


def _share_around(mask: Tensor) -> Tensor:
    """The share of a mask [H, W] in the square around each pixel."""
    size = 2 * _AROUND + 1
    share = mask[None].to(torch.float32)
    for kernel, edge in (((size, 1), (_AROUND, 0)), ((1, size), (0, _AROUND))):
        share = avg_pool2d(share, kernel, stride=1, padding=edge, count_include_pad=False)
    return share[0]


def _limited(r: Tensor, dim: int) -> Tensor:
    """A mean of the differences to both neighbours, in which the lesser counts more.

    The limiter of van Albada et al. (1982), smooth at 0.
    """
    if r.shape[dim] == 1:
        return torch.zeros_like(r)
    n, step = r.shape[dim], r.diff(dim=dim)
    steps = torch.cat([step.narrow(dim, 0, 1), step, step.narrow(dim, -1, 1)], dim)
    squares = steps * steps + _SMALL**2
    (a, b), (a2, b2) = ([x.narrow(dim, i, n) for i in (0, 1)] for x in (steps, squares))
    return torch.addcmul(a * b2, b, a2) / (a2 + b2)

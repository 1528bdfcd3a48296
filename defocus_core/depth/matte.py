"""Depth by a matte: a pixel beside the silhouette of a subject has the depth of its own side.

Depth that is fat, thin or soft says wrongly there which side a pixel is of. The radius of a side is
its extreme one, away from the other side, for what is soft lies between.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, max_pool2d

from defocus_core.depth.matting import EDGE, SUBJECT

# Half width in px of the square in which the silhouette, and the radii of its sides, are found.
AROUND = 8


class _Range(NamedTuple):
    """The radii [H, W] px of one side in the square around each pixel."""

    nearest: Tensor  # the least; 0 where the side has no pixel
    farthest: Tensor  # the greatest; 0 where it has none
    mean: Tensor  # their mean; 0 where it has none
    known: Tensor  # bool, whether it has a pixel


def with_matte(signed_radius: Tensor, matte: Tensor) -> Tensor:
    """Radii [H, W] px whose edges are those of a matte [H, W], where its sides differ in depth."""
    subject = matte >= SUBJECT
    of_subject, of_rest = (_range_of(signed_radius, mask) for mask in (subject, ~subject))
    own, other = (
        _Range(*(torch.where(subject, a, b) for a, b in zip(one, two, strict=True)))
        for one, two in ((of_subject, of_rest), (of_rest, of_subject))
    )
    is_near = own.mean < other.mean
    radius = torch.where(is_near, own.nearest, own.farthest)
    apart = radius - torch.where(is_near, other.farthest, other.nearest)
    return torch.where(own.known & other.known & (apart.abs() > EDGE), radius, signed_radius)


def _range_of(signed_radius: Tensor, mask: Tensor) -> _Range:
    """The radii of the pixels [H, W] of a mask in the square around each pixel."""

    def greatest(values: Tensor) -> Tensor:
        return _pooled(torch.where(mask, values, -torch.inf), max_pool2d)

    farthest, nearest = greatest(signed_radius), -greatest(-signed_radius)
    known = farthest > -torch.inf
    count = _pooled(mask.to(signed_radius), avg_pool2d)
    total = _pooled(torch.where(mask, signed_radius, 0.0), avg_pool2d)
    mean = total / torch.where(known, count, 1.0)
    nearest, farthest = (torch.where(known, each, 0.0) for each in (nearest, farthest))
    return _Range(nearest, farthest, mean, known)


def _pooled(values: Tensor, pool: Callable[..., Tensor]) -> Tensor:
    """What a pool makes of the square around each pixel [H, W]: of its columns, then its rows."""
    side, values = 2 * AROUND + 1, values[None, None]
    values = pool(values, (side, 1), 1, (AROUND, 0))
    return pool(values, (1, side), 1, (0, AROUND))[0, 0]

"""Slices of the scene by signed CoC radius, and the share that each pixel has in them.

Slice radii stand on a ladder in px that depends on the quality alone. A pixel between two rungs
belongs to both, by weights that sum to one and keep the second moment of its blur: linear in r².
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.quality import Quality


class Slices(NamedTuple):
    """Where each pixel stands on the ladder.

    Attributes:
        radii: Signed radii of the slices in px, ascending: nearest first.
        lower: [...] index of the slice below the pixel's radius.
        upper_share: [...] share of the pixel in slice `lower` + 1; the rest is in `lower`.
    """

    radii: tuple[float, ...]
    lower: Tensor
    upper_share: Tensor


def rungs(least: float, most: float, quality: Quality) -> tuple[float, ...]:
    """The part of the ladder, at least two rungs, that holds radii from least to most."""
    reach = max(abs(least), abs(most))
    side = [0.0]
    while side[-1] < reach or len(side) < 2:
        side.append(side[-1] + max(quality.near_spacing, quality.far_spacing * side[-1]))
    ladder = [-r for r in reversed(side[1:])] + side
    first = max(i for i, r in enumerate(ladder[:-1]) if r <= least or i == 0)
    last = min(i for i, r in enumerate(ladder) if r >= most and i > first)
    return tuple(ladder[first : last + 1])


def evenly(least: float, most: float, count: int) -> tuple[float, ...]:
    """Exactly `count` radii from least to most; one stands in the middle."""
    if count == 1:
        return ((least + most) / 2,)
    return tuple(least + (most - least) * k / (count - 1) for k in range(count))


def cut(signed_radius: Tensor, radii: tuple[float, ...]) -> Slices:
    """Place radii [...] px on the ladder; what lies beyond its ends belongs to the end."""
    if len(radii) == 1:
        return Slices(
            radii,
            torch.zeros_like(signed_radius, dtype=torch.long),
            torch.zeros_like(signed_radius),
        )
    ladder = torch.tensor(radii, dtype=signed_radius.dtype, device=signed_radius.device)
    lower = torch.searchsorted(ladder, signed_radius.detach().contiguous(), right=True) - 1
    lower = lower.clamp(0, len(radii) - 2)
    low, high = ladder[lower], ladder[lower + 1]
    r = torch.minimum(torch.maximum(signed_radius, low), high)
    one_side = low * high >= 0
    moment = torch.where(one_side, high * high - low * low, 1.0)
    width = torch.where(high > low, high - low, 1.0)
    share = torch.where(one_side, (r * r - low * low) / moment, (r - low) / width)
    return Slices(radii, lower, share)


def membership(lower: Tensor, upper_share: Tensor, slices: Tensor) -> Tensor:
    """Share of each pixel in the slices of the given indices: [K] and [..., H, W] to [K, H, W]."""
    k = slices[:, None, None]
    zero = torch.zeros((), dtype=upper_share.dtype, device=upper_share.device)
    below = torch.where(lower == k, 1 - upper_share, zero)
    return torch.where(lower == k - 1, upper_share, below)

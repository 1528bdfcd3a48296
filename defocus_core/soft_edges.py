"""Soft edges of depth, put where the colours have theirs.

Estimated depth is soft at edges, and some px off: beside a sharp subject a strip of what lies
behind would stay sharp, or its own rim would be blurred. Around a ramp of several px each pixel is
linked to the surface to which the path of least change in colour leads (geodesic segmentation,
Criminisi et al. 2008), and gets its radius where that is another one than its own.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.extremes import extreme_around
from defocus_core.ramps import AROUND as AROUND_RAMPS
from defocus_core.ramps import on_ramps, without_ramps

# Px around a ramp in which the edge may be; and within which radii are still those of the ramp.
_BESIDE, _FOOT = 8, 1
# Px of the longest path; and what a px of it costs, where 1 is the greatest change of colour.
_FARTHEST, _PER_PX = 24, 0.02
# Px within which the surfaces on both sides of an edge are seen.
_SIDES = 12
# Paths are added up in whole units, above the number of the pixel at which they end.
_UNITS, _NUMBERS, _NOWHERE = 1 << 12, 1 << 32, 1 << 62
# Px around a pixel that decide what it becomes.
AROUND = max(_FARTHEST, _SIDES) + _BESIDE + 2 + AROUND_RAMPS


def soft_edges(signed_radius: Tensor) -> Tensor:
    """The pixels [H, W] bool in the middle of ramps that are several px wide and long.

    Args:
        signed_radius: [H, W] px.
    """
    return extreme_around(on_ramps(signed_radius), 1, torch.minimum)


def with_hard_edges(signed_radius: Tensor, pixels: Tensor) -> Tensor:
    """Radii [H, W] px without ramps; soft edges lie where the colours of [C, H, W] change."""
    steps = without_ramps(signed_radius)
    soft = extreme_around(soft_edges(signed_radius), 1, torch.maximum)
    if not bool(soft.any()):
        return steps
    unsure = extreme_around(soft, _BESIDE, torch.maximum)
    index = torch.nonzero(unsure.flatten())[:, 0]
    foot, least, most = (
        extreme_around(some, by, choice).flatten().index_select(0, index)
        for some, by, choice in (
            (soft, _FOOT, torch.maximum),
            (steps, _SIDES, torch.minimum),
            (steps, _SIDES, torch.maximum),
        )
    )
    radii, middle = steps.flatten(), (least + most) / 2
    colors = pixels.detach().to(torch.promote_types(pixels.dtype, torch.float32))
    linked, ends = _linked(colors, radii.detach(), unsure, index)
    own = radii.index_select(0, index)
    found = radii.index_select(0, ends.index_select(0, linked.clamp(min=0)))
    moved = (linked >= 0) & (foot | ((found > middle) != (own > middle)))
    return radii.index_copy(0, index, torch.where(moved, found, own)).reshape(steps.shape)


def _linked(pixels: Tensor, radii: Tensor, unsure: Tensor, index: Tensor) -> tuple[Tensor, Tensor]:
    """To which of the pixels around an area the path of least change leads from each in it.

    Args:
        pixels: [C, H, W].
        radii: [H * W] px; of two that are as near the greater is chosen.
        unsure: [H, W] bool, the area.
        index: [n] numbers of its pixels.

    Returns:
        [n] places among the pixels around, -1 where all are too far; and [m] the numbers of these.
    """
    H, W = unsure.shape
    row = index.div(W, rounding_mode="floor")
    column = index - row * W
    ways = ((row > 0, -W), (row < H - 1, W), (column > 0, -1), (column < W - 1, 1))
    beside = [index + step * some for some, step in ways]
    color = pixels.clamp(min=0).flatten(1)
    light = color.sum(0) + torch.finfo(color.dtype).tiny
    own, own_light = color.index_select(1, index), light.index_select(0, index)
    costs = []
    for there in beside:
        change = (color.index_select(1, there) - own).abs().sum(0)
        share = change / (light.index_select(0, there) + own_light)
        costs.append(((share + _PER_PX) * _UNITS).round().long() * _NUMBERS)
    around = torch.zeros_like(unsure).flatten()
    around[torch.cat(beside)] = True
    ends = torch.nonzero(around & ~unsure.flatten())[:, 0]
    ends = ends[torch.argsort(radii.index_select(0, ends), descending=True)]
    n, m = len(index), len(ends)
    place = torch.empty_like(around, dtype=torch.long)
    place[torch.cat([index, ends])] = torch.arange(n + m, device=index.device)
    neighbours = [place.index_select(0, there) for there in beside]
    # the farther of two ends, which comes first, wins a tie
    paths = torch.cat([torch.full_like(index, _NOWHERE), torch.arange(m, device=index.device)])
    for _ in range(_FARTHEST):
        least = paths[:n]
        for there, cost in zip(neighbours, costs, strict=True):
            least = torch.minimum(least, paths.index_select(0, there).add_(cost))
        paths = torch.cat([least, paths[n:]])
    return torch.where(least < _NOWHERE, least % _NUMBERS, -1), ends

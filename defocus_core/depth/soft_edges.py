"""Soft edges of depth, put where the colours have theirs.

Estimated depth is soft at edges, and some px off: beside a sharp subject a strip of what lies
behind would stay sharp, or its own rim would be blurred. Around a ramp of several px each pixel is
linked to the surface to which the path of least change in colour leads (geodesic segmentation,
Criminisi et al. 2008), and gets its radius where that is another one than its own.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.depth.ramps import AROUND as AROUND_RAMPS
from defocus_core.depth.ramps import STEEP, steepness, without_ramps
from defocus_core.images.neighbourhoods import extreme_around, halfway, steps_beside
from defocus_core.images.sparse_masks import numbers_of

# Slope of a soft edge, per px, as a share of the range of radii in a frame, and at least in px: of
# less it does not matter where it lies. Of a hard edge the least step, in such slopes, and how much
# more level the pixels beside it are.
_SHARE, LEAST, _STEP, _LEVEL = 1 / 40, 0.7513, 2.013, 0.2513
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


def softness(slope: Tensor) -> Tensor:
    """The slope of ramps that are several px wide and long, at pixels [H, W] in their middle.

    Args:
        slope: [H, W] of all ramps, from `steepness`.
    """
    return extreme_around(slope, 1, torch.minimum)


def slope_of_soft_edges(least: float, most: float) -> float:
    """The slope in px per px of a soft edge in a frame of such radii in px.

    A surface may be steep; but none of those that are seen goes through the whole range in 40 px.
    """
    return min(STEEP, max(LEAST, (most - least) * _SHARE))


def hard_steps(signed_radius: Tensor, steep: float) -> Tensor:
    """How many steps of radii [H, W] px from one pixel to the next are hard edges."""
    found = torch.zeros((), dtype=torch.long, device=signed_radius.device)
    for dim in (-1, -2):
        before, here, after = steps_beside(signed_radius, dim)
        level = torch.maximum(before, after) < _LEVEL * here
        found += ((here > _STEP * steep) & level).sum()
    return found


def with_hard_edges(signed_radius: Tensor, pixels: Tensor, steep: float = STEEP) -> Tensor:
    """Radii [H, W] px without ramps; soft edges lie where the colours of [C, H, W] change."""
    steps = without_ramps(signed_radius, steep)
    soft = extreme_around(softness(steepness(signed_radius)) > steep, 1, torch.maximum)
    if not bool(soft.any()):
        return steps
    unsure = extreme_around(soft, _BESIDE, torch.maximum)
    index = numbers_of(unsure)
    foot, least, most = (
        extreme_around(some, by, choice).flatten().index_select(0, index)
        for some, by, choice in (
            (soft, _FOOT, torch.maximum),
            (steps, _SIDES, torch.minimum),
            (steps, _SIDES, torch.maximum),
        )
    )
    radii, between = steps.flatten(), halfway(least, most)
    colors = pixels.detach().to(torch.promote_types(pixels.dtype, torch.float32))
    linked, ends = _linked(colors, radii.detach(), unsure, index)
    if not len(ends):
        return steps
    own = radii.index_select(0, index)
    found = radii.index_select(0, ends.index_select(0, linked.clamp(min=0)))
    moved = (linked >= 0) & (foot | ((found > between) != (own > between)))
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

"""Soft edges of depth moved to the edges of the colours.

Estimated depth is soft at edges, and a few px off: beside a sharp subject a strip of the background
would stay sharp, or the subject's own rim would be blurred. Around a ramp of several px each pixel
is linked to the surface to which the path of least change in colour leads (geodesic segmentation,
Criminisi et al. 2008), and gets the radius of this surface if the depth map gave it to another.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.depth.ramps import AROUND as AROUND_RAMPS
from defocus_core.depth.ramps import STEEP, steepness, without_ramps
from defocus_core.images.neighbourhoods import extreme_around, halfway, steps_beside
from defocus_core.images.sparse_masks import numbers_of

# Least slope of a soft edge: as a share of the range of radii in a frame, per px, and in px per px;
# the place of a less steep edge does not matter. Least step of a hard edge, as a multiple of this
# slope, and the greatest slope beside it, as a share of the step.
_SHARE, LEAST, _STEP, _LEVEL = 1 / 40, 0.7513, 2.013, 0.2513
# Px around a ramp in which the edge may be, and px around it that still have radii of the ramp.
_BESIDE, _FOOT = 8, 1
# Greatest length of a path in px; cost of each px of it, where the greatest change of colour is 1.
_FARTHEST, _PER_PX = 24, 0.02
# Px around a pixel in which the surfaces on both sides of an edge are seen.
_SIDES = 12
# Costs of paths are whole units in the upper bits, the number of the pixel at the end in the lower.
_UNITS, _NUMBERS, _NOWHERE = 1 << 12, 1 << 32, 1 << 62
# Px around a pixel that decide what it becomes.
AROUND = max(_FARTHEST, _SIDES) + _BESIDE + 2 + AROUND_RAMPS


def softness(slope: Tensor) -> Tensor:
    """The slope [H, W] in the middle of ramps that are several px wide and long; 0 elsewhere.

    Args:
        slope: [H, W] px per px, of all ramps, from `steepness`.
    """
    return extreme_around(slope, 1, torch.minimum)


def slope_of_soft_edges(least: float, most: float) -> float:
    """The least slope in px per px of a soft edge in a frame with radii from least to most px.

    A surface may be steep, but no visible surface goes through the whole range within 40 px.
    """
    return min(STEEP, max(LEAST, (most - least) * _SHARE))


def hard_steps(signed_radius: Tensor, steep: float) -> Tensor:
    """The number of steps of radii [H, W] px, from one pixel to the next, that are hard edges."""
    count = torch.zeros((), dtype=torch.long, device=signed_radius.device)
    for dim in (-1, -2):
        before, step, after = steps_beside(signed_radius, dim)
        level = torch.maximum(before, after) < _LEVEL * step
        count += ((step > _STEP * steep) & level).sum()
    return count


def with_hard_edges(signed_radius: Tensor, pixels: Tensor, steep: float = STEEP) -> Tensor:
    """Radii [H, W] px without ramps; soft edges lie where the colours of [C, H, W] change."""
    steps = without_ramps(signed_radius, steep)
    soft = extreme_around(softness(steepness(signed_radius)) > steep, 1, torch.maximum)
    if not bool(soft.any()):
        return steps
    unsure = extreme_around(soft, _BESIDE, torch.maximum)
    index = numbers_of(unsure)
    foot, least, most = (
        extreme_around(values, by, choice).flatten().index_select(0, index)
        for values, by, choice in (
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
    at_end = radii.index_select(0, ends.index_select(0, linked.clamp(min=0)))
    moved = (linked >= 0) & (foot | ((at_end > between) != (own > between)))
    return radii.index_copy(0, index, torch.where(moved, at_end, own)).reshape(steps.shape)


def _linked(pixels: Tensor, radii: Tensor, unsure: Tensor, index: Tensor) -> tuple[Tensor, Tensor]:
    """The pixel around an area to which the path of least change leads, for each pixel of the area.

    Args:
        pixels: [C, H, W].
        radii: [H * W] px; of two ends at equal cost the one with the greater radius is chosen.
        unsure: [H, W] bool, the area.
        index: [n] numbers of its pixels.

    Returns:
        [n] places in the list of pixels around the area, -1 where all are too far; and this list,
        [m] numbers of pixels.
    """
    H, W = unsure.shape
    row = index.div(W, rounding_mode="floor")
    column = index - row * W
    ways = ((row > 0, -W), (row < H - 1, W), (column > 0, -1), (column < W - 1, 1))
    beside = [index + step * inside for inside, step in ways]
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

"""Quantised depth made smooth again: small steps between levels become slopes.

An 8-bit depth map shows a slope as terraces. No surface ends where the radius steps by up to a
pixel, but a step of nearly a pixel would leave a gap as wide, and the far background would show
through it as a thin line. Pixels beside such steps get the mean radius of the pixels around them,
as far as one surface goes.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from defocus_core.tensors.bands import bands
from defocus_core.tensors.neighbourhoods import extreme_around, steps_beside
from defocus_core.tensors.sparse_masks import exceeding, flat_nonzero, tally_of
from defocus_core.tensors.ties import off_round

# Diagnosis of quantised depth: the least share of equal neighbours; among unequal neighbours, the
# least share within one surface, and the least share of these with a step that matters; and the
# bounds on the number of different radii.
_ALIKE, _SMALL, _MATTERS = 0.5, 0.5, 0.03
_FEW, _MANY = 32, 256
# Least and greatest step in px between terraces, and the greatest slope of a terrace beside a step,
# as a share of the step.
_MINIMUM, _MAXIMUM, _FLAT = off_round(0.2), off_round(1.0), off_round(0.1)
# Px over which a step is spread to each side.
_WIDE = 4
# Px around a pixel that decide what it becomes.
AROUND = 2 * _WIDE + 2


def steps_of(sizes: list[Tensor], steepest: float) -> Tensor:
    """The numbers [..., 2, 4] of steps: all, zero, too small to matter, too small for an edge.

    `sizes`: of steps in px from each pixel of a part of a frame, or of each of a batch, to the
    next, down and across: [..., H, W].
    """
    none = torch.zeros(sizes[0].shape[:-2], dtype=torch.long, device=sizes[0].device)
    larger = [
        tally_of(exceeding(size, bound)) if steepest > bound else none
        for size in sizes
        for bound in (0.0, _MINIMUM, _MAXIMUM)
    ]
    counts = torch.tensor([math.prod(size.shape[-2:]) for size in sizes])[:, None].repeat(1, 4)
    counts = counts.to(larger[0].device).repeat(*larger[0].shape, 1, 1)
    counts[..., 1:] -= torch.stack(larger, -1).view(*counts.shape[:-1], 3)
    return counts


def are_few(steps: list[list[float]], signed_radius: Tensor) -> bool:
    """Whether the depth of a frame has few levels.

    `signed_radius`: [H, W] px of the frame.
    """
    for count, same, minimum, small in steps:
        if same <= _ALIKE * count:
            return False
        if small - same <= _SMALL * (count - same) or small - minimum <= _MATTERS * (count - same):
            return False
    dtype = torch.promote_types(signed_radius.dtype, torch.float32)
    parts = [
        _levels(signed_radius[first : end + 1].detach().to(dtype))
        for first, end in bands(signed_radius)
    ]
    different: Tensor = torch.unique(torch.cat(parts))
    return _FEW < len(different) <= _MANY


def _levels(rows: Tensor) -> Tensor:
    """The different radii [n] of pixels in rows [n + 1, W] that equal the next ones.

    They are the levels, but not averages of them on edges.
    """
    across, down = rows.diff(dim=1)[:-1].bool(), rows.diff(dim=0)[:, :-1].bool()
    goes_on = ~(across | down)
    begins = goes_on.clone()  # of equal ones in a row the first alone: to sort them takes long
    begins[:, 1:] &= ~goes_on[:, :-1]
    levels: Tensor = torch.unique(rows[:-1, :-1].flatten()[flat_nonzero(begins)])
    return levels


def without_terraces(signed_radius: Tensor) -> Tensor:
    """Radii [H, W] px with slopes in the place of small steps."""
    r = signed_radius.detach()
    steps = _at_a_step(r, -1) | _at_a_step(r, -2)
    if not bool(steps.any()):
        return signed_radius
    beside = extreme_around(steps, _WIDE - 1, torch.maximum)
    down, across = _smoothed(signed_radius, beside, 0), _smoothed(signed_radius, beside, 1)
    return (_smoothed(down, beside, 1) + _smoothed(across, beside, 0)) / 2  # no axis is the first


def _smoothed(radii: Tensor, beside: Tensor, dim: int) -> Tensor:
    """Radii [H, W] px whose pixels beside steps, [H, W] bool, become means along an axis.

    A mean reaches as far to both sides as the surface goes on: a slope stays as it is.
    """
    # of one surface, each pixel and the next
    within = radii.detach().diff(dim=dim).abs_() <= _MAXIMUM
    goes_on, total = torch.ones_like(beside), radii.clone()
    count = torch.ones_like(beside, dtype=torch.int8)
    for distance in range(1, _WIDE + 1):
        inner = radii.shape[dim] - 2 * distance
        if inner < 1:
            break
        goes_on = goes_on.narrow(dim, 1, inner) & within.narrow(dim, 0, inner)
        goes_on &= within.narrow(dim, 2 * distance - 1, inner)
        pair = radii.narrow(dim, 0, inner) + radii.narrow(dim, 2 * distance, inner)
        total.narrow(dim, distance, inner).add_(torch.where(goes_on, pair, 0.0))
        count.narrow(dim, distance, inner).add_(goes_on, alpha=2)
    return torch.where(beside, total / count, radii)


def _at_a_step(r: Tensor, dim: int) -> Tensor:
    """Whether pixels [H, W] are beside a small step between terraces along an axis."""
    beside = torch.zeros_like(r, dtype=torch.bool)
    before, step, after = steps_beside(r, dim)
    small = (step > _MINIMUM) & (step <= _MAXIMUM) & (torch.maximum(before, after) < _FLAT * step)
    if n := small.shape[dim]:
        for first in (1, 2):
            beside.narrow(dim, first, n).logical_or_(small)
    return beside

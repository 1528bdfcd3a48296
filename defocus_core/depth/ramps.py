"""Soft edges of depth, made steps: estimated depth ramps where one surface ends before another.

Where the radius changes by more than a pixel and a half per pixel, no surface is that steep that
the lens sees as one: it is an edge that the depth map has smoothed. Its pixels would be drawn with
radii between those of both surfaces, sharp where the ramp crosses the focus. Each is given the
radius at the end of the ramp that its own is closer to.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.images.neighbourhoods import halfway, squares_around
from defocus_core.images.sparse_masks import exceeding, places_of

# Slope in px per px, on both sides of a pixel, of a ramp.
STEEP = 1.513
# Px over which the ends of a ramp are looked for.
_WIDEST = 10
# Px around a pixel that decide what it becomes.
AROUND = _WIDEST + 2


def without_ramps(signed_radius: Tensor, steep: float = STEEP) -> Tensor:
    """Radii [H, W] px with steps in the place of ramps.

    A hard edge is as it was, and so is a slope of up to `steep` px per px.
    """
    at = places_of(exceeding(steepness(signed_radius), steep))
    if not len(at):
        return signed_radius
    H, W = signed_radius.shape
    around, index = squares_around(at, (H, W)).flatten(1), at[:, 0] * W + at[:, 1]
    radii = signed_radius.flatten()
    near, far = radii, radii
    for _ in range(_WIDEST):
        near = near.index_copy(0, index, near[around].min(1).values)
        far = far.index_copy(0, index, far[around].max(1).values)
    own, low, high = radii[index], near[index], far[index]
    radii = radii.index_copy(0, index, torch.where(own < halfway(low, high), low, high))
    return radii.reshape(H, W)


def are_steeper(steps: Tensor, dim: int, slope: float) -> bool:
    """Whether `steepness` along an axis that has such steps exceeds a positive slope anywhere."""
    n = steps.shape[dim] - 1
    if n < 1:
        return False
    first, second = steps.narrow(dim, 0, n), steps.narrow(dim, 1, n)
    if float((first * second).amax()) <= slope * slope:  # so one of both is no steeper
        return False
    up, down = torch.minimum(first, second).amax(), torch.maximum(first, second).amin()
    return max(float(up), -float(down)) > slope


def steepness(signed_radius: Tensor) -> Tensor:
    """The slope of the ramps that pixels [H, W] lie on, px per px; not positive elsewhere.

    It is the smaller one of both sides of a pixel, where both go up or both go down, along the
    steeper axis: beside a hard edge there is none.
    """
    r = signed_radius.detach()
    found = torch.zeros_like(r)
    for dim in (-1, -2):
        if r.shape[dim] > 2:
            step = r.diff(dim=dim)
            n = step.shape[dim] - 1
            first, second = step.narrow(dim, 0, n), step.narrow(dim, 1, n)
            inner = found.narrow(dim, 1, n)
            for least in (torch.minimum(first, second), -torch.maximum(first, second)):
                torch.maximum(inner, least, out=inner)
    return found

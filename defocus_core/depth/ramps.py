"""Ramps of depth made steps: estimated depth ramps where one surface ends before another.

Where the radius changes by more than 1.5 px per pixel, the depth map has smoothed an edge: the lens
would not see so steep a surface as one. Pixels of the ramp would be drawn with radii between those
of both surfaces, sharp where the ramp crosses the focus. Each pixel gets the radius at the end of
the ramp that its own radius is closer to.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.images.neighbourhoods import halfway, squares_around
from defocus_core.images.sparse_masks import exceeding, places_of

# Least slope of a ramp in px per px, on both sides of a pixel.
STEEP = 1.513
# Greatest distance in px of the ends of a ramp from its pixels.
_WIDEST = 10
# Px around a pixel that decide what it becomes.
AROUND = _WIDEST + 2


def without_ramps(signed_radius: Tensor, steep: float = STEEP) -> Tensor:
    """Radii [H, W] px with steps in the place of ramps.

    Hard edges and slopes of up to `steep` px per px stay.
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
    """Whether `steepness` along an axis exceeds a positive slope anywhere, from the axis' steps."""
    n = steps.shape[dim] - 1
    if n < 1:
        return False
    first, second = steps.narrow(dim, 0, n), steps.narrow(dim, 1, n)
    if float((first * second).amax()) <= slope * slope:  # so one of each two is not steeper
        return False
    up, down = torch.minimum(first, second).amax(), torch.maximum(first, second).amin()
    return max(float(up), -float(down)) > slope


def steepness(signed_radius: Tensor) -> Tensor:
    """The slope of ramps at pixels [H, W] in px per px; 0 where there is no ramp.

    The lesser slope of both sides of a pixel, where both go up or both go down, along the steeper
    axis: 0 beside a hard edge.
    """
    r = signed_radius.detach()
    slope = torch.zeros_like(r)
    for dim in (-1, -2):
        if r.shape[dim] > 2:
            step = r.diff(dim=dim)
            n = step.shape[dim] - 1
            first, second = step.narrow(dim, 0, n), step.narrow(dim, 1, n)
            inner = slope.narrow(dim, 1, n)
            for least in (torch.minimum(first, second), -torch.maximum(first, second)):
                torch.maximum(inner, least, out=inner)
    return slope

"""Profiles of colour across silhouettes of depth, and the displacement that they show.

Deep in both surfaces their colours are known; between them lies the place where the likeness to one
ends and the likeness to the other begins. Each displacement costs the pixels that it would leave on
the wrong side.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.distance_scale import DistanceScale
from defocus_core.tensors.neighbourhoods import halfway, squares_around
from defocus_core.tensors.sparse_masks import exceeding

# Greatest displacement in px; depth in px at which the colour of a surface is sampled at most.
FARTHEST, _DEEPEST = 12, 15
# Reach of a profile across a silhouette, in px to both sides.
REACH = 2 * _DEEPEST - 2
# Half width in px of the square around a pixel in which the normal is found, and its deviation.
NORMAL, _NORMAL_DEVIATION = 3, 1.5
# Least deviation of the colours of a surface, as a share of the difference of both surfaces.
_DEVIATION = 0.2
# Difference of colours, as a share of their sum, from which a profile counts, and counts in full;
# cost in px at which it counts 1/e, and greatest cost of a displacement, as a multiple of this.
_CONTRAST, _FULL, _DOUBT, _MOST = 0.05, 0.2, 1.5, 4


class Silhouette(NamedTuple):
    """The pixels on the nearer side of edges.

    Attributes:
        at: [n, 2] rows and columns.
        far: [n] number of the farthest pixel beside each.
        normal: [2, n] direction (y, x) to the farther surface.
    """

    at: Tensor
    far: Tensor
    normal: Tensor


def edges_of(radii: Tensor, step: float, scale: DistanceScale | None) -> Tensor:
    """The pixels [H, W] beside which the radius is greater by more than a step.

    Given a scale of distance, so is the distance: few levels of distance are many px of radius.
    """
    edges = torch.zeros(radii.shape, dtype=torch.bool, device=radii.device)
    for dim in (0, 1):
        rise = _rise(radii, dim, scale)
        edges.narrow(dim, 0, rise.shape[dim]).logical_or_(exceeding(rise, step))
        edges.narrow(dim, 1, rise.shape[dim]).logical_or_(exceeding(-rise, step))
    return edges


def _rise(radii: Tensor, dim: int, scale: DistanceScale | None) -> Tensor:
    """The rise in px from each pixel to the next, of radius or of distance, whichever is less."""
    rise = radii.diff(dim=dim)
    if scale is None:
        return rise
    of_distance = scale.of(radii).diff(dim=dim)
    return torch.where(of_distance.abs() < rise.abs(), of_distance, rise)


def silhouette_at(at: Tensor, radii: Tensor) -> Silhouette:
    """The silhouette at pixels [n, 2] of radii [H, W]."""
    size, flat = (radii.shape[0], radii.shape[1]), radii.flatten()
    beside = squares_around(at, size).flatten(1)[:, [1, 3, 5, 7]]  # along the axes
    most, which = flat[beside].max(1)
    far = beside.gather(1, which[:, None])[:, 0]
    own = flat[at[:, 0] * size[1] + at[:, 1]]
    offset = torch.arange(-NORMAL, NORMAL + 1, device=at.device, dtype=torch.float64)
    y, x = torch.meshgrid(offset, offset, indexing="ij")
    weight = torch.exp((y * y + x * x) / (-2 * _NORMAL_DEVIATION**2))
    farther = flat[squares_around(at, size, NORMAL)] > halfway(own, most)[:, None, None]
    normal = torch.stack([(farther * (weight * axis)).sum((1, 2)) for axis in (y, x)])
    return Silhouette(at, far, normal / normal.norm(dim=0).clamp(min=1e-6))


def displacement_costs(
    silhouette: Silhouette, radii: Tensor, pixels: Tensor
) -> tuple[Tensor, Tensor]:
    """The cost in px [n, 2 * FARTHEST + 1] of each displacement, and the trust [n] in them."""
    at, far, normal = silhouette
    (H, W), flat = radii.shape, radii.flatten()
    along = torch.arange(-REACH, REACH + 1, device=at.device).to(normal.dtype)
    # from the pixel on, so that it rounds alike anywhere in a frame
    y, x = (at[:, d, None] + (normal[d, :, None] * along).round().long() for d in (0, 1))
    inside = (y >= 0) & (y <= H - 1) & (x >= 0) & (x <= W - 1)
    place = y.clamp(0, H - 1) * W + x.clamp(0, W - 1)
    border = halfway(flat[at[:, 0] * W + at[:, 1]], flat[far])[:, None]
    is_near = flat[place] < border
    inwards = (is_near & inside)[:, : REACH + 1].flip(1).long().cumprod(1).sum(1)
    outwards = (~is_near & inside)[:, REACH + 1 :].long().cumprod(1).sum(1)
    # the middle of a thin surface is as deep as one can get
    near_depth, far_depth = (
        (count.to(normal.dtype) / 2).clamp(max=_DEEPEST) for count in (inwards, outwards)
    )
    dtype = torch.float64  # whatever the precision of a picture, its edges are the same
    color = pixels.flatten(1)[:, place].to(dtype).nan_to_num().clamp(min=0)
    # squares of the brightest light would be infinite
    color /= color.amax((0, 2), keepdim=True).clamp(min=torch.finfo(dtype).tiny)

    def of_surface(first: Tensor, last: Tensor) -> tuple[Tensor, Tensor]:
        """Mean colour [C, n] and variance [n] from one place on the profile to another."""
        within = ((along >= first[:, None]) & (along <= last[:, None])).to(dtype)
        count = within.sum(1).clamp(min=1)
        mean = (color * within).sum(2) / count
        return mean, ((color - mean[:, :, None]).square().sum(0) * within).sum(1) / count

    near, near_variance = of_surface(-near_depth - 1.5, 1.5 - near_depth)
    beyond, far_variance = of_surface(far_depth - 1, far_depth + 2)
    apart, least = (near - beyond).square().sum(0), torch.finfo(dtype).tiny

    def likeness(mean: Tensor, variance: Tensor) -> Tensor:
        distance = (color - mean[:, :, None]).square().sum(0)
        spread_of = (variance + _DEVIATION**2 * apart).clamp(min=least)
        return torch.exp(distance / (-2 * spread_of[:, None]))

    trusts = [apart / (apart + 4 * v).clamp(min=least) for v in (near_variance, far_variance)]
    whole = (trusts[0] + trusts[1]).clamp(min=1e-6)
    to_near = trusts[0][:, None] * likeness(near, near_variance)
    to_far = trusts[1][:, None] * (1 - likeness(beyond, far_variance))
    nearness = (to_near + to_far) / whole[:, None]  # [n, 2 * REACH + 1] of each px, in [0, 1]
    valid = ((along >= -near_depth[:, None]) & (along <= far_depth[:, None] + 0.5)).to(dtype)
    # to the near side of the edge what is unlike costs, on the far side what is like
    below = (valid * (1 - 2 * nearness)).cumsum(1) + (valid * nearness).sum(1, keepdim=True)
    costs = below[:, REACH - FARTHEST : REACH + FARTHEST + 1].flip(1)
    by = torch.arange(-FARTHEST, FARTHEST + 1, device=at.device)
    possible = (by <= near_depth[:, None]) & (-by <= far_depth[:, None])
    costs = torch.where(possible, costs.clamp(max=_MOST * _DOUBT), _MOST * _DOUBT)
    total = (near + beyond).sum(0).clamp(min=least)
    contrast = (near - beyond).abs().sum(0) / total * torch.maximum(*trusts)
    trust = ((contrast - _CONTRAST) / (_FULL - _CONTRAST)).clamp(0, 1)
    lowest = costs.amin(1)
    clear = (lowest < 2 * _DOUBT) & (inwards >= 2) & (outwards >= 2)
    return costs, trust * torch.exp(lowest / -_DOUBT) * clear

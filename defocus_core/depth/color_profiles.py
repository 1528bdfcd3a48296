"""Profiles of colour across silhouettes of depth, and the displacement that they show.

Some px within both surfaces their colours are known, as normal distributions along the silhouette;
between them lies the place where colours of one end and those of the other begin. Each displacement
costs the pixels that it would leave on the wrong side.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.distance_scale import DistanceScale
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.neighbourhoods import extreme_around, halfway, squares_around
from defocus_core.tensors.sparse_masks import exceeding

# Greatest displacement in px; greatest depth in px from which on the colours of a surface are
# sampled, and over how many px.
FARTHEST, _DEEPEST, _SPAN = 8, 6, 5
# Reach of a profile across a silhouette, in px to both sides.
REACH = 12
# Half width in px of the square around a pixel in which the normal is found, and its deviation.
NORMAL, _NORMAL_DEVIATION = 3, 1.5
# Least step of an edge, as a share of the greatest one within FARTHEST px: less is the foot of a
# ramp.
_FOOT = 0.1251
# Light beyond which sums of it would be infinite.
_BRIGHTEST = 1e30
# Least deviation of the colours of a surface, as a share of their mean; how many times wider they
# vary than the few samples of one profile do.
_DEVIATION, _WIDER = 0.04, 4.8
# Logarithm of the density of other colours on a surface, in least deviations; by how much it is
# greater on the nearer one, whose rims differ, while the farther one goes on unchanged behind it.
_OTHER, _RIM = -13.66, 2.0
# Difference of logarithms that is sure; and greatest cost of a displacement in px.
_SURE, _MAXIMUM = 4.0, 6.0


class Silhouette(NamedTuple):
    """The pixels on the nearer side of edges."""

    at: Tensor  # [n, 2] rows and columns
    far: Tensor  # [n] number of the farthest pixel beside each
    normal: Tensor  # [2, n] direction (y, x) to the farther surface


def edges_of(radii: Tensor, step: float | Tensor, scale: DistanceScale | None) -> Tensor:
    """The pixels [..., H, W] beside which the radius is greater by more than a step.

    Given a scale of distance, so is the distance: few levels of distance are many px of radius.
    Of a batch the step is a number for each picture, [B, 1, 1].
    """
    height = torch.zeros_like(radii)
    for dim in (-2, -1):
        rise = _rise(radii, dim, scale)
        for first, sign in ((0, 1), (1, -1)):
            part = height.narrow(dim, first, rise.shape[dim])
            torch.maximum(part, sign * rise, out=part)
    edges = exceeding(height, step)
    if bool(edges.any()):
        edges &= height > _FOOT * extreme_around(height, FARTHEST, torch.maximum)
    return edges


def _rise(radii: Tensor, dim: int, scale: DistanceScale | None) -> Tensor:
    """The rise in px from each pixel to the next, of radius or of distance, whichever is less."""
    rise = radii.diff(dim=dim)
    if scale is None:
        return rise
    of_distance = scale.of(radii).diff(dim=dim)
    return torch.where(of_distance.abs() < rise.abs(), of_distance, rise)


def silhouette_at(at: Tensor, radii: Tensor) -> Silhouette:
    """The silhouette at pixels [n, 2] of radii [..., H, W]."""
    size, flat = (radii.shape[-2], radii.shape[-1]), radii.flatten()
    beside = squares_around(at, size).flatten(1)[:, [1, 3, 5, 7]]  # along the axes
    maximum, which = flat[beside].max(1)
    far = beside.gather(1, which[:, None])[:, 0]
    own = flat[at[:, 0] * size[1] + at[:, 1]]
    offset = torch.arange(-NORMAL, NORMAL + 1, device=at.device, dtype=torch.float64)
    y, x = torch.meshgrid(offset, offset, indexing="ij")
    weight = torch.exp((y * y + x * x) / (-2 * _NORMAL_DEVIATION**2))
    farther = flat[squares_around(at, size, NORMAL)] > halfway(own, maximum)[:, None, None]
    normal = torch.stack([(farther * (weight * axis)).sum((1, 2)) for axis in (y, x)])
    return Silhouette(at, far, normal / normal.norm(dim=0).clamp(min=1e-6))


class Profiles(NamedTuple):
    """Lines of pixels across silhouettes, from REACH px within the nearer surface to REACH out."""

    positions: Tensor  # [n, 2 * REACH + 1] numbers of pixels
    inwards: Tensor  # [n] number of px that go on without a gap within the nearer surface
    outwards: Tensor  # [n] number of px that go on without a gap beyond it

    @property
    def is_seen(self) -> Tensor:
        """[n] bool, whether both surfaces are seen beside the silhouette."""
        return (self.inwards >= 2) & (self.outwards >= 2)

    def depths(self) -> tuple[Tensor, Tensor]:
        """Px [n] to the nearer and the farther surface, where their colours are sampled."""
        # the middle of a thin surface is as deep as one can get
        near, far = (
            (count.double() / 2).clamp(max=_DEEPEST) for count in (self.inwards, self.outwards)
        )
        return near, far


def profiles_of(silhouette: Silhouette, radii: Tensor) -> Profiles:
    """The profiles across a silhouette of radii [..., H, W]."""
    at, far, normal = silhouette
    (H, W), flat = radii.shape[-2:], radii.flatten()
    row = at[:, :1].remainder(H)
    y, x = (
        start + (normal[d, :, None] * _along(at)).round().long()
        for d, start in enumerate((row, at[:, 1:]))
    )
    inside = (y >= 0) & (y <= H - 1) & (x >= 0) & (x <= W - 1)
    index = (at[:, :1] - row + y.clamp(0, H - 1)) * W + x.clamp(0, W - 1)
    is_near = flat[index] < halfway(flat[at[:, 0] * W + at[:, 1]], flat[far])[:, None]
    inwards = (is_near & inside)[:, : REACH + 1].flip(1).long().cumprod(1).sum(1)
    outwards = (~is_near & inside)[:, REACH + 1 :].long().cumprod(1).sum(1)
    return Profiles(index, inwards, outwards)


def color_moments(profiles: Profiles, pixels: Tensor) -> Tensor:
    """Sums over the samples of both surfaces, [n, 2 * (1 + C + C²)]: of 1, colour, and products.

    Averaged along a silhouette they say how the colours of both surfaces are distributed there.
    """
    color, along = _colors(pixels, profiles.positions), _along(pixels)  # [C, n, 2 * REACH + 1]
    moments = []
    counts = (profiles.inwards, profiles.outwards)
    for side, depth, count in zip((-1, 1), profiles.depths(), counts, strict=True):
        deepest = torch.minimum(depth + _SPAN, torch.maximum(count - 1.0, depth))
        within = (side * along >= depth[:, None] - 0.5) & (side * along <= deepest[:, None] + 0.5)
        samples = color * within
        products = torch.einsum("cnt,dnt->ncd", samples, color).flatten(1)
        moments += [within.double().sum(1, keepdim=True), samples.sum(2).T, products]
    return torch.cat(moments, 1)


def displacement_costs(
    profiles: Profiles, moments: Tensor, pixels: Tensor, *, alone: bool, rims: bool
) -> Tensor:
    """The cost in px [n, 2 * FARTHEST + 1] of each displacement, 0 for the best one.

    Each pixel that a displacement leaves on the wrong side costs up to 1, by how much more likely
    its colour is on the other side; where the colours of both surfaces are alike, nothing.

    `pixels`: [C, H, W] linear.
    """
    color, along, C = _colors(pixels, profiles.positions), _along(pixels), len(pixels)
    sides = torch.split(moments, 1 + C + C * C, 1)
    means = [side[:, 1 : 1 + C] / side[:, :1].clamp(min=1e-9) for side in sides]
    scale = ((means[0] + means[1]) / 2).amax(1).clamp(min=torch.finfo(color.dtype).tiny ** 0.25)
    likely = []
    for side, mean in zip(sides, means, strict=True):
        square = side[:, 1 + C :].view(-1, C, C) / side[:, :1, None].clamp(min=1e-9)
        spread = square - mean[:, :, None] * mean[:, None, :]
        spread = spread * (_WIDER if alone else 1.0) / scale.square()[:, None, None]
        spread = spread + _DEVIATION**2 * torch.eye(C, dtype=color.dtype, device=color.device)
        root = torch.linalg.cholesky_ex(spread).L
        off = (color.transpose(0, 1) - mean[:, :, None]) / scale[:, None, None]  # [n, C, ...]
        off = torch.linalg.solve_triangular(root, off, upper=False)
        # in least deviations, so that a channel without light changes nothing
        volume = (root.diagonal(dim1=1, dim2=2) / _DEVIATION).log().sum(1, keepdim=True)
        likely.append(off.square().sum(1) / -2 - volume)
    near, far = sent([_OTHER + rims * _RIM, _OTHER], color)
    nearer = torch.logaddexp(likely[0], near) - torch.logaddexp(likely[1], far)
    near_depth, far_depth = profiles.depths()
    valid = (along >= -near_depth[:, None]) & (along <= far_depth[:, None] + 0.5)
    nearer = (nearer / _SURE).nan_to_num().clamp(-1, 1) * valid  # [n, 2 * REACH + 1] of each px
    costs = -nearer.cumsum(1)[:, REACH - FARTHEST : REACH + FARTHEST + 1].flip(1)
    by = torch.arange(-FARTHEST, FARTHEST + 1, device=costs.device)
    possible = (by <= near_depth[:, None]) & (-by <= far_depth[:, None])
    costs = costs - torch.where(possible, costs, torch.inf).amin(1, keepdim=True)
    return torch.where(possible, costs.clamp(max=_MAXIMUM), _MAXIMUM)


def _along(like: Tensor) -> Tensor:
    """Px [2 * REACH + 1] from a silhouette to the pixels of a profile."""
    return torch.arange(-REACH, REACH + 1, device=like.device, dtype=torch.float64)


def _colors(pixels: Tensor, index: Tensor) -> Tensor:
    """Square roots of colours [C, ...] of pixels, in double precision.

    Whatever the precision of a picture, its edges are the same.
    """
    return pixels.flatten(1)[:, index].double().nan_to_num().clamp(0, _BRIGHTEST).sqrt()

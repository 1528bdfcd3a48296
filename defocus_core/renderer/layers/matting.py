"""Matting of mixed pixels: colours on a depth edge taken apart into two surfaces.

An anti-aliased pixel holds α of the nearer surface and 1 - α of the farther one, and the depth of
only one of them. Left as they are, such pixels draw ghost lines: the nearer colour stays behind,
sharp, where the nearer surface is blurred away. They are taken apart in the way of Bayesian matting
(Chuang et al. 2001): both surfaces have a mean and a variance beside the edge, a pixel is expected
to be whole, and the most probable α and colours that give it are kept. If a wire is so thin that
all of its pixels are on an edge, they stay as they are; the pixels beside it lose its colour.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.edge_surfaces import (
    AT_ONCE,
    BYTES_EACH,
    EDGE,
    MIDDLE,
    Around,
    Side,
    around_edge,
    closeness,
    fraction_deviation,
    side_of,
)
from defocus_core.tensors.device_plan import pieces
from defocus_core.tensors.neighbourhoods import extreme_around, halfway
from defocus_core.tensors.sparse_masks import exceeding, positions_of

# Difference of radii of two neighbours, in px, beyond which one hides the other; less is a slope.
_STEP = 1.013
# Standard deviation of the coverage of a pixel, before its colour is known, from a whole surface:
# where depth is that of a renderer, and where its edges were soft or averaged.
_EXPECTED, _UNCERTAIN = 0.05, 0.2
# Deviation of coverage up to which a pixel stays whole; a greater one d counts as d - _CLEAR² / d.
_CLEAR = 0.1


class Fringe(NamedTuple):
    """Parts of nearer surfaces in pixels whose depth is that of a farther one."""

    # [n, 2] rows and columns; rows are counted on from one picture of a batch to the next
    at: Tensor
    layer: Tensor  # [n, C + 1], colour premultiplied by coverage, then coverage
    signed_radius: Tensor  # [n] px


class Unmixed(NamedTuple):
    """A picture in which every pixel has the colour of its own surface."""

    color: Tensor  # [C, H, W], not premultiplied by coverage
    # [1, H, W], the share of each pixel that its own surface covers, if it is the nearer one of
    # two; the surface behind shows through the rest. None if all are whole
    coverage: Tensor | None
    fringe: Fringe  # the parts of nearer surfaces in pixels of farther ones


def unmixed(image: Tensor, signed_radius: Tensor, *, uncertain: bool = False) -> Unmixed:
    """Take mixed pixels apart.

    A pixel stays as it is if the farther surface is nowhere seen alone beside it. So does a pixel
    of a nearer surface that is nowhere seen alone, like a wire two px wide.

    `image`: [C, ..., H, W] linear; `signed_radius`: [..., H, W] px.
    """
    r = signed_radius.detach()
    nearest, farthest = (extreme_around(r, 1, end) for end in (torch.minimum, torch.maximum))
    edge = exceeding(farthest - nearest, EDGE)
    positions = positions_of(edge)
    if not len(positions):
        return whole(image, signed_radius)
    border, deviation = halfway(nearest, farthest), _UNCERTAIN if uncertain else _EXPECTED
    chunks = [
        _taken_apart(image, signed_radius, edge, border, at, deviation)
        for at in torch.split(positions, pieces(positions.device, AT_ONCE, BYTES_EACH))
    ]
    at, own, fraction, fringe_at, fringe, fringe_radius = map(torch.cat, zip(*chunks, strict=True))
    index = at[:, 0] * edge.shape[-1] + at[:, 1]
    color = image.flatten(1).index_copy(1, index, own.T).reshape(image.shape)
    coverage = torch.ones_like(image[:1]).flatten().index_copy(0, index, fraction)
    coverage = coverage.reshape(image[:1].shape)
    return Unmixed(color, coverage, Fringe(fringe_at, fringe, fringe_radius))


def whole(image: Tensor, signed_radius: Tensor) -> Unmixed:
    """A picture [C, ..., H, W] of radii [..., H, W] without mixed pixels."""
    nothing = image.new_zeros(0, len(image) + 1)
    nowhere = torch.zeros((0, 2), dtype=torch.long, device=image.device)
    return Unmixed(image, None, Fringe(nowhere, nothing, signed_radius.flatten()[:0]))


def _taken_apart(
    image: Tensor,
    signed_radius: Tensor,
    edge: Tensor,
    border: Tensor,
    at: Tensor,
    deviation: float,
) -> tuple[Tensor, ...]:
    """Take apart the mixed ones of the pixels at [n, 2], of coverages with a standard deviation."""
    around = around_edge(image, signed_radius, edge, border, at)
    own = side_of(around, around.nearness * around.own())
    unlike = _color_deviation(around.color, own) > _min_deviation(deviation)
    mixed = torch.nonzero(own.known & unlike)[:, 0]
    around = around.select(mixed)
    stepped = _has_step(around.radii.detach())
    at, own = at.index_select(0, mixed), Side(*(each.index_select(0, mixed) for each in own))
    own_near, color = around.is_near[MIDDLE], around.color
    other = side_of(around, around.nearness * (around.is_near != own_near))
    thin = own.known & ~own_near & ~other.known
    other = _with_thin(own, other, around, thin)
    near, far = (
        Side(*(_chosen(side, *pair) for pair in zip(own, other, strict=True)))
        for side in (own_near, ~own_near)
    )
    alpha = _mixture(color, near, far, own_near.to(color.dtype), deviation)
    alpha = torch.where(own_near, alpha.clamp(0.5, 1), alpha.clamp(0, 0.5))[:, None]
    weights = (alpha * near.variance, (1 - alpha) * far.variance)
    residual = (color - alpha * near.mean - (1 - alpha) * far.mean) / (
        alpha * weights[0] + (1 - alpha) * weights[1]
    )
    near_color, far_color = (
        _within(side, color, side.mean + residual * weight)
        for side, weight in zip((near, far), weights, strict=True)
    )
    # the part clipped off a colour goes to the other, within its range unless α was clipped, too
    limits = [torch.where(alpha == 0.5, color, own_limit) for own_limit in (far_color, near_color)]
    far_color = _within(far, limits[0], _rest(color, near_color, alpha))
    near_color = _within(near, limits[1], _rest(color, far_color, 1 - alpha))
    near_color = torch.where(alpha == 1, color, near_color)
    far_color = torch.where(alpha == 0, color, far_color)
    known = near.known & far.known & stepped
    own_color = torch.where(own_near[:, None], near_color, far_color)
    coverage = torch.where(own_near, alpha[:, 0], 1.0)
    behind = known & ~own_near & (alpha.detach()[:, 0] > 0)
    fringe = torch.cat([near_color, torch.ones_like(alpha)], 1) * alpha
    both = (at, own_color, coverage), (at, fringe, near.signed_radius)
    masks = torch.nonzero(known)[:, 0], torch.nonzero(behind)[:, 0]
    return tuple(x.index_select(0, i) for of, i in zip(both, masks, strict=True) for x in of)


def _has_step(radii: Tensor) -> Tensor:
    """Whether the inner nine of 25 radii [25, n] px hold a step between two surfaces: [n] bool."""
    square = radii.reshape(5, 5, -1)[1:4, 1:4]
    steps = (square.diff(dim=dim).abs().amax((0, 1)) for dim in (0, 1))
    return torch.maximum(*steps) > _STEP


def _with_thin(far: Side, near: Side, around: Around, thin: Tensor) -> Side:
    """The near side; where it is thin, all of its pixels are on an edge and give its colour.

    They may be mixed, too, but on the same line between two colours as the pixels beside them: both
    hold the same colour beside that of the far side.

    `thin`: [n] bool, where the near side is thin.
    """
    thin_index = torch.nonzero(thin)[:, 0]
    if not len(thin_index):
        return near
    thin_around = around.select(thin_index)
    own = side_of(thin_around, closeness(thin_around.radii) * thin_around.is_near)._replace(
        variance=far.variance[thin_index]
    )
    return Side(
        *(each.index_copy(0, thin_index, other) for each, other in zip(near, own, strict=True))
    )


def _color_deviation(color: Tensor, side: Side) -> Tensor:
    """Squared deviations of colours [n, C] from a surface over its variance, summed: [n]."""
    off = (color - side.mean).detach()
    return (off * off / side.variance.detach()).sum(1)


def _min_deviation(deviation: float) -> float:
    """Sum of squared deviations from its own surface up to which no pixel is clearly mixed.

    With evidence e its coverage deviates by d √e / (1 / deviation² + e) at most; d² is up to twice
    the sum.
    """
    return 2 * (_CLEAR / deviation) ** 2 * 0.99


def _chosen(first: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """For each pixel a where `first` [n] holds, else b; both [n] or [n, C]."""
    return torch.where(first if a.dim() == 1 else first[:, None], a, b)


def _rest(mixed: Tensor, color: Tensor, fraction: Tensor) -> Tensor:
    """The second colour of mixed pixels, if the first one has a share [n, 1]."""
    return (mixed - fraction * color) / torch.where(fraction < 1, 1 - fraction, 1.0)


def _within(side: Side, other: Tensor, color: Tensor) -> Tensor:
    """Clip a colour to two deviations around its surface's mean; `other` is never clipped."""
    reach = 2 * side.variance.sqrt()
    color = torch.maximum(color, torch.minimum(side.mean - reach, other))
    color = torch.minimum(color, torch.maximum(side.mean + reach, other))
    return torch.maximum(color, other.clamp(max=0))


def _mixture(color: Tensor, near: Side, far: Side, own: Tensor, deviation: float) -> Tensor:
    """The most probable α [n] of colours [n, C] = α near + (1 - α) far, if `own` [n] is expected.

    Small deviations from `own` count as none: only clearly mixed pixels are taken apart.
    """
    by = fraction_deviation(color, near, far, own, deviation)
    clear = by.abs() > _CLEAR
    return own + torch.where(clear, by - _CLEAR**2 / torch.where(clear, by, 1.0), 0.0)

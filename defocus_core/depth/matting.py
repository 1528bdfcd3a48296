"""Matting: the two surfaces of a pixel on a depth edge, and the coverage of the nearer one.

A pixel on an edge holds α of the nearer surface and 1 - α of the farther one, C = α F + (1 - α) B,
whichever of the two its depth names. F and B are the colours of both surfaces beside the edge, with
a mean and a variance each (Bayesian matting, Chuang et al. 2001); α is the most probable coverage,
given its colour and the coverage that the depth of the pixels around it lets expect.
"""

from __future__ import annotations

import os
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.tensors.device_plan import pieces
from defocus_core.tensors.neighbourhoods import extreme_around, halfway, squares_around
from defocus_core.tensors.sparse_masks import exceeding, positions_of

# A pixel is on an edge if its radius and those of its neighbours span more than this, in px.
EDGE = 1.513
# Half width in px of the square around a pixel from which both surfaces are estimated.
AROUND = int(os.environ.get("X_AROUND", 3))
_MIDDLE = (2 * AROUND + 1) ** 2 // 2
# Least standard deviation of the colours of a surface, as a share of their mean, and as a share of
# the brightest channel: less may be rounding.
_MIN_DEVIATION, _ROUNDING = 0.01, 1e-4
# Standard deviation of the coverage of a pixel from the expected one, before its colour is known,
_EXPECTED = float(os.environ.get("X_EXP", 0.2))
_BLUR = float(os.environ.get("X_BLUR", 0.6))
_PRIOR = os.environ.get("X_PRIOR", "soft")
_CLEAR = float(os.environ.get("X_CLEAR", 0.1))
_MISFIT = float(os.environ.get("X_MIS", 1))
_FALL = float(os.environ.get("X_FALL", 4))
# Pixels examined at once on a CPU, and bytes that each takes elsewhere: bounds memory.
_AT_ONCE, _BYTES_EACH = 1 << 12, 1 << 12
# Coverage below which, or short of 1 by which, a pixel counts as whole.
_WHOLE = 0.004


class Fringe(NamedTuple):
    at: Tensor
    layer: Tensor
    signed_radius: Tensor


class Unmixed(NamedTuple):
    color: Tensor
    coverage: Tensor | None
    fringe: Fringe


class _Side(NamedTuple):
    mean: Tensor
    variance: Tensor
    signed_radius: Tensor
    known: Tensor


def unmixed(image: Tensor, signed_radius: Tensor, *, uncertain: bool = False) -> Unmixed:
    r = signed_radius.detach()
    nearest, farthest = (extreme_around(r, 1, end) for end in (torch.minimum, torch.maximum))
    edge = exceeding(farthest - nearest, EDGE)
    positions = positions_of(edge)
    if not len(positions):
        return whole(image, signed_radius)
    border = halfway(nearest, farthest)
    chunks = [
        _taken_apart(image, signed_radius, edge, border, at, uncertain)
        for at in torch.split(positions, pieces(positions.device, _AT_ONCE, _BYTES_EACH))
    ]
    at, own, fraction, fringe_at, fringe, fringe_radius = map(torch.cat, zip(*chunks, strict=True))
    index = at[:, 0] * edge.shape[-1] + at[:, 1]
    color = image.flatten(1).index_copy(1, index, own.T).reshape(image.shape)
    coverage = torch.ones_like(image[:1]).flatten().index_copy(0, index, fraction)
    coverage = coverage.reshape(image[:1].shape)
    return Unmixed(color, coverage, Fringe(fringe_at, fringe, fringe_radius))


def whole(image: Tensor, signed_radius: Tensor) -> Unmixed:
    nothing = image.new_zeros(0, len(image) + 1)
    nowhere = torch.zeros((0, 2), dtype=torch.long, device=image.device)
    return Unmixed(image, None, Fringe(nowhere, nothing, signed_radius.flatten()[:0]))


def _closeness(like: Tensor, deviation2: float) -> Tensor:
    offset = torch.arange(-AROUND, AROUND + 1, device=like.device)
    squares = (offset * offset + (offset * offset)[:, None]).flatten()
    return torch.exp(squares.to(like.dtype) / (-2 * deviation2))[:, None]


def _side_of(colors: Tensor, radii: Tensor, weight: Tensor, floor: Tensor | None = None) -> _Side:
    total = weight.sum(0)
    fraction = weight / torch.where(total > 0, total, 1.0)
    mean, radius = (colors * fraction).sum(1), (radii * fraction).sum(0)
    off = colors - mean[:, None]
    spread = (off * off * fraction).sum(1)
    brightest = torch.maximum(mean, colors[:, _MIDDLE]).amax(0).clamp(min=0)
    minimum = torch.maximum(_MIN_DEVIATION * mean, _ROUNDING * brightest)
    variance = spread + minimum * minimum + torch.finfo(mean.dtype).tiny ** 0.5
    return _Side(mean.T, variance.T, radius, total > 0)


def _taken_apart(image, signed_radius, edge, border, at, uncertain):
    size = edge.shape[-2], edge.shape[-1]
    position = squares_around(at, size, AROUND).flatten(1).T.contiguous()
    spots = position.flatten()
    radii, on_edge = (
        x.flatten().index_select(0, spots).reshape(position.shape) for x in (signed_radius, edge)
    )
    number = at[:, 0] * size[1] + at[:, 1]
    is_near = radii.detach() < border.flatten().index_select(0, number)
    colors = image.flatten(1).index_select(1, spots).reshape(len(image), *position.shape)
    own_near = is_near[_MIDDLE]
    alike = ((radii - radii[_MIDDLE]).detach().abs() <= EDGE) | (is_near != own_near)
    weight = _closeness(image, 2.0) * alike
    near, far = _sides(colors, radii, weight, is_near, on_edge)
    color = colors[:, _MIDDLE].T
    if _PRIOR == "soft":
        nearby = _closeness(image, _BLUR**2)
        expected = (nearby * is_near).sum(0) / nearby.sum()
    else:
        expected = own_near.to(color.dtype)
    alpha = _mixture(color, near, far, expected, 0.2 if uncertain and _PRIOR != "soft" else _EXPECTED)[:, None]
    weights = (alpha * near.variance, (1 - alpha) * far.variance)
    residual = (color - alpha * near.mean - (1 - alpha) * far.mean) / (
        alpha * weights[0] + (1 - alpha) * weights[1]
    )
    near_color, far_color = (
        _within(side, color, side.mean + residual * w)
        for side, w in zip((near, far), weights, strict=True)
    )
    far_color = _within(far, far_color, _rest(color, near_color, alpha))
    near_color = _within(near, near_color, _rest(color, far_color, 1 - alpha))
    near_color = torch.where(alpha == 1, color, near_color)
    far_color = torch.where(alpha == 0, color, far_color)
    radii9 = radii.detach().reshape(2 * AROUND + 1, 2 * AROUND + 1, -1)[AROUND - 1 : AROUND + 2, AROUND - 1 : AROUND + 2]
    stepped = torch.maximum(*(radii9.diff(dim=d).abs().amax((0, 1)) for d in (0, 1))) > 1.013
    known = near.known & far.known & stepped
    own_color = torch.where(own_near[:, None], near_color, far_color)
    coverage = torch.where(own_near, alpha[:, 0], 1.0)
    behind = known & ~own_near & (alpha.detach()[:, 0] > 0)
    fringe = torch.cat([near_color, torch.ones_like(alpha)], 1) * alpha
    both = (at, own_color, coverage), (at, fringe, near.signed_radius)
    masks = torch.nonzero(known)[:, 0], torch.nonzero(behind)[:, 0]
    return tuple(x.index_select(0, i) for of, i in zip(both, masks, strict=True) for x in of)


def _sides(colors, radii, weight, is_near, on_edge):
    inner = weight * ~on_edge
    near, far = (_side_of(colors, radii, inner * side) for side in (is_near, ~is_near))
    sides = []
    for own, other, mask in ((near, far, is_near), (far, near, ~is_near)):
        lacks = torch.nonzero(~own.known & other.known)[:, 0]
        if len(lacks):
            c, w = colors[:, :, lacks], (weight * mask)[:, lacks]
            off = c.detach() - other.mean.detach()[lacks].T[:, None]
            off = (off * off).sum(0) * (w > 0)
            w = w * (off / off.amax(0).clamp(min=torch.finfo(off.dtype).tiny)) ** _FALL
            thin = _side_of(c, radii[:, lacks], w)._replace(variance=other.variance[lacks])
            own = _Side(*(each.index_copy(0, lacks, t) for each, t in zip(own, thin, strict=True)))
        sides.append(own)
    return sides


def _rest(mixed: Tensor, color: Tensor, fraction: Tensor) -> Tensor:
    return (mixed - fraction * color) / torch.where(fraction < 1, 1 - fraction, 1.0)


def _within(side: _Side, other: Tensor, color: Tensor) -> Tensor:
    reach = 2 * side.variance.sqrt()
    color = torch.maximum(color, torch.minimum(side.mean - reach, other))
    color = torch.minimum(color, torch.maximum(side.mean + reach, other))
    return torch.maximum(color, other.clamp(max=0))


def _mixture(color, near, far, expected, deviation):
    variance = (near.variance + far.variance) / 2
    apart = near.mean - far.mean
    evidence = (apart * apart / variance).sum(1)
    observed = (apart * (color - far.mean) / variance).sum(1)
    if _MISFIT:
        best = (observed / torch.where(evidence > 0, evidence, 1.0)).clamp(0, 1)[:, None]
        off = color - far.mean - best * apart
        misfit = (off * off / (best * near.variance + (1 - best) * far.variance)).mean(1)
        doubt = 1 / (1 + _MISFIT * misfit)
        evidence, observed = evidence * doubt, observed * doubt
    by = (observed - expected * evidence) / (deviation**-2 + evidence)
    if _PRIOR != "soft":
        clear = by.abs() > _CLEAR
        by = torch.where(clear, by - _CLEAR**2 / torch.where(clear, by, 1.0), 0.0)
    alpha = (expected + by).clamp(0, 1)
    return alpha

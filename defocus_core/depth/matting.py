"""Matting: the two surfaces of a pixel on a depth edge, and the coverage of the nearer one.

A pixel on an edge holds α of the nearer surface and 1 - α of the farther one, C = α F + (1 - α) B,
whichever of the two its depth names. F and B are the colours of both surfaces beside the edge, each
with a mean and a variance (Bayesian matting, Chuang et al. 2001). The depth of the pixels around
lets expect a coverage that changes smoothly across the edge; the colour corrects it, as far as it
tells the surfaces apart and is a mixture of them at all.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.tensors.device_plan import pieces
from defocus_core.tensors.neighbourhoods import extreme_around, halfway, squares_around
from defocus_core.tensors.sparse_masks import exceeding, positions_of

# A pixel is on an edge if its radius and those of its neighbours span more than EDGE px, and two of
# these neighbours differ by more than _STEP px: less is a slope.
EDGE, _STEP = 1.513, 1.013
# Half width in px of the square around a pixel from which both surfaces are estimated, and the
# standard deviation in px of the weights in it.
AROUND, _NEARBY = 3, 2**0.5
# Standard deviation in px of the weights of the pixels from whose depth a coverage is expected, and
# of the coverage from the expected one.
_PIXEL, _UNCERTAIN = 0.6, 0.2
# Weight of a light that is no ordinary pixel, beside ordinary ones of its surface.
_LIGHT = 1e-20
# Radius in px up to which a nearer surface is in focus: its pixels stay as they are.
_SHARP = 0.5
# Share of another surface up to which a pixel is whole, if that is within so many deviations of its
# own surface; a greater one d counts as d - w² / d.
_WHOLE, _WITHIN = 0.03, 2.0
# Least standard deviation of the colours of a surface, as a share of their mean, and as a share of
# the brightest channel: less may be rounding.
_MIN_DEVIATION, _ROUNDING = 0.01, 1e-4
# Power of the distance from the colour of the other surface by which pixels of a thin one count.
_PUREST = 4
# Coverage from which on a pixel is of the subject of a matte.
SUBJECT = 0.5
# Pixels examined at once on a CPU, and bytes that each takes elsewhere: bounds memory.
_AT_ONCE, _BYTES_EACH = 1 << 12, 1 << 13


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


class _Side(NamedTuple):
    """One of the two surfaces beside n pixels."""

    mean: Tensor  # [C, n] colour
    variance: Tensor  # [C, n] of colour
    signed_radius: Tensor  # [n] px
    known: Tensor  # [n] bool, whether it has pixels

    def replaced(self, index: Tensor, other: _Side) -> _Side:
        """The sides with others in the place of those of these indices."""
        pairs = zip(self, other, strict=True)
        return _Side(*(own.index_copy(-1, index, new) for own, new in pairs))


class _Squares(NamedTuple):
    """The pixels around each of n, k of them."""

    colors: Tensor  # [C, k, n]
    radii: Tensor  # [k, n] px
    is_near: Tensor  # [k, n] bool, whether they are of the nearer one of two surfaces
    on_edge: Tensor  # [k, n] bool
    # [n], the coverage of the nearer surface where it is known, else NaN; None if nowhere
    known: Tensor | None = None

    @property
    def middle(self) -> int:
        """The index of the pixel itself."""
        return len(self.radii) // 2

    def weights(self, limit: float) -> Tensor:
        """[k, n] by closeness; 0 for a third surface on the pixel's own side of the edge."""
        alike = (self.radii - self.radii[self.middle]).detach().abs() <= EDGE
        own = self.is_near == self.is_near[self.middle]
        weights = _closeness(self.colors, _NEARBY) * (alike | ~own)
        if math.isinf(limit):
            return weights
        return torch.where(self.colors.detach().amax(0) > limit, _LIGHT * weights, weights)

    def have_step(self) -> Tensor:
        """[n] bool, whether the inner nine hold a step between two surfaces."""
        side = 2 * AROUND + 1
        inner = slice(AROUND - 1, AROUND + 2)
        nine = self.radii.detach().reshape(side, side, -1)[inner, inner]
        steps = (nine.diff(dim=dim).abs().amax((0, 1)) for dim in (0, 1))
        return torch.maximum(*steps) > _STEP


def unmixed(
    image: Tensor, signed_radius: Tensor, limit: float = math.inf, matte: Tensor | None = None
) -> Unmixed:
    """Take mixed pixels apart; a pixel stays as it is where one of its surfaces is not seen.

    `image`: [C, ..., H, W] linear; `signed_radius`: [..., H, W] px; `matte`: [..., H, W], the
    coverage of a subject, which is not guessed at its silhouette.
    """
    r = signed_radius.detach()
    nearest, farthest = (extreme_around(r, 1, end) for end in (torch.minimum, torch.maximum))
    edge = exceeding(farthest - nearest, EDGE)
    if matte is not None:
        edge = edge | ((matte > 0) & (matte < 1))
    positions = positions_of(edge)
    if not len(positions):
        return whole(image, signed_radius)
    border = halfway(nearest, farthest)
    chunks = [
        _taken_apart(at, _squares(image, signed_radius, edge, border, at, matte), limit)
        for at in torch.split(positions, pieces(positions.device, _AT_ONCE, _BYTES_EACH))
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


def _squares(
    image: Tensor,
    signed_radius: Tensor,
    edge: Tensor,
    border: Tensor,
    at: Tensor,
    matte: Tensor | None,
) -> _Squares:
    """The squares around pixels at [n, 2]; radii below the border [..., H, W] are near."""
    size = edge.shape[-2], edge.shape[-1]
    position = squares_around(at, size, AROUND).flatten(1).T.contiguous()
    spots = position.flatten()
    radii, on_edge = (
        x.flatten().index_select(0, spots).reshape(position.shape) for x in (signed_radius, edge)
    )
    own = at[:, 0] * size[1] + at[:, 1]
    is_near = radii.detach() < border.flatten().index_select(0, own)
    colors = image.flatten(1).index_select(1, spots).reshape(len(image), *position.shape)
    squares = _Squares(colors, radii, is_near, on_edge)
    if matte is None:
        return squares
    return _by_matte(squares, matte.flatten().index_select(0, spots).reshape(radii.shape))


def _by_matte(squares: _Squares, matte: Tensor) -> _Squares:
    """Squares whose surfaces and coverage a matte [k, n] says, where they hold its silhouette."""
    subject, radii = matte >= SUBJECT, squares.radii.detach()
    own, rest = ((radii * mask).sum(0) / mask.sum(0).clamp(min=1) for mask in (subject, ~subject))
    at_silhouette = subject.any(0) & ~subject.all(0) & ((own - rest).abs() > _STEP)
    is_near = torch.where(at_silhouette, subject == (own < rest), squares.is_near)
    coverage = torch.where(own < rest, matte, 1 - matte)[squares.middle]
    known = torch.where(at_silhouette, coverage, torch.nan)
    return squares._replace(is_near=is_near, known=known)


def _taken_apart(at: Tensor, squares: _Squares, limit: float) -> tuple[Tensor, ...]:
    """Take apart the pixels at [n, 2]."""
    near, far = _sides(squares, limit)
    color = squares.colors[:, squares.middle]  # [C, n]
    is_near = squares.is_near[squares.middle]
    nearby = _closeness(color, _PIXEL)
    expected = (nearby * squares.is_near).sum(0) / nearby.sum()
    alpha = _as_whole(_coverage(color, near, far, expected), is_near, near, far)
    has_step = squares.have_step()
    if squares.known is not None:
        alpha = torch.where(squares.known.isnan(), alpha, squares.known)
        has_step = has_step | ~squares.known.isnan()
    weights = alpha * near.variance, (1 - alpha) * far.variance
    residual = (color - alpha * near.mean - (1 - alpha) * far.mean) / (
        alpha * weights[0] + (1 - alpha) * weights[1]
    )
    near_color, far_color = (
        _within(side, color, side.mean + residual * weight)
        for side, weight in zip((near, far), weights, strict=True)
    )
    # the part clipped off a colour goes to the other, within its range
    far_color = _within(far, far_color, _rest(color, near_color, alpha))
    near_color = _within(near, near_color, _rest(color, far_color, 1 - alpha))
    near_color = torch.where(alpha == 1, color, near_color)
    far_color = torch.where(alpha == 0, color, far_color)
    known = near.known & far.known & has_step
    own_color = torch.where(is_near, near_color, far_color).T
    coverage = torch.where(is_near, alpha, 1.0)
    behind = known & ~is_near & (alpha.detach() > 0)
    fringe = (torch.cat([near_color, torch.ones_like(alpha)[None]]) * alpha).T
    both = (at, own_color, coverage), (at, fringe, near.signed_radius)
    masks = torch.nonzero(known)[:, 0], torch.nonzero(behind)[:, 0]
    return tuple(x.index_select(0, i) for of, i in zip(both, masks, strict=True) for x in of)


def _closeness(like: Tensor, deviation: float) -> Tensor:
    """Weights of the pixels of a square by their distance from its middle, [k, 1]."""
    offset = torch.arange(-AROUND, AROUND + 1, device=like.device)
    squares = (offset * offset + (offset * offset)[:, None]).flatten()
    return torch.exp(squares.to(like.dtype) / (-2 * deviation**2))[:, None]


def _sides(squares: _Squares, limit: float) -> tuple[_Side, _Side]:
    """The nearer and the farther surface in squares, from their pixels off the edge.

    If one is so thin that all of its pixels are on an edge, those that are least like the other
    hold most of it.
    """
    weight, is_near = squares.weights(limit), squares.is_near
    masks = is_near, ~is_near
    near, far = (_side_of(squares, weight * (mask & ~squares.on_edge)) for mask in masks)
    sides = []
    for side, other, mask in ((near, far, masks[0]), (far, near, masks[1])):
        index = torch.nonzero(~side.known & other.known)[:, 0]
        if len(index):
            thin = _Squares(*(x.index_select(-1, index) for x in squares[:4]))
            variance = other.variance.index_select(-1, index)
            off = thin.colors - other.mean.index_select(-1, index)[:, None]
            own = (weight * mask).index_select(-1, index)
            off = off.square().sum(0) * (own > 0)
            purity = off / off.amax(0).clamp(min=torch.finfo(off.dtype).tiny)
            found = _side_of(thin, own * purity**_PUREST)._replace(variance=variance)
            side = side.replaced(index, found)
        sides.append(side)
    return sides[0], sides[1]


def _side_of(squares: _Squares, weight: Tensor) -> _Side:
    """The surface of the pixels of squares that have a weight [k, n]."""
    total = weight.sum(0)
    fraction = weight / torch.where(total > 0, total, 1.0)
    mean = (squares.colors * fraction).sum(1)
    off = squares.colors - mean[:, None]
    spread = (off * off * fraction).sum(1)
    brightest = torch.maximum(mean, squares.colors[:, squares.middle]).amax(0).clamp(min=0)
    minimum = torch.maximum(_MIN_DEVIATION * mean, _ROUNDING * brightest)
    variance = spread + minimum * minimum + torch.finfo(mean.dtype).tiny ** 0.5
    return _Side(mean, variance, (squares.radii * fraction).sum(0), total > 0)


def _coverage(color: Tensor, near: _Side, far: _Side, expected: Tensor) -> Tensor:
    """The most probable α [n] of colours [C, n] = α near + (1 - α) far, and an expected one [n].

    The less a colour is on the line between both surfaces, the less it counts.
    """
    variance, apart = (near.variance + far.variance) / 2, near.mean - far.mean
    evidence = (apart * apart / variance).sum(0)
    observed = (apart * (color - far.mean) / variance).sum(0)
    best = (observed / torch.where(evidence > 0, evidence, 1.0)).clamp(0, 1)
    off = color - far.mean - best * apart
    misfit = (off * off / (best * near.variance + (1 - best) * far.variance)).sum(0)
    doubt = (1 + misfit) / _UNCERTAIN**2
    return ((observed + expected * doubt) / (evidence + doubt)).clamp(0, 1)


def _as_whole(alpha: Tensor, is_near: Tensor, near: _Side, far: _Side) -> Tensor:
    """Coverages [n], with those of pixels that are hardly mixed as of their own surface alone."""
    apart = (near.mean - far.mean).square()
    own = torch.where(is_near, near.variance, far.variance)
    limit = _WITHIN / (apart / own).sum(0).clamp(min=(_WITHIN / _WHOLE) ** 2).sqrt()
    limit = torch.where(is_near & (near.signed_radius.detach().abs() <= _SHARP), 1.0, limit)
    short = torch.where(is_near, 1 - alpha, alpha)
    clear = short > limit
    short = torch.where(clear, short - limit.square() / torch.where(clear, short, 1.0), 0.0)
    return torch.where(is_near, 1 - short, short)


def _rest(mixed: Tensor, color: Tensor, fraction: Tensor) -> Tensor:
    """The second colour of mixed pixels, if the first one has a share [n]."""
    return (mixed - fraction * color) / torch.where(fraction < 1, 1 - fraction, 1.0)


def _within(side: _Side, other: Tensor, color: Tensor) -> Tensor:
    """Clip a colour to two deviations around its surface's mean; `other` is never clipped."""
    reach = 2 * side.variance.sqrt()
    color = torch.maximum(color, torch.minimum(side.mean - reach, other))
    color = torch.minimum(color, torch.maximum(side.mean + reach, other))
    return torch.maximum(color, other.clamp(max=0))

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

from defocus_core.images.neighbourhoods import extreme_around, halfway, squares_around
from defocus_core.images.sparse_masks import exceeding, places_of

# A pixel is on an edge if its radius and those of its neighbours span more than this, in px.
EDGE = 1.513
# Difference of radii of two neighbours, in px, beyond which one hides the other; less is a slope.
_STEP = 1.013
# Half width in px of the square around a pixel from which both surfaces are estimated.
_AROUND = 2
# Index of the pixel itself in this square.
_MIDDLE = (2 * _AROUND + 1) ** 2 // 2
# Standard deviation of the coverage of a pixel, before its colour is known, from a whole surface.
_EXPECTED = 0.05
# Deviation of coverage up to which a pixel stays whole; a greater one d counts as d - _CLEAR² / d.
_CLEAR = 0.1
# Sum of squared deviations from its own surface up to which no pixel is clearly mixed: with
# evidence e its coverage deviates by d √e / (1 / _EXPECTED² + e) at most; d² is up to twice that.
_UNLIKE = 2 * (_CLEAR / _EXPECTED) ** 2 * 0.99
# Least standard deviation of the colours of a surface, as a share of their mean.
_LEAST_DEVIATION = 0.01
# Least standard deviation as a share of the brightest channel: less may be rounding.
_ROUNDING = 1e-4
# Pixels taken apart at once: bounds memory.
_PIXELS = 1 << 12


class Fringe(NamedTuple):
    """Parts of nearer surfaces in pixels whose depth is that of a farther one.

    Attributes:
        at: [n, 2] rows and columns.
        layer: [n, C + 1], colour premultiplied by coverage, then coverage.
        signed_radius: [n] px.
    """

    at: Tensor
    layer: Tensor
    signed_radius: Tensor


class Unmixed(NamedTuple):
    """A picture in which every pixel has the colour of its own surface.

    Attributes:
        color: [C, H, W], not premultiplied by coverage.
        coverage: [1, H, W], the share of each pixel that its own surface covers, if it is the
            nearer one of two; the surface behind shows through the rest. None if all are whole.
        fringe: The parts of nearer surfaces in pixels of farther ones.
    """

    color: Tensor
    coverage: Tensor | None
    fringe: Fringe


def unmixed(image: Tensor, signed_radius: Tensor) -> Unmixed:
    """Take mixed pixels apart.

    A pixel stays as it is if the farther surface is nowhere seen alone beside it. So does a pixel
    of a nearer surface that is nowhere seen alone, like a wire two px wide.

    Args:
        image: [C, H, W] linear.
        signed_radius: [H, W] px.
    """
    r = signed_radius.detach()
    nearest, farthest = (extreme_around(r, 1, end) for end in (torch.minimum, torch.maximum))
    edge = exceeding(farthest - nearest, EDGE)
    places = places_of(edge)
    if not len(places):
        return whole(image, signed_radius)
    border = halfway(nearest, farthest)
    chunks = [
        _taken_apart(image, signed_radius, edge, border, at) for at in torch.split(places, _PIXELS)
    ]
    at, own, share, fringe_at, fringe, fringe_radius = map(torch.cat, zip(*chunks, strict=True))
    index = at[:, 0] * edge.shape[1] + at[:, 1]
    color = image.flatten(1).index_copy(1, index, own.T).reshape(image.shape)
    coverage = torch.ones_like(image[:1]).flatten().index_copy(0, index, share)
    coverage = coverage.reshape(image[:1].shape)
    return Unmixed(color, coverage, Fringe(fringe_at, fringe, fringe_radius))


def whole(image: Tensor, signed_radius: Tensor) -> Unmixed:
    """A picture [C, H, W] of radii [H, W] without mixed pixels."""
    nothing = image.new_zeros(0, len(image) + 1)
    nowhere = torch.zeros((0, 2), dtype=torch.long, device=image.device)
    return Unmixed(image, None, Fringe(nowhere, nothing, signed_radius[0, :0]))


class _Side(NamedTuple):
    """One of the two surfaces beside n pixels.

    Attributes:
        mean: [n, C] colour.
        variance: [n, C] of colour.
        signed_radius: [n] px.
        known: [n] bool, whether it is seen without the other surface.
    """

    mean: Tensor
    variance: Tensor
    signed_radius: Tensor
    known: Tensor


def _taken_apart(
    image: Tensor, signed_radius: Tensor, edge: Tensor, border: Tensor, at: Tensor
) -> tuple[Tensor, ...]:
    """Take apart the mixed ones of the pixels at [n, 2].

    Returns:
        Place, colour and coverage of mixed pixels; place, layer and radius of the fringe in them.
    """
    around = _around(image, signed_radius, edge, border, at)
    own = _side(around, around.nearness * around.own())
    mixed = torch.nonzero(own.known & (_deviation(around.color, own) > _UNLIKE))[:, 0]
    around = around.select(mixed)
    stepped = _has_step(around.radii.detach())
    at, own = at.index_select(0, mixed), _Side(*(each.index_select(0, mixed) for each in own))
    own_near, color = around.is_near[_MIDDLE], around.color
    other = _side(around, around.nearness * (around.is_near != own_near))
    thin = own.known & ~own_near & ~other.known
    other = _with_thin(own, other, around, thin)
    near, far = (
        _Side(*(_chosen(side, *pair) for pair in zip(own, other, strict=True)))
        for side in (own_near, ~own_near)
    )
    alpha = _mixture(color, near, far, own_near.to(color.dtype))
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
    own_color = torch.where(own_near[:, None], near_color, far_color)[known]
    coverage = torch.where(own_near, alpha[:, 0], 1.0)[known]
    behind = known & ~own_near & (alpha.detach()[:, 0] > 0)
    fringe = torch.cat([near_color, torch.ones_like(alpha)], 1) * alpha
    return at[known], own_color, coverage, at[behind], fringe[behind], near.signed_radius[behind]


class _Around(NamedTuple):
    """The 25 pixels around each of n.

    Attributes:
        colors: [C, 25, n].
        radii: [25, n] px.
        is_near: [25, n] bool, whether they are of the nearer one of two surfaces.
        nearness: [25, n], their weights: 0 on an edge.
    """

    colors: Tensor
    radii: Tensor
    is_near: Tensor
    nearness: Tensor

    @property
    def color(self) -> Tensor:
        """[n, C] of the pixels themselves."""
        return self.colors[:, _MIDDLE].T

    def own(self) -> Tensor:
        """[25, n] bool, which are of the pixel's own surface, not of a second or third one."""
        alike = (self.radii - self.radii[_MIDDLE]).detach().abs() <= EDGE
        return alike & (self.is_near == self.is_near[_MIDDLE])

    def select(self, index: Tensor) -> _Around:
        """The squares around the pixels of these indices."""
        return _Around(*(each.index_select(-1, index) for each in self))


def _around(
    image: Tensor, signed_radius: Tensor, edge: Tensor, border: Tensor, at: Tensor
) -> _Around:
    """The squares around pixels at [n, 2]; radii below the border [H, W] are near."""
    place = squares_around(at, (edge.shape[0], edge.shape[1]), _AROUND).flatten(1).T.contiguous()
    spots = place.flatten()
    radii, on_edge = (
        x.flatten().index_select(0, spots).reshape(place.shape) for x in (signed_radius, edge)
    )
    is_near = radii.detach() < border[at[:, 0], at[:, 1]]
    colors = image.flatten(1).index_select(1, spots).reshape(len(image), *place.shape)
    return _Around(colors, radii, is_near, _closeness(image) * ~on_edge)


def _closeness(like: Tensor) -> Tensor:
    """Weights of the pixels of a square by their distance from its middle, [25, 1]."""
    offset = torch.arange(-_AROUND, _AROUND + 1, device=like.device)
    squares = (offset * offset + (offset * offset)[:, None]).flatten()
    return torch.exp(squares.to(like.dtype) / -4)[:, None]


def _has_step(radii: Tensor) -> Tensor:
    """Whether the inner nine of 25 radii [25, n] px hold a step between two surfaces: [n] bool."""
    square = radii.reshape(5, 5, -1)[1:4, 1:4]
    steps = (square.diff(dim=dim).abs().amax((0, 1)) for dim in (0, 1))
    return torch.maximum(*steps) > _STEP


def _with_thin(far: _Side, near: _Side, around: _Around, thin: Tensor) -> _Side:
    """The near side; where it is thin, all of its pixels are on an edge and give its colour.

    They may be mixed, too, but on the same line between two colours as the pixels beside them: both
    hold the same colour beside that of the far side.

    Args:
        far: The far side.
        near: The near side, from pixels off the edge alone.
        around: The squares around the pixels.
        thin: [n] bool, where the near side is thin.
    """
    thin_index = torch.nonzero(thin)[:, 0]
    if not len(thin_index):
        return near
    thin_around = around.select(thin_index)
    own = _side(thin_around, _closeness(thin_around.radii) * thin_around.is_near)._replace(
        variance=far.variance[thin_index]
    )
    return _Side(
        *(each.index_copy(0, thin_index, other) for each, other in zip(near, own, strict=True))
    )


def _side(around: _Around, weight: Tensor) -> _Side:
    """The surface of the pixels of a square that have a weight; [25, n], 0 for other surfaces."""
    total = weight.sum(0)
    share = weight / torch.where(total > 0, total, 1.0)
    mean, radius = (around.colors * share).sum(1), (around.radii * share).sum(0)
    off = around.colors - mean[:, None]
    spread = (off * off * share).sum(1)
    brightest = torch.maximum(mean, around.colors[:, _MIDDLE]).amax(0).clamp(min=0)
    least = torch.maximum(_LEAST_DEVIATION * mean, _ROUNDING * brightest)
    variance = spread + least * least + torch.finfo(mean.dtype).tiny ** 0.5
    return _Side(mean.T, variance.T, radius, total > 0)


def _deviation(color: Tensor, side: _Side) -> Tensor:
    """Squared deviations of colours [n, C] from a surface over its variance, summed: [n]."""
    off = (color - side.mean).detach()
    return (off * off / side.variance.detach()).sum(1)


def _chosen(first: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """For each pixel a where `first` [n] holds, else b; both [n] or [n, C]."""
    return torch.where(first if a.dim() == 1 else first[:, None], a, b)


def _rest(mixed: Tensor, color: Tensor, share: Tensor) -> Tensor:
    """The second colour of mixed pixels, if the first one has a share [n, 1]."""
    return (mixed - share * color) / torch.where(share < 1, 1 - share, 1.0)


def _within(side: _Side, other: Tensor, color: Tensor) -> Tensor:
    """Clip a colour to two deviations around its surface's mean; `other` is never clipped."""
    reach = 2 * side.variance.sqrt()
    color = torch.maximum(color, torch.minimum(side.mean - reach, other))
    color = torch.minimum(color, torch.maximum(side.mean + reach, other))
    return torch.maximum(color, other.clamp(max=0))


def _mixture(color: Tensor, near: _Side, far: _Side, own: Tensor) -> Tensor:
    """The most probable α [n] of colours [n, C] = α near + (1 - α) far, if `own` [n] is expected.

    Small deviations from `own` count as none: only clearly mixed pixels are taken apart.
    """
    variance = (near.variance + far.variance) / 2
    apart = near.mean - far.mean
    evidence = (apart * apart / variance).sum(1)
    observed = (apart * (color - far.mean) / variance).sum(1)
    deviation = (observed - own * evidence) / (_EXPECTED**-2 + evidence)
    clear = deviation.abs() > _CLEAR
    return own + torch.where(clear, deviation - _CLEAR**2 / torch.where(clear, deviation, 1.0), 0.0)

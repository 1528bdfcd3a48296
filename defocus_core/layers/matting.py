"""Matting of mixed pixels: colours on a depth edge taken apart into two surfaces.

An anti-aliased pixel holds α of the nearer surface and 1 - α of the farther one, and the depth of
only one of them. Left as they are, such pixels draw ghost lines: the nearer colour stays behind,
sharp, where the nearer surface is blurred away. They are taken apart in the way of Bayesian matting
(Chuang et al. 2001): both surfaces have a mean and a variance beside the edge, a pixel is expected
to be whole, and the most probable α and colours that give it are kept. Of a wire so thin that none
of its pixels is off the edge, those are left as they are, and what lies beside is cleaned of them.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.images.neighbourhoods import extreme_around, halfway, squares_around
from defocus_core.images.sparse_masks import exceeding, places_of

# Range of radii in px, among a pixel and its neighbours, that makes it a pixel on an edge.
EDGE = 1.513
# Range of two neighbours beyond which one hides the other; less is a slope.
_STEP = 1.013
# Px to each side of a pixel from which the two surfaces are known.
_AROUND = 2
# The number of the pixel itself among those.
_MIDDLE = (2 * _AROUND + 1) ** 2 // 2
# How far, as a share of coverage, a pixel is expected to deviate from one whole surface.
_EXPECTED = 0.05
# The least deviation that is believed; greater ones are believed the more the greater they are.
_CLEAR = 0.1
# Squares of deviations from its own surface, summed, up to which no pixel is clearly mixed: with
# evidence e it deviates by d √e / (1 / _EXPECTED² + e) at most, where d² is up to twice that.
_UNLIKE = 2 * (_CLEAR / _EXPECTED) ** 2 * 0.99
# The least deviation of colours of one surface, as a share of them.
_LEAST_DEVIATION = 0.01
# The same as a share of the brightest channel: less may be rounding.
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
            nearer one of two; what is behind shows through the rest. None if all are whole.
        fringe: What nearer surfaces cover of pixels of farther ones.
    """

    color: Tensor
    coverage: Tensor | None
    fringe: Fringe


def unmixed(image: Tensor, signed_radius: Tensor) -> Unmixed:
    """Take mixed pixels apart.

    Pixels beside which the farther surface is nowhere seen alone, and those of a nearer one that is
    not, as of a wire two px wide, are left as they are.

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
    found = [
        _taken_apart(image, signed_radius, edge, border, at) for at in torch.split(places, _PIXELS)
    ]
    at, own, share, fringe_at, fringe, fringe_radius = map(torch.cat, zip(*found, strict=True))
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
        known: [n] bool, whether it is seen without the other.
    """

    mean: Tensor
    variance: Tensor
    signed_radius: Tensor
    known: Tensor


def _taken_apart(
    image: Tensor, signed_radius: Tensor, edge: Tensor, border: Tensor, at: Tensor
) -> tuple[Tensor, ...]:
    """Those of the pixels at [n, 2] that are mixed, and what they hold.

    Returns:
        Place, colour and coverage of pixels; place, layer and radius of the fringe in them.
    """
    around = _around(image, signed_radius, edge, border, at)
    own = _side(around, around.nearness * around.own())
    some = torch.nonzero(own.known & (_deviation(around.color, own) > _UNLIKE))[:, 0]
    around = around.some(some)
    step = _has_step(around.radii.detach())
    at, own = at.index_select(0, some), _Side(*(each.index_select(0, some) for each in own))
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
    # what is cut off a colour is the other's, within its range if α was not cut off, too
    wide = [torch.where(alpha == 0.5, color, one) for one in (far_color, near_color)]
    far_color = _within(far, wide[0], _rest(color, near_color, alpha))
    near_color = _within(near, wide[1], _rest(color, far_color, 1 - alpha))
    near_color = torch.where(alpha == 1, color, near_color)
    far_color = torch.where(alpha == 0, color, far_color)
    known = near.known & far.known & step
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
        nearness: [25, n], by how much they count: 0 on an edge.
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
        """[25, n] bool, those of the surface of the pixel itself; a third takes no part."""
        like = (self.radii - self.radii[_MIDDLE]).detach().abs() <= EDGE
        return like & (self.is_near == self.is_near[_MIDDLE])

    def some(self, index: Tensor) -> _Around:
        """Those of some pixels."""
        return _Around(*(each.index_select(-1, index) for each in self))


def _around(
    image: Tensor, signed_radius: Tensor, edge: Tensor, border: Tensor, at: Tensor
) -> _Around:
    """What lies around pixels at [n, 2]; the border tells near from far."""
    place = squares_around(at, (edge.shape[0], edge.shape[1]), _AROUND).flatten(1).T.contiguous()
    spots = place.flatten()
    radii, on_edge = (
        x.flatten().index_select(0, spots).reshape(place.shape) for x in (signed_radius, edge)
    )
    is_near = radii.detach() < border[at[:, 0], at[:, 1]]
    colors = image.flatten(1).index_select(1, spots).reshape(len(image), *place.shape)
    return _Around(colors, radii, is_near, _closeness(image) * ~on_edge)


def _closeness(like: Tensor) -> Tensor:
    """By how much pixels around another count, [25, 1]."""
    offset = torch.arange(-_AROUND, _AROUND + 1, device=like.device)
    squares = (offset * offset + (offset * offset)[:, None]).flatten()
    return torch.exp(squares.to(like.dtype) / -4)[:, None]


def _has_step(radii: Tensor) -> Tensor:
    """Whether neighbours in the inner nine of 25 px [25, n] differ as no surface does: [n] bool."""
    square = radii.reshape(5, 5, -1)[1:4, 1:4]
    steps = (square.diff(dim=dim).abs().amax((0, 1)) for dim in (0, 1))
    return torch.maximum(*steps) > _STEP


def _with_thin(far: _Side, near: _Side, around: _Around, thin: Tensor) -> _Side:
    """The near side, where it is thin of all of its pixels: each is on an edge.

    These may be mixed, too, but along the same line of colours: what they hold beside the far
    side's colour is what the pixels beside hold of it.

    Args:
        far: The other.
        near: Without.
        around: The pixels of both.
        thin: [n] bool.
    """
    some = torch.nonzero(thin)[:, 0]
    if not len(some):
        return near
    few = around.some(some)
    mixed = _side(few, _closeness(few.radii) * few.is_near)._replace(variance=far.variance[some])
    return _Side(
        *(each.index_copy(0, some, other) for each, other in zip(near, mixed, strict=True))
    )


def _side(around: _Around, weight: Tensor) -> _Side:
    """The surface of some of the pixels around others; of weight [25, n], 0 if of another one."""
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
    """By how many deviations, squared and summed over channels, colours [n, C] are off: [n]."""
    off = (color - side.mean).detach()
    return (off * off / side.variance.detach()).sum(1)


def _chosen(first: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """Of each pixel the one or the other, [n] or [n, C]."""
    return torch.where(first if a.dim() == 1 else first[:, None], a, b)


def _rest(mixed: Tensor, color: Tensor, share: Tensor) -> Tensor:
    """The other colour of a pixel of which a colour has a share [n, 1]."""
    return (mixed - share * color) / torch.where(share < 1, 1 - share, 1.0)


def _within(side: _Side, other: Tensor, color: Tensor) -> Tensor:
    """A colour in the range of its surface, of two deviations, widened to hold another; not < 0."""
    reach = 2 * side.variance.sqrt()
    color = torch.maximum(color, torch.minimum(side.mean - reach, other))
    color = torch.minimum(color, torch.maximum(side.mean + reach, other))
    return torch.maximum(color, other.clamp(max=0))


def _mixture(color: Tensor, near: _Side, far: _Side, own: Tensor) -> Tensor:
    """The most probable α [n] of colours [n, C] = α near + (1 - α) far, if `own` [n] is expected.

    What is not clearly mixed is not taken apart: small deviations count as none.
    """
    variance = (near.variance + far.variance) / 2
    apart = near.mean - far.mean
    evidence = (apart * apart / variance).sum(1)
    observed = (apart * (color - far.mean) / variance).sum(1)
    deviation = (observed - own * evidence) / (_EXPECTED**-2 + evidence)
    clear = deviation.abs() > _CLEAR
    return own + torch.where(clear, deviation - _CLEAR**2 / torch.where(clear, deviation, 1.0), 0.0)

"""Pixels on an edge of depth, whose colours are mixed from two surfaces.

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

from defocus_core.neighbours import extreme_around

# Range of radii in px, among a pixel and its neighbours, that makes it a pixel on an edge.
_EDGE = 1.5
# Range of two neighbours beyond which one hides the other; less is a slope.
_STEP = 1.0
# Px to each side of a pixel from which the two surfaces are known.
_AROUND = 2
# How far, as a share of coverage, a pixel is expected to deviate from one whole surface.
_EXPECTED = 0.05
# The least deviation that is believed; greater ones are believed the more the greater they are.
_CLEAR = 0.1
# The least deviation of colours of one surface, as a share of them.
_LEAST_DEVIATION = 0.01
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
            nearer one of two; what is behind shows through the rest.
        fringe: What nearer surfaces cover of pixels of farther ones.
    """

    color: Tensor
    coverage: Tensor
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
    edge = farthest - nearest > _EDGE
    places = torch.nonzero(edge)
    if not len(places):
        return whole(image, signed_radius)
    border = (nearest + farthest) / 2
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
    coverage = torch.ones_like(image[:1])
    nothing = torch.cat([image, coverage])[:, :0, 0].T
    nowhere = torch.zeros((0, 2), dtype=torch.long, device=image.device)
    return Unmixed(image, coverage, Fringe(nowhere, nothing, signed_radius[0, :0]))


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
    H, W = edge.shape
    offset = torch.arange(-_AROUND, _AROUND + 1, device=at.device)[:, None]
    rows, columns = (at[:, 0] + offset).clamp_(0, H - 1), (at[:, 1] + offset).clamp_(0, W - 1)
    place = (rows[:, None] * W + columns).flatten(0, 1)  # [25, n]
    spots = place.flatten()
    radii, alone = (
        x.flatten().index_select(0, spots).reshape(place.shape) for x in (signed_radius, ~edge)
    )
    is_near = radii.detach() < border[at[:, 0], at[:, 1]]
    squares = (offset * offset + (offset * offset).T).flatten().to(image.dtype)
    nearness = torch.exp(-squares / 4)[:, None] * alone
    colors = image.flatten(1).index_select(1, spots).reshape(len(image), *place.shape)
    values = torch.cat([colors, colors * colors, radii[None]])  # [2 C + 1, 25, n]
    middle = len(place) // 2
    # on the pixel's own side, a third surface takes no part
    own = (radii - radii[middle]).detach().abs() <= _EDGE
    near, far = (
        _side(values, nearness * (side & (own | ~side[middle]))) for side in (is_near, ~is_near)
    )
    near, thin = _with_thin(near, far, values, torch.exp(-squares / 4)[:, None] * is_near)
    own_near, color = is_near[middle], colors[:, middle].T
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
    near_color = torch.where(alpha == 1, color, near_color)
    far_color = torch.where(alpha == 0, color, far_color)
    known = near.known & far.known & ~(thin & own_near) & _has_step(radii.detach())
    own_color = torch.where(own_near[:, None], near_color, far_color)[known]
    coverage = torch.where(own_near, alpha[:, 0], 1.0)[known]
    behind = known & ~own_near & (alpha.detach()[:, 0] > 0)
    fringe = torch.cat([near_color, torch.ones_like(alpha)], 1) * alpha
    return at[known], own_color, coverage, at[behind], fringe[behind], near.signed_radius[behind]


def _has_step(radii: Tensor) -> Tensor:
    """Whether neighbours in the inner nine of 25 px [25, n] differ as no surface does: [n] bool."""
    square = radii.reshape(5, 5, -1)[1:4, 1:4]
    steps = (square.diff(dim=dim).abs().amax((0, 1)) for dim in (0, 1))
    return torch.maximum(*steps) > _STEP


def _with_thin(near: _Side, far: _Side, values: Tensor, weight: Tensor) -> tuple[_Side, Tensor]:
    """The near side, of all of its pixels where each is on an edge, and [n] bool where that is so.

    These may be mixed, too, but along the same line of colours: what they hold beside the far
    side's colour is what the pixels beside hold of it.

    Args:
        near: Without.
        far: The other.
        values: As for `_side`.
        weight: [25, n], of all of its pixels.
    """
    some = torch.nonzero(~near.known & far.known)[:, 0]
    thin = torch.zeros_like(near.known).index_fill(0, some, True)
    mixed = _side(values[..., some], weight[:, some])._replace(variance=far.variance[some])
    found = (each.index_copy(0, some, other) for each, other in zip(near, mixed, strict=True))
    return _Side(*found), thin


def _side(values: Tensor, weight: Tensor) -> _Side:
    """The surface of some of the pixels around others.

    Args:
        values: [2 C + 1, 25, n] colour, its square, radius.
        weight: [25, n], 0 where it is another surface.
    """
    total = weight.sum(0)
    means = ((values * weight).sum(1) / torch.where(total > 0, total, 1.0)).T
    C = means.shape[1] // 2
    mean, radius = means[:, :C], means[:, -1]
    tiny = torch.finfo(mean.dtype).tiny ** 0.5
    spread = (means[:, C:-1] - mean * mean).clamp(min=0)
    variance = spread + (_LEAST_DEVIATION * mean) ** 2 + tiny
    return _Side(mean, variance, radius, total > 0)


def _within(side: _Side, mixed: Tensor, color: Tensor) -> Tensor:
    """A colour in the range of its surface, of two deviations, and of the pixel it is taken from.

    Not negative, unless the pixel is.
    """
    reach = 2 * side.variance.sqrt()
    color = torch.maximum(color, torch.minimum(side.mean - reach, mixed))
    color = torch.minimum(color, torch.maximum(side.mean + reach, mixed))
    return torch.maximum(color, mixed.clamp(max=0))


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

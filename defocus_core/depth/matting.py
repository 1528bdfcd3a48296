"""Matting: the two surfaces of a pixel on a depth edge, and the coverage of the nearer one.

A pixel on an edge shows a share α of the nearer surface and 1 - α of the farther one,
C = α F + (1 - α) B, whichever of the two its depth names. F and B are the colours of both surfaces
beside the edge, each with a mean and a variance (Bayesian matting, Chuang et al. 2001). The depth
of the pixels around gives an expected coverage, which changes smoothly across the edge. The colour
corrects it where the surfaces differ clearly in colour and the pixel is a mixture of both.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from defocus_core.tensors.device_plan import pieces
from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.neighbourhoods import (
    exceeding,
    extreme_around,
    halfway,
    positions_of,
    squares_around,
)
from defocus_core.tensors.ties import off_round

# A pixel is on an edge if its radius and those of its neighbours span more than EDGE px, and two of
# these neighbours differ by more than STEP px: less is a slope.
EDGE, STEP = off_round(1.5), off_round(1.0)
# Half width in px of the square around a pixel from which both surfaces are estimated, and the
# standard deviation in px of the weights in it.
AROUND, NEARBY = 3, 2**0.5
# Standard deviation in px of the weights of the pixels whose depth gives the expected coverage, and
# that of the coverage around the expected one.
PIXEL, UNCERTAIN = 0.6, 0.25
# Relative weight of a pixel brighter than the limit, beside ordinary ones of its surface.
LIGHT = 1e-20
# Radius in px up to which a surface is in focus: the pixels of a nearer one stay whole.
SHARP = 0.5
# A pixel with a share of another surface up to w is whole. w is at most this, and less if such a
# share would be more than this many standard deviations of its own surface; a greater share d
# counts as d - w² / d.
WHOLE, WITHIN = 0.03, 2.0
# Misfit, in variances, above which a colour is rather that of a third thing, such as a lamp, and
# its pixel whole.
FOREIGN = 100
# Least standard deviation of a surface's colours, as a share of their mean and of the brightest
# channel: less may be rounding.
MIN_DEVIATION, ROUNDING = 0.01, 1e-4
# Pixels of a thin surface are weighted by this power of their squared distance in colour from the
# other surface.
_PUREST = 4
# Distance in px from an edge of estimated depth up to which colours decide the surface of a pixel.
_BESIDE = 2
# Coverage by a matte from which on a pixel belongs to the subject.
SUBJECT = 0.5
# Bytes that a pixel takes while it is examined.
_BYTES_EACH = 1 << 13


class MixedPixels(NamedTuple):
    """Pixels that show parts of two surfaces, split into these.

    If the pixel's depth is that of the nearer surface, the nearer surface covers a part of the
    pixel, and the farther one shows through the rest. If it is that of the farther surface, the
    farther surface covers all of the pixel, and a part of the nearer one lies in front.
    """

    # [n, 2] rows and columns; in a batch, rows go on counting from one picture to the next
    at: Tensor
    # [2 C + 3, n]: the colour of the own surface and its coverage; the colour of a nearer surface,
    # its coverage and its radius in px
    values: Tensor

    @property
    def own(self) -> Tensor:
        """[C + 1, n]: colour, not premultiplied, and coverage of the surface that depth names."""
        return self.values[: (len(self.values) - 1) // 2]

    @property
    def nearer(self) -> Tensor:
        """[C + 2, n]: colour, coverage and radius in px of a nearer surface in front.

        The coverage is 0 where the depth itself is that of the nearer surface.
        """
        return self.values[(len(self.values) - 1) // 2 :]

    def select(self, index: Tensor) -> MixedPixels:
        """The pixels of the given indices."""
        return MixedPixels(self.at.index_select(0, index), self.values.index_select(1, index))

    @classmethod
    def concatenate(cls, parts: Sequence[MixedPixels]) -> MixedPixels:
        """The pixels of several sets as one set, in their order."""
        return cls(torch.cat([part.at for part in parts]), torch.cat([p.values for p in parts], 1))


class _Side(NamedTuple):
    """One of the two surfaces beside n pixels."""

    mean: Tensor  # [C, n] colour
    variance: Tensor  # [C, n] of colour
    signed_radius: Tensor  # [n] px
    known: Tensor  # [n] bool, whether the surface has pixels

    def where(self, mask: Tensor, other: _Side) -> _Side:
        """The sides of `self` where a mask [n] is True, and of `other` elsewhere."""
        return _Side(*(torch.where(mask, *pair) for pair in zip(self, other, strict=True)))

    def replaced(self, index: Tensor, other: _Side) -> _Side:
        """The sides with those of `other` in place of the ones at the given indices."""
        pairs = zip(self, other, strict=True)
        return _Side(*(own.index_copy(-1, index, new) for own, new in pairs))


class _Squares(NamedTuple):
    """Squares of k pixels around each of n pixels."""

    colors: Tensor  # [C, k, n]
    radii: Tensor  # [k, n] px
    is_near: Tensor  # [k, n] bool, whether pixels are of the nearer one of two surfaces
    on_edge: Tensor  # [k, n] bool
    # [n], the coverage of the nearer surface where a matte gives it, else NaN; None without a matte
    known: Tensor | None = None

    @property
    def middle(self) -> int:
        """The index, among the k pixels, of the one in the middle."""
        return len(self.radii) // 2

    def weights(self, limit: float) -> Tensor:
        """Weights [k, n] of the pixels by closeness to the middle.

        Pixels of a third surface, on the same side of the edge as the middle, have weight 0, and
        pixels brighter than `limit` almost 0.
        """
        alike = (self.radii - self.radii[self.middle]).detach().abs() <= EDGE
        own = self.is_near == self.is_near[self.middle]
        weights = _closeness(self.colors, NEARBY) * (alike | ~own)
        if math.isinf(limit):
            return weights
        return torch.where(self.colors.detach().amax(0) > limit, LIGHT * weights, weights)

    def inner(self) -> Tensor:
        """The radii [3, 3, n] in px of the 3×3 pixels in the middle."""
        side = 2 * AROUND + 1
        inner = slice(AROUND - 1, AROUND + 2)
        return self.radii.reshape(side, side, -1)[inner, inner]

    def have_step(self) -> Tensor:
        """Whether the inner 3×3 pixels hold a step between two surfaces: [n] bool."""
        nine = self.inner().detach()
        steps = (nine.diff(dim=dim).abs().amax((0, 1)) for dim in (0, 1))
        return torch.maximum(*steps) > STEP

    def beyond_edge(self) -> Tensor:
        """Radii [n] in px of the other surface: the extremes within the inner 3×3 pixels.

        They are the greatest radii if the middle is of the nearer surface, and else the least.
        """
        nine = self.inner()
        return torch.where(self.is_near[self.middle], nine.amax((0, 1)), nine.amin((0, 1)))


class _Pixels(NamedTuple):
    """n pixels on an edge, with the surfaces on both sides."""

    color: Tensor  # [C, n]
    own: _Side  # the surfaces that their depth names
    other: _Side  # the surfaces on the other side of the edge
    expected: Tensor  # [n], coverage of the own surface that the depth around lets expect
    known: Tensor  # [n] bool, whether both surfaces have pixels


def mixed_pixels(
    image: Tensor, signed_radius: Tensor, limit: float = math.inf, matte: Tensor | None = None
) -> MixedPixels:
    """The mixed pixels of a picture, split into two surfaces.

    A pixel is left out if one of its surfaces is not visible around it.

    `image`: [C, ..., H, W] linear; `signed_radius`: [..., H, W] px; `limit`: light above which a
    pixel hardly counts for the colour of its surface; `matte`: [..., H, W], the coverage of a
    subject, which replaces the estimated coverage at its silhouette.
    """
    edge = _edges(signed_radius, matte)
    squares = _squares_on(edge, image, signed_radius, matte)
    parts = [_split_pixels(at, square, limit) for at, square in squares]
    if not parts:
        return no_pixels(image)
    return parts[0] if len(parts) == 1 else MixedPixels.concatenate(parts)


def no_pixels(image: Tensor) -> MixedPixels:
    """An empty set of mixed pixels, for an image [C, ..., H, W]."""
    nowhere = torch.zeros((0, 2), dtype=torch.long, device=image.device)
    return MixedPixels(nowhere, image.new_zeros(2 * len(image) + 3, 0))


def radii_by_color(signed_radius: Tensor, image: Tensor, decided: Tensor) -> Tensor:
    """Radii [H, W] px in which colours decide to which surface the pixels on edges belong.

    Estimated depth gives some pixels beside an edge the radius of the wrong surface.

    `image`: [C, H, W]; `decided`: [H, W] bool, where colours distinguish both surfaces.
    """
    image = image.to(torch.promote_types(image.dtype, torch.float32))
    for _ in range(_BESIDE):
        indices, radii = [], []
        for at, squares in _squares_on(_edges(signed_radius) & decided, image, signed_radius):
            pixels = _pixels_on_edge(squares)
            other_is_there = pixels.known & (_coverage(*pixels[:4]) < 1 / 2)
            indices.append(_numbers(at, signed_radius)[other_is_there])
            radii.append(squares.beyond_edge()[other_is_there])
        if not sum(map(len, indices)):
            break
        flat = signed_radius.flatten().index_copy(0, torch.cat(indices), torch.cat(radii))
        signed_radius = flat.view_as(signed_radius)
    return signed_radius


def _edges(signed_radius: Tensor, matte: Tensor | None = None) -> Tensor:
    """The pixels [..., H, W] on edges of depth or of a matte, bool."""
    r = signed_radius.detach()
    nearest, farthest = (extreme_around(r, 1, end) for end in (torch.minimum, torch.maximum))
    edge = exceeding(farthest - nearest, EDGE)
    return edge if matte is None else edge | ((matte > 0) & (matte < 1))


def _numbers(at: Tensor, like: Tensor) -> Tensor:
    """Flat indices [n] of the pixels at rows and columns [n, 2] of pictures [..., H, W]."""
    return at[:, 0] * like.shape[-1] + at[:, 1]


def _squares_on(
    edge: Tensor, image: Tensor, signed_radius: Tensor, matte: Tensor | None = None
) -> Iterator[tuple[Tensor, _Squares]]:
    """Yield the pixels [n, 2] of an edge [..., H, W], piece by piece, with the squares around them.

    A pixel of a square is of the nearer surface if it is nearer than halfway between the extremes
    of the 3×3 pixels around the middle.
    """
    positions = positions_of(edge)
    if not len(positions):
        return
    r, size = signed_radius.detach(), (edge.shape[-2], edge.shape[-1])
    border = halfway(*(extreme_around(r, 1, end) for end in (torch.minimum, torch.maximum)))
    for at in torch.split(positions, pieces(positions.device, _BYTES_EACH)):
        position = squares_around(at, size, AROUND).flatten(1).T.contiguous()
        spots = position.flatten()
        radii, on_edge = (
            x.flatten().index_select(0, spots).reshape(position.shape)
            for x in (signed_radius, edge)
        )
        is_near = radii.detach() < border.flatten().index_select(0, _numbers(at, edge))
        colors = image.flatten(1).index_select(1, spots).reshape(len(image), *position.shape)
        squares = _Squares(colors, radii, is_near, on_edge)
        if matte is not None:
            of_matte = matte.flatten().index_select(0, spots).reshape(radii.shape)
            squares = _by_matte(squares, of_matte)
        yield at, squares


def _by_matte(squares: _Squares, matte: Tensor) -> _Squares:
    """The squares; those at a matte's silhouette have surfaces and coverage of the matte [k, n]."""
    subject, radii = matte >= SUBJECT, squares.radii.detach()
    own, rest = ((radii * mask).sum(0) / mask.sum(0).clamp(min=1) for mask in (subject, ~subject))
    at_silhouette = subject.any(0) & ~subject.all(0) & ((own - rest).abs() > STEP)
    is_near = torch.where(at_silhouette, subject == (own < rest), squares.is_near)
    coverage = torch.where(own < rest, matte, 1 - matte)[squares.middle]
    known = torch.where(at_silhouette, coverage, torch.nan)
    return squares._replace(is_near=is_near, known=known)


def _split_pixels(at: Tensor, squares: _Squares, limit: float) -> MixedPixels:
    """The mixed pixels at rows and columns [n, 2], split into two surfaces.

    Pixels without two known surfaces are left out.
    """
    pixels = _pixels_on_edge(squares, limit)
    color, own, other, _, known = pixels
    is_near = squares.is_near[squares.middle]
    alpha = _as_whole(_coverage(*pixels[:4]), is_near, own, other)
    if squares.known is not None:
        by_matte = torch.where(is_near, squares.known, 1 - squares.known)
        alpha = torch.where(by_matte.isnan(), alpha, by_matte)
    own_color, other_color = _colors(color, own, other, alpha)
    rest = torch.stack([torch.where(is_near, 0.0, 1 - alpha), other.signed_radius])
    coverage = torch.where(is_near, alpha, 1.0)[None]
    apart = MixedPixels(at, torch.cat([own_color, coverage, other_color, rest]))
    return apart.select(torch.nonzero(known)[:, 0])


def _pixels_on_edge(squares: _Squares, limit: float = math.inf) -> _Pixels:
    """The pixels in the middle of squares, with the surfaces on both sides."""
    near, far = _sides(squares, limit)
    color = squares.colors[:, squares.middle]
    is_near = squares.is_near[squares.middle]
    nearby = _closeness(color, PIXEL)
    expected = (nearby * (squares.is_near == is_near)).sum(0) / nearby.sum()
    has_step = squares.have_step()
    if squares.known is not None:
        has_step = has_step | ~squares.known.isnan()
    known = near.known & far.known & has_step
    return _Pixels(color, near.where(is_near, far), far.where(is_near, near), expected, known)


def _closeness(like: Tensor, deviation: float) -> Tensor:
    """Gaussian weights [k, 1] of the pixels of a square by distance from its middle.

    `deviation`: their standard deviation in px.
    """
    offset = torch.arange(-AROUND, AROUND + 1, device=like.device)
    squares = (offset * offset + (offset * offset)[:, None]).flatten()
    return torch.exp(squares.to(like.dtype) / (-2 * deviation**2))[:, None]


def _sides(squares: _Squares, limit: float) -> tuple[_Side, _Side]:
    """The nearer and the farther surface in squares, from their pixels that are not on the edge.

    If a surface is so thin that all its pixels are on an edge, they are weighted by how much their
    colour differs from the other surface.
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
    """The mean colour, its variance and the mean radius of squares, weighted by `weight` [k, n]."""
    total = weight.sum(0)
    fraction = weight / torch.where(total > 0, total, 1.0)
    mean = (squares.colors * fraction).sum(1)
    off = squares.colors - mean[:, None]
    spread = (off * off * fraction).sum(1)
    brightest = torch.maximum(mean, squares.colors[:, squares.middle]).amax(0).clamp(min=0)
    minimum = torch.maximum(MIN_DEVIATION * mean, ROUNDING * brightest)
    variance = spread + minimum * minimum + torch.finfo(mean.dtype).tiny ** 0.5
    return _Side(mean, variance, (squares.radii * fraction).sum(0), total > 0)


def _coverage(color: Tensor, own: _Side, other: _Side, expected: Tensor) -> Tensor:
    """The most probable α [n] of colours [C, n] = α own + (1 - α) other, given the expected α [n].

    The farther a colour is from the line between both surfaces, the less it counts; one that is far
    from it, such as that of a lamp, gets a coverage near 1.
    """
    variance, apart = (own.variance + other.variance) / 2, own.mean - other.mean
    evidence = (apart * apart / variance).sum(0)
    observed = (apart * (color - other.mean) / variance).sum(0)
    best = (observed / torch.where(evidence > 0, evidence, 1.0)).clamp(0, 1)
    off = color - other.mean - best * apart
    misfit = (off * off / (best * own.variance + (1 - best) * other.variance)).sum(0)
    doubt = (1 + misfit) / UNCERTAIN**2
    expected = 1 - (1 - expected) / (1 + misfit / FOREIGN)
    return ((observed + expected * doubt) / (evidence + doubt)).clamp(0, 1)


def _as_whole(alpha: Tensor, is_near: Tensor, own: _Side, other: _Side) -> Tensor:
    """Coverages [n] of pixels by the surfaces that their depth names, those near 1 set to 1."""
    apart = (own.mean - other.mean).square()
    limit = WITHIN / (apart / own.variance).sum(0).clamp(min=(WITHIN / WHOLE) ** 2).sqrt()
    limit = torch.where(is_near & (own.signed_radius.detach().abs() <= SHARP), 1.0, limit)
    clear = 1 - alpha > limit
    short = torch.where(clear, 1 - alpha, 1.0)
    return torch.where(clear, 1 - short + limit.square() / short, 1.0)


def _colors(color: Tensor, own: _Side, other: _Side, alpha: Tensor) -> tuple[Tensor, Tensor]:
    """The colours [C, n] of the own and the other surface of mixed pixels.

    The own surface is the one that depth names, with the coverage `alpha` [n]. The part of a
    pixel's colour that the mean colours do not explain is given first to the own surface, within
    its variance, then to the other.
    """
    weights = alpha * own.variance, (1 - alpha) * other.variance
    residual = (color - alpha * own.mean - (1 - alpha) * other.mean) / (
        alpha * weights[0] + (1 - alpha) * weights[1]
    )
    own_color, free = (
        side.mean + residual * weight for side, weight in zip((own, other), weights, strict=True)
    )
    clipped = free - _clipped(other, other.mean, free)
    own_color = own_color + (1 - alpha) / torch.where(alpha > 0, alpha, 1.0) * clipped
    own_color = _clipped(own, color, own_color)
    return own_color, _clipped(other, color, _rest(color, own_color, alpha))


def _rest(mixed: Tensor, color: Tensor, fraction: Tensor) -> Tensor:
    """Mixed colours [C, n] without a `fraction` [n] of `color`, scaled to full coverage."""
    return (mixed - fraction * color) / torch.where(fraction < 1, 1 - fraction, 1.0)


def _clipped(side: _Side, other: Tensor, color: Tensor) -> Tensor:
    """Colours [C, n] clipped to two standard deviations around the mean of their surface.

    The range is widened to contain `other` [C, n].
    """
    reach = 2 * side.variance.sqrt()
    color = torch.maximum(color, torch.minimum(side.mean - reach, other))
    color = torch.minimum(color, torch.maximum(side.mean + reach, other))
    return torch.maximum(color, other.clamp(max=0))

"""Depth of another size than its picture, resized with edges where the colours change.

Between surfaces no depth is invented: each pixel beside an edge takes the disparity of one of the
surfaces around it. Coarse pixels, the pixels of the given depth, vote for theirs, weighted by
nearness and by likeness of colour (joint bilateral upsampling, Kopf et al. 2007); where the votes
of a surface are more than those of the rest, the rest is left out. Within a surface, and on ramps,
disparity is linear.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.diagnosis import diagnosed
from defocus_core.depth.soft_edges import AVERAGED, without_ramps
from defocus_core.tensors.derived import Mapped
from defocus_core.tensors.neighbourhoods import squares_around
from defocus_core.tensors.resampling import linear
from defocus_core.tensors.source import Pixels, bands
from defocus_core.tensors.validation import described

# Least step between surfaces, as a share of the range of disparity: more than a level of 8 bits;
# and as a share of the range among neighbours, which on a slope steps evenly.
_MINIMUM, _GAP = 1 / 170, 0.3
# Half width of the square of coarse pixels that vote, in coarse pixels; standard deviation of their
# nearness; and weight of a coarse pixel beside an edge, whose colour may be that of two surfaces.
_REACH, _NEAR, _MIXED = 2, 0.8, 0.3
# Most surfaces but one among the coarse pixels that vote.
_ROUNDS = 2
# Variance of likeness: share of the difference of the mean colours of two surfaces, squared, and
# share of the variances of both. Likeness of colours that are not alike at all.
_APART, _VARIED, _UNLIKE = 0.3, 0.125, 1e-2
# Range of radii in px for which the depth is diagnosed.
_RANGE_PX = 30.0
# Pixels at edges computed at once: bounds memory.
_PIXELS = 1 << 13
_GAMMA = 1 / 2.2


class _Votes(NamedTuple):
    """The coarse pixels around n pixels."""

    disparity: Tensor  # [n, K]
    here: Tensor  # [n, K] disparity of the surface of each coarse pixel at the pixel
    nearness: Tensor  # [n, K] weights
    colors: Tensor  # [C, n, K]
    own: Tensor  # [C, n] colours of the pixels


class GuidedDepth(Mapped):
    """Depth [H, W] at the size of a picture, computed window by window."""

    def __init__(self, depth: Tensor, image: Pixels) -> None:
        """Look for edges, and take the mean colours of coarse pixels.

        Args:
            depth: [h, w], positive, in any unit; inf is sky. It shows what the picture shows, and
                no more.
            image: [C, H, W], linear light.

        Raises:
            ValueError: If `depth` is no map of positive numbers.
        """
        if depth.dim() != 2 or not depth.is_floating_point() or not bool((depth > 0).all()):
            problem = f"depth must be [h, w] of positive floats, got {described(depth)}"
            raise ValueError(f"{problem}; inf is sky")
        super().__init__(self._computed, image.shape[-2:], depth)
        self._image = image
        disparity, has_ramps = _prepared(1 / depth.double())
        self._disparity = disparity
        (H, W), (h, w) = self.shape, disparity.shape
        self._row, self._column = _nearest(H, h), _nearest(W, w)
        self._minimum = _MINIMUM * float(disparity.max() - disparity.min())
        self._at_edge = _at_edges(disparity, self._minimum) & (not has_ramps)
        self._slopes = [_slope(disparity, dim) for dim in (0, 1)]
        self._colors = _mean_colors(image, self._row, self._column, (h, w))

    def _computed(self, rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
        """The window [rows, columns], each a pair of first and end."""
        disparity = linear(self._disparity, rows, columns, self.shape)
        down, across = self._row[slice(*rows)], self._column[slice(*columns)]
        at = torch.nonzero(self._at_edge[down][:, across])
        if len(at):
            colors = _encoded(self._image[..., slice(*rows), slice(*columns)])
            for part in torch.split(at, _PIXELS):
                votes = self._votes(part, colors, rows[0], columns[0])
                disparity[part[:, 0], part[:, 1]] = _pick_surface(votes, self._minimum)
        return (1 / disparity).to(self.dtype)

    def _votes(self, at: Tensor, colors: Tensor, top: int, left: int) -> _Votes:
        """The coarse px around pixels [n, 2] of a window, whose colours are [C, rows, columns]."""
        size = (self._disparity.shape[0], self._disparity.shape[1])
        y, x = at[:, 0] + top, at[:, 1] + left
        around = squares_around(torch.stack([self._row[y], self._column[x]], 1), size, _REACH)
        coarse_pixel = around.flatten(1)
        positions = [
            (number + 0.5) * coarse / pixels - 0.5
            for number, coarse, pixels in zip((y, x), size, self.shape, strict=True)
        ]
        offsets = [
            positions[0][:, None] - coarse_pixel // size[1],
            positions[1][:, None] - coarse_pixel % size[1],
        ]
        distance = offsets[0].square() + offsets[1].square()
        nearness = torch.exp(distance.double() / (-2 * _NEAR**2))
        nearness *= torch.where(self._at_edge.flatten()[coarse_pixel], _MIXED, 1.0)
        own = colors[:, at[:, 0], at[:, 1]]
        disparity = self._disparity.flatten()[coarse_pixel]
        down, across = (self._slopes[dim].flatten()[coarse_pixel] for dim in (0, 1))
        here = disparity + down * offsets[0] + across * offsets[1]
        return _Votes(disparity, here, nearness, self._colors.flatten(1)[:, coarse_pixel], own)


def _prepared(disparity: Tensor) -> tuple[Tensor, bool]:
    """Disparity [h, w] without averages at edges, and whether edges are ramps instead.

    Ramps are resized as they are: the repair of the resized depth makes them steps.
    """
    span = float(disparity.max() - disparity.min())
    if not 0 < span < math.inf:
        return disparity, False
    radius = disparity * (-_RANGE_PX / span)  # as of a lens that is in focus at infinity
    repair = diagnosed(radius, 0.0, 1)
    if repair.antialiased is None or repair.soft_edges is None:
        return disparity, repair.soft_edges is not None
    radius = without_ramps(radius, repair.soft_edges, AVERAGED)
    if diagnosed(radius, 0.0, 1).ramps:
        return disparity, True
    return (radius * (-span / _RANGE_PX)).clamp(min=0), False


def _nearest(pixels: int, coarse: int) -> Tensor:
    """The nearest coarse pixel to each pixel along an axis."""
    return ((torch.arange(pixels) + 0.5) * coarse / pixels).long()


def _slope(disparity: Tensor, dim: int) -> Tensor:
    """The lesser slope [h, w] of both sides of each coarse px along an axis; 0 at its extremes."""
    step = disparity.diff(dim=dim)
    nothing = torch.zeros_like(disparity.narrow(dim, 0, 1))
    before, after = torch.cat([nothing, step], dim), torch.cat([step, nothing], dim)
    lesser = torch.where(before.abs() < after.abs(), before, after)
    return torch.where(before * after > 0, lesser, 0.0)


def _at_edges(disparity: Tensor, minimum: float) -> Tensor:
    """The coarse pixels [h, w] around which there is a step between surfaces: bool."""
    size = (disparity.shape[0], disparity.shape[1])
    positions = torch.stack(
        torch.meshgrid(*(torch.arange(side) for side in size), indexing="ij"), -1
    ).reshape(-1, 2)
    found = [
        _widest_gap(disparity.flatten()[squares_around(at, size).flatten(1)], minimum)[0]
        for at in torch.split(positions, _PIXELS)
    ]
    return torch.cat(found).view(size)


def _widest_gap(values: Tensor, minimum: float) -> tuple[Tensor, Tensor]:
    """Whether values [n, K] have a gap as between surfaces, bool [n], and its middle [n].

    Infinite values are left out.
    """
    ascending = values.sort(1).values
    known = torch.isfinite(ascending)
    step = torch.where(known[:, 1:], ascending.diff(dim=1), 0.0)
    widest, where = step.max(1)
    last = known.sum(1, keepdim=True) - 1
    span = (ascending.gather(1, last) - ascending[:, :1])[:, 0]
    middle = ascending.gather(1, where[:, None])[:, 0] + widest / 2
    return (widest > minimum) & (widest > _GAP * span), middle


def _mean_colors(image: Pixels, row: Tensor, column: Tensor, size: tuple[int, int]) -> Tensor:
    """The mean encoded colours [C, h, w] of the pixels that are nearest to each coarse pixel."""
    H, W = image.shape[-2:]
    if size[0] > H or size[1] > W:  # some coarse pixels have no pixel of their own
        own = _nearest(size[0], H), _nearest(size[1], W)
        return _encoded(image[..., :, :])[:, own[0]][:, :, own[1]]
    total = torch.zeros((image.shape[0], *size), dtype=torch.float64)
    for first, end in bands(image):
        colors = _encoded(image[..., first:end, :])
        across = total.new_zeros((*colors.shape[:2], size[1])).index_add_(2, column, colors)
        total.index_add_(1, row[first:end], across)
    count = torch.bincount(row)[:, None] * torch.bincount(column)
    return total / count


def _encoded(image: Tensor) -> Tensor:
    """Colours as evenly spaced as the eye sees them; any that is no number is black."""
    return image.detach().double().nan_to_num(0, 0, 0).clamp_(min=0).pow_(_GAMMA)


def _pick_surface(votes: _Votes, minimum: float) -> Tensor:
    """The disparity [n] of the surface with most of the votes."""
    left = torch.ones_like(votes.disparity, dtype=torch.bool)
    for _ in range(_ROUNDS):
        of_left = torch.where(left, votes.disparity, torch.inf)
        is_split, middle = _widest_gap(of_left, minimum)
        nearer = left & (votes.disparity > middle[:, None])
        farther = left & ~nearer
        chosen = torch.where(_more_alike(votes, nearer, farther)[:, None], nearer, farther)
        left = torch.where(is_split[:, None], chosen, left)
    weight = votes.nearness * left
    return ((weight * votes.here).sum(1) / weight.sum(1)).clamp(min=0)


def _more_alike(votes: _Votes, nearer: Tensor, farther: Tensor) -> Tensor:
    """Whether the nearer coarse pixels, bool [n, K], have more votes than the farther: bool [n]."""
    means, variances = [], []
    for surface in (nearer, farther):
        weight = votes.nearness * surface
        weight = weight / weight.sum(1, keepdim=True).clamp(min=1e-12)
        mean = (votes.colors * weight).sum(2)
        means.append(mean)
        variances.append(((votes.colors - mean[:, :, None]).square().sum(0) * weight).sum(1))
    apart = (means[0] - means[1]).square().sum(0)
    variance = _APART**2 * apart + _VARIED * (variances[0] + variances[1])
    distance = (votes.colors - votes.own[:, :, None]).square().sum(0)
    likeness = torch.exp(distance / (-2 * variance.clamp(min=1e-8)[:, None])) + _UNLIKE
    weight = votes.nearness * likeness
    more: Tensor = (weight * nearer).sum(1) > (weight * farther).sum(1)
    return more

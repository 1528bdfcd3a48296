"""Sub-pixel shifts: how parts of the aperture see a surface near focus.

A part of the aperture sees a surface shifted by r times the part's centroid. Near focus slices lose
a part of it: a kernel sampled by area has no shift within a pixel, and shares in two slices
keep the second moment of a blur, not its first. The lost shift times the gradient of the colours
is added (Taylor); so is the third moment, for the blur of a half has a tail on one side.
This changes no coverage, and only the pair: the centroids of the parts sum to 0.
"""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor

from defocus_core.images.box import Box
from defocus_core.layers.ladder import SHARP, SOFT
from defocus_core.optics.aperture import LEFT, Aperture, Part
from defocus_core.optics.pupil_moments import centroid, moments, third_moment

# Radius in px up to which slices get shifts; beyond, less than 0.03 px is lost.
NEAR = 2.0
# Radii in px up to which the third moment counts, and from which it does not: more blurred colours
# no longer have the third derivative of the sharp ones.
_TAILED, _BLURRED = 1.0, 1.5
# Half width in px of the stencil of a colour's gradient.
AROUND = 2
# Centroids whose |y| is less lie level with the middle of the lens.
_LEVEL = 1e-6
# Neighbours whose radii differ by less, in px, are of one surface.
_SAME = 0.513


@lru_cache(maxsize=64)
def _apparent(radii: tuple[float, ...], aperture: Aperture) -> tuple[tuple[float, float], ...]:
    """The radius in px that the blur of a left half shows on each slice, and its third moment."""
    whole, tail = centroid(aperture, LEFT)[0], third_moment(aperture)
    rows = []
    for r in radii:
        if abs(r) < NEAR:
            x, _, cube = moments(r, aperture, LEFT)
            rows.append((x / whole, cube / whole))
        else:
            rows.append((r, tail * r**3))
    return tuple(rows)


class Shifts:
    """The sub-pixel shifts that aperture parts add to the colours of a surface."""

    def __init__(
        self,
        color: Tensor,
        signed_radius: Tensor,
        places: Tensor,
        inner: Box,
        radii: tuple[float, ...],
        aperture: Aperture,
        parts: list[Part],
    ) -> None:
        """Keep the surface.

        Args:
            color: [C, H, W].
            signed_radius: [H, W] px.
            places: [H, W] positions on the ladder of slices.
            inner: The rectangle from whose corner boxes are counted.
            radii: [K] px, of the slices.
            aperture: The pupil.
            parts: M parts of the pupil.
        """
        self._color, self._radius, self._places = color, signed_radius, places
        self._whole = Box(-inner.top, -inner.left, *signed_radius.shape)
        self._apparent = places.new_tensor(_apparent(radii, aperture))
        self._tail = third_moment(aperture)
        # up to this radius pixels have shares in slices near focus
        self._end = min((abs(r) for r in radii if abs(r) >= NEAR), default=math.inf)
        centroids = [centroid(aperture, part) for part in parts]
        # x, and y unless all parts are level with the middle
        dims = 1 if all(abs(y) < _LEVEL for _, y in centroids) else 2
        self._centroids = places.new_tensor(centroids)[:, :dims]

    def over(self, box: Box) -> Tensor | None:
        """The shifts of the surface within a rectangle, [M, C, h, w].

        None if no pixel in it is near focus; on a GPU this is not tested, for reading the answer
        would stall it.
        """
        around = box.grown(AROUND, self._whole)
        inner, around = box.seen_from(around), around.seen_from(self._whole)
        color, radius = around.of(self._color), around.of(self._radius)
        places, r = inner.of(around.of(self._places)), inner.of(radius)
        size = r.abs()
        if size.is_cpu and not bool(((size < self._end) & (size > SHARP)).any()):
            return None
        lower = places.detach().floor().clamp(max=max(len(self._apparent) - 2, 0))
        share, number = places - lower, lower.long().flatten()
        lower_row, upper_row = (
            self._apparent.index_select(0, (number + i).clamp(max=len(self._apparent) - 1))
            for i in (0, 1)
        )
        apparent, cube = torch.lerp(lower_row, upper_row, share.flatten()[:, None]).mT.reshape(
            2, *r.shape
        )
        # like positions on the ladder, shifts begin between SHARP and SOFT
        started = ((size - SHARP) / (SOFT - SHARP)).clamp(0, 1)
        axes = (-1, -2)[: self._centroids.shape[1]]
        slopes = torch.stack([inner.of(_slope(color, radius, dim)) for dim in axes])
        changes = slopes * (apparent - started * r)
        third = (cube - started * self._tail * r**3) / 6
        third = third * ((_BLURRED - size) / (_BLURRED - _TAILED)).clamp(0, 1)
        changes[0] += inner.of(_third(color, radius)) * third
        moved: Tensor = self._centroids[:, 0, None, None, None] * changes[0]
        for coordinate, change in zip(self._centroids.unbind(1)[1:], changes[1:], strict=True):
            moved = moved.addcmul(coordinate[:, None, None, None], change)
        return moved


def _slope(color: Tensor, signed_radius: Tensor, dim: int) -> Tensor:
    """The derivative [C, H, W] within each surface: of fourth order, at its ends of first order."""
    steps, same = _steps(color, signed_radius, dim)
    (a, b, c, d), (p, q, r, t) = steps, same
    plain = (b + c) / (q.to(color) + r).clamp(min=1)
    return torch.where(p & q & r & t, (7 * (b + c) - a - d) / 12, plain)


def _third(color: Tensor, signed_radius: Tensor) -> Tensor:
    """The third derivative [C, H, W] along rows within each surface, 0 at its ends."""
    (a, b, c, d), (p, q, r, t) = _steps(color, signed_radius, -1)
    return torch.where(p & q & r & t, (a + d - b - c) / 2, 0.0)


def _steps(
    color: Tensor, signed_radius: Tensor, dim: int
) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Two steps of colour [C, H, W] before each pixel and two after, and which are of one surface.

    A step between two surfaces is 0.
    """
    n = signed_radius.shape[dim]
    same = signed_radius.detach().diff(dim=dim).abs() < _SAME
    step = color.diff(dim=dim) * same
    no_step, no_pair = (torch.zeros_like(x.narrow(dim, 0, 1)) for x in (color, signed_radius))
    no_pair = no_pair.bool()
    steps = torch.cat([no_step, no_step, step, no_step, no_step], dim)
    same_steps = torch.cat([no_pair, no_pair, same, no_pair, no_pair], dim)
    return tuple(steps.narrow(dim, i, n) for i in range(4)), tuple(
        same_steps.narrow(dim, i, n) for i in range(4)
    )

"""Shifts of less than a pixel: how parts of the aperture see what is near focus.

A part of the aperture sees a surface shifted by r times the part's centroid. Near focus slices lose
of this: kernels sampled by area know no shift within a pixel, and shares in two slices keep the
second moment of a blur, not its first. What is missing is made up for to first order, by the
gradient of the surface's own colours (Taylor). It changes no coverage, and only the pair: the
centroids of the parts add up to nothing.
"""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor

from defocus_core.aperture import LEFT, Aperture, Part, kernel
from defocus_core.slicing import SHARP, SOFT
from defocus_core.tiling import Box

# Radii in px of slices whose shifts are made up for; beyond, what is missing is less than 0.03 px.
NEAR = 2.0
# Radius in px of the kernel of which a centroid is taken.
_SAMPLED = 48.0
# Px around a pixel that decide the gradient of its colours.
AROUND = 2
# Centroids less far than this above or below the middle of the lens are level with it.
_LEVEL = 1e-6
# Neighbours whose radii differ by less, in px, are of the same surface.
_SAME = 0.5


@lru_cache(maxsize=256)
def centroid(aperture: Aperture, part: Part) -> tuple[float, float]:
    """The mean lens point (u.x, u.y) of a part of the pupil, to about 1e-4."""
    x, y = _shift(_SAMPLED, aperture, part)
    return x / _SAMPLED, y / _SAMPLED


@lru_cache(maxsize=64)
def _apparent_radii(radii: tuple[float, ...], aperture: Aperture) -> tuple[float, ...]:
    """The radii in px that slices seem to have by the shift of their halves."""
    whole = centroid(aperture, LEFT)[0]
    return tuple(r if abs(r) >= NEAR else _shift(r, aperture, LEFT)[0] / whole for r in radii)


def _shift(r: float, aperture: Aperture, part: Part) -> tuple[float, float]:
    """Px to the right and downwards by which the kernel of a part shifts what it blurs."""
    extent = math.ceil(abs(r))
    shares = kernel(torch.tensor(r, dtype=torch.float64), 2 * extent + 1, aperture, part)
    offset = torch.arange(-extent, extent + 1, dtype=shares.dtype)
    return float(shares.sum(0) @ offset), float(shares.sum(1) @ offset)


class Shifts:
    """What parts of the aperture add to the colours of a surface near focus."""

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
            inner: Where in it rectangles are counted from.
            radii: [K] px, of the slices.
            aperture: The pupil.
            parts: M parts of it.
        """
        self._color, self._radius, self._places = color, signed_radius, places
        self._whole = Box(-inner.top, -inner.left, *signed_radius.shape)
        self._apparent = places.new_tensor(_apparent_radii(radii, aperture))
        # up to there pixels have shares in slices near focus
        self._end = min((abs(r) for r in radii if abs(r) >= NEAR), default=math.inf)
        centroids = [centroid(aperture, part) for part in parts]
        # x, and y where it makes a difference
        dims = 1 if all(abs(y) < _LEVEL for _, y in centroids) else 2
        self._centroids = places.new_tensor(centroids)[:, :dims]

    def over(self, box: Box) -> Tensor | None:
        """For a slice that has all of a surface within a rectangle: [M, C, h, w].

        None if nothing there is near focus.
        """
        around = box.grown(AROUND, self._whole)
        inner, around = box.seen_from(around), around.seen_from(self._whole)
        color, radius = around.of(self._color), around.of(self._radius)
        places, r = inner.of(around.of(self._places)), inner.of(radius)
        size = r.abs()
        if not bool(((size < self._end) & (size > SHARP)).any()):
            return None
        lower = places.detach().floor().clamp(max=max(len(self._apparent) - 2, 0))
        share, number = places - lower, lower.long().flatten()
        here, other = (
            self._apparent.index_select(0, (number + i).clamp(max=len(self._apparent) - 1))
            for i in (0, 1)
        )
        # as positions do, it begins between SHARP and SOFT
        wanted = r * ((size - SHARP) / (SOFT - SHARP)).clamp(0, 1)
        missing = torch.lerp(here.view_as(r), other.view_as(r), share) - wanted
        dims = (-1, -2)[: self._centroids.shape[1]]
        slopes = torch.stack([inner.of(_slope(color, radius, dim)) for dim in dims])
        return torch.einsum("md,dchw->mchw", self._centroids, slopes * missing)


def _slope(color: Tensor, signed_radius: Tensor, dim: int) -> Tensor:
    """The derivative [C, H, W] within each surface: of fourth order, of first at its ends."""
    n = signed_radius.shape[dim]
    if n == 1:
        return torch.zeros_like(color)
    same = signed_radius.detach().diff(dim=dim).abs() < _SAME
    step = color.diff(dim=dim) * same
    none, nowhere = (torch.zeros_like(x.narrow(dim, 0, 1)) for x in (step, same))
    steps = torch.cat([none, none, step, none, none], dim)
    some = torch.cat([nowhere, nowhere, same, nowhere, nowhere], dim)
    (a, b, c, d), (p, q, r, t) = ([x.narrow(dim, i, n) for i in range(4)] for x in (steps, some))
    plain = (b + c) / (q.to(color) + r).clamp(min=1)
    return torch.where(p & q & r & t, (7 * (b + c) - a - d) / 12, plain)

"""Slopes: how a part of the aperture sees a surface whose radius or colour changes over pixels.

Lens point u sees pixel q at q + r(q) u. Where the radius changes from pixel to pixel, this map
stretches or compresses the surface: its pixels land 1 + u·∇r apart (the determinant of the
derivative). So a pixel stands for a share 1 + u·∇r of the light that u sees; without it a tilted
surface appears too thin from one side and too thick from the other.

A part of the aperture sees a surface shifted by r times the part's centroid. Near focus slices lose
a part of this shift: kernels sampled by area have no shift within a pixel, and shares in two slices
keep the second moment of a blur, not its first. The gradient of the surface's own colours adds the
lost part (Taylor). Coverage does not change, and neither does the centre image: the centroids of
the parts sum to zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.parts import LEFT, Part
from defocus_core.renderer.layers.slice_radii import SHARP, SOFT, slice_before, slice_position
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.neighbourhoods import range_of
from defocus_core.tensors.validation import Scalar

# Slopes in px per px, below which the limiter is nearly a plain mean.
SMALL = 0.05
# Half width in px of the square around a pixel, and the share of it that must be steep.
HALF_WIDTH = 5
AREA = 0.345  # no share of whole pixels, so that rounding decides nothing
# Px around a pixel that decide its slope, and the gradient of its colours.
AROUND = HALF_WIDTH + 1


def slopes(signed_radius: Tensor, minimum: float = 0.0) -> Tensor | None:
    """The gradient ∇r of radii in px per px, x then y: [2, ..., H, W], at most 1 long.

    At a depth edge it is the slope of the pixel's own surface, to 0.01. Longer slopes, at which
    some lens points see the back of the surface, are shortened to 1.

    `signed_radius`: [..., H, W] px; `minimum`: slopes up to this count as 0. Returns None if all
    slopes are 0.
    """
    x, y = _limited(signed_radius, -1), _limited(signed_radius, -2)
    square = torch.addcmul(x * x, y, y)
    lowest, highest = range_of(square.detach()).tolist()
    if highest <= minimum * minimum:
        return None
    steep = square.detach() > minimum * minimum
    some_flat = lowest <= minimum * minimum
    if minimum and some_flat:
        steep &= _many_around(steep)
        if not bool(steep.any()):
            return None
    if highest > 1:
        short = square.clamp(min=1).rsqrt()
        x, y = x * short, y * short
    gradient = torch.stack([x, y])
    return gradient * steep.to(gradient.dtype) if some_flat else gradient


def _many_around(mask: Tensor) -> Tensor:
    """Whether a sufficient share of the square around each pixel is in a mask: [..., H, W] bool."""
    share, side = mask.to(torch.float32)[None], 2 * HALF_WIDTH + 1
    for size in ((1, side), (side, 1)):
        around = (size[0] // 2, size[1] // 2)
        share = torch.nn.functional.avg_pool2d(share, size, 1, around, count_include_pad=False)
    return share[0] > AREA


def _limited(r: Tensor, dim: int) -> Tensor:
    """A mean of the differences to both neighbours along `dim`; the smaller one counts more.

    The limiter of van Albada et al. (1982), smooth at 0.
    """
    if r.shape[dim] == 1:
        return torch.zeros_like(r)
    n, step = r.shape[dim], r.diff(dim=dim)
    steps = torch.cat([step.narrow(dim, 0, 1), step, step.narrow(dim, -1, 1)], dim)
    weights = torch.addcmul(sent(SMALL**2, steps), steps, steps)
    (a, b), (a2, b2) = ((x.narrow(dim, 0, n), x.narrow(dim, 1, n)) for x in (steps, weights))
    return torch.addcmul(a * b2, b, a2) / (a2 + b2)


# Radius in px of slices up to which lost shifts are added; beyond, less than 0.03 px is lost.
NEAR = 2.0
# Px around a pixel that decide the gradient of its colours.
_BESIDE = 1
# Centroids less far than this above or below the middle of the lens are level with it.
_LEVEL = 1e-6
# Neighbours whose radii differ by less, in px, are of the same surface.
SAME = 0.513


@lru_cache(maxsize=64)
def _apparent(radii: tuple[float, ...], aperture: Aperture, half: Part) -> tuple[Scalar, ...]:
    """The radii in px of exact discs whose left halves are shifted as much as sampled slices."""
    whole = aperture.centroid(half)[0]
    return tuple(aperture.first_moments(r, half)[0] / whole if abs(r) < NEAR else r for r in radii)


class Shifts:
    """The change of a surface's colours near focus, for each part of the aperture."""

    def __init__(
        self,
        color: Tensor,  # [C, H, W]
        signed_radius: Tensor,  # [H, W] px
        inner: Box,
        radii: tuple[float, ...],  # [K] px, of the slices
        aperture: Aperture,
        parts: list[Part],
    ) -> None:
        """Keep the colours and radii of a surface, and the shifts of its slices.

        `inner`: a rectangle of the surface, to whose upper left corner boxes given to
        `color_change` are relative.
        """
        self._color, self._radius = color, signed_radius
        self._positions = slice_position(signed_radius, radii)
        self._whole = Box(-inner.top, -inner.left, *signed_radius.shape[-2:])
        requires_grad = aperture.requires_grad
        apparent = _apparent.__wrapped__ if requires_grad else _apparent
        half = parts[0] if parts[0].is_uneven else LEFT
        known = aperture if requires_grad else aperture.fixed
        self._apparent = stacked(apparent(radii, known, half), signed_radius)  # [K]
        centroids = [aperture.centroid(part) for part in parts]
        # x, and y where it makes a difference
        level = (torch.as_tensor(y * y < _LEVEL**2).all() for _, y in centroids)
        dims = 1 if all(map(bool, level)) else 2
        means = stacked([mean for pair in centroids for mean in pair], signed_radius)
        self._centroids = means.view(-1, 2)[:, :dims]

    def color_change(self, box: Box) -> Tensor:
        """The change [M, C, h, w] of the colours of the surface within a rectangle."""
        around = box.grown(_BESIDE, self._whole)
        inner, around = box.seen_from(around), around.seen_from(self._whole)
        color, radius = around.crop(self._color), around.crop(self._radius)
        positions, r = inner.crop(around.crop(self._positions)), inner.crop(radius)
        lower = slice_before(positions.detach())
        fraction, number = positions - lower, lower.long()
        pairs = [(number + i).clamp(max=len(self._apparent) - 1) for i in (0, 1)]
        first, second = (self._apparent.index_select(0, each.flatten()) for each in pairs)
        apparent = torch.lerp(first, second, fraction.flatten()).reshape(r.shape)
        # as positions do, it begins between SHARP and SOFT
        begun = ((r.abs() - SHARP) / (SOFT - SHARP)).clamp(0, 1)
        dims = (-1, -2)[: self._centroids.shape[1]]
        slopes = torch.stack([inner.crop(slope_within(color, radius, dim, SAME)) for dim in dims])
        changes = slopes * (apparent - begun * r)
        first_mean, *means = (mean.view(-1, 1, 1, 1) for mean in self._centroids.unbind(1))
        moved: Tensor = first_mean * changes[0]
        for mean, change in zip(means, changes[1:], strict=True):
            moved = moved.addcmul(mean, change)
        return moved


def stacked(values: Sequence[Scalar], like: Tensor) -> Tensor:
    """A tensor [n] made of numbers and one-element tensors, through which gradients flow."""
    return sent(torch.stack([torch.as_tensor(v, dtype=torch.float64) for v in values]), like)


def along_first(values: Sequence[Scalar], like: Tensor) -> Tensor:
    """Numbers [n] as a tensor [n, 1, ...] that broadcasts along the first dimension of `like`."""
    return stacked(values, like).view(-1, *[1] * (like.dim() - 1))


def slope_within(color: Tensor, signed_radius: Tensor, dim: int, below: float) -> Tensor:
    """The derivative [C, H, W] of colours along `dim` within the surface of each pixel.

    It is the mean of the steps on both sides of a pixel; a step to another surface, whose radius
    differs by `below` px or more, does not count.
    """
    n, around = signed_radius.shape[dim], (1, 1) if dim == -1 else (0, 0, 1, 1)
    same = (signed_radius.detach().diff(dim=dim).abs() < below).to(color)
    steps, counts = (torch.nn.functional.pad(x, around) for x in (color.diff(dim=dim) * same, same))
    total, count = (x.narrow(dim, 0, n) + x.narrow(dim, 1, n) for x in (steps, counts))
    return total / count.clamp(min=1)

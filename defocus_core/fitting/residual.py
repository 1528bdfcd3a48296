"""What a point makes of the sharp picture, and its difference from what is observed.

Differences are taken of light compressed by x / (x + m), so that no light outweighs a scene.
They count less where they are large (Huber), and not where light is clipped, where a clipped light
is blurred, whose strength nobody knows, nor where the rendering invents. Gains follow by least
squares; so does, with a falloff, a factor of each view over the frame: that of a wide opening is
not that of a narrow one, and outweighs the blur.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from defocus_core.fitting.pictures import Scale, registered
from defocus_core.optics.aperture import Aperture
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.tensors.views import Views

BEND = 0.02  # of compressed light, from which on a difference counts less
_CLIPPED = 0.98  # of the greatest value, in pictures that end at 1
_TRUSTED = 0.9  # fraction of the lens, from which on a pixel counts
_MIN_WEIGHT = 0.05  # mean of a picture of which enough counts
_LOST = 1e-3  # share of clipped light in a pixel of which nothing can be said
_FAINT = 1e-7  # of a channel of lost light, which must not decide how colours are filled in
_FALLOFF = 4  # degree of the light's falloff to the corners, as that of cos⁴
_CELLS = 32  # along a side, within which a factor over the frame is the same
_KEPT = 4  # renderings, as a registration needs no other
_ABOUT = 100  # renderings of a fit


class Optics(NamedTuple):
    """The pupil and the photodiodes that a point is rendered with."""

    aperture: Aperture
    dual_pixel: DualPixel


class Point(NamedTuple):
    """A value of each unknown."""

    strength: float  # k, px of radius for a disparity of 1, in the sharp picture
    focus: float  # d₀, the disparity in focus
    across: float = 0.0  # px by which the blurred picture lies to the right of the sharp one
    down: float = 0.0  # px by which it lies below
    magnification: float = 1.0  # of the blurred picture over the sharp one, about the middle
    # How far left and right are apart, in the distance of halves of the pupil that share no
    # light; below 0 they are exchanged
    separation: float = 1.0


class Residual:
    """The differences between what points make and what is observed."""

    def __init__(
        self,
        sharp: Tensor,  # [C, H, W]
        disparity: Tensor,  # [H, W]
        observed: tuple[Tensor, ...],
        *,
        falloff: bool,
        rendered: Callable[..., Views],
        edge_width: float | None = None,  # as for `render`, in px of the pictures
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """Keep the pictures."""
        self.width = sharp.shape[2]
        self._falloff, self._render_as, self._edge_width = falloff, rendered, edge_width
        self._progress, self._done = progress, 0
        self._pictures = sharp, disparity, torch.stack(observed)
        self._middle = float(observed[0].float().abs().median().clamp_min(1e-3))
        top = float(observed[0].max())
        self._white = _CLIPPED * top if top <= 1.001 else math.inf
        self._scales: dict[int, Scale] = {}
        self._rendered: dict[object, tuple[Tensor, Tensor]] = {}

    def scale(self, width: int | None) -> Scale:
        """The pictures at a width in px; None for their own."""
        width = min(width or self.width, self.width)
        if width not in self._scales:
            self._scales[width] = Scale(*self._pictures, width)
        return self._scales[width]

    def of(self, point: Point, optics: Optics, scale: Scale) -> tuple[Tensor, Tensor]:
        """Differences of compressed light [V, C, H, W], and weights [V, 1, H, W]."""
        light, weight, _ = self.modelled(point, optics, scale)
        one, other = (x.clamp_min(0) for x in (light, scale.observed))
        return one / (one + self._middle) - other / (other + self._middle), weight

    def modelled(self, point: Point, optics: Optics, scale: Scale) -> tuple[Tensor, Tensor, Tensor]:
        """What a camera stores of a point [V, C, H, W], its weight [V, 1, H, W], and gains [C]."""
        light, trust = self._render(point, optics, scale)
        if scale.lost is not None:
            light, lost = light[:, :-1], light[:, -1]
            trust = trust * (1 - lost.amax(0) / (_FAINT * _LOST)).clamp(0, 1)
        if len(light) > 1:
            light = light[:1] + point.separation * (light[1:] - light[:1])
        sure = ((trust - _TRUSTED) / (1 - _TRUSTED)).clamp(0, 1)
        across, down = point.across * scale.factor, point.down * scale.factor
        if across or down or point.magnification != 1:
            light, inside = registered(light, across, down, point.magnification)
            sure = sure * inside
        weight = sure * (scale.observed.amax(1, keepdim=True) < self._white).float()
        common = weight / (scale.observed + self._middle) ** 2
        product = (common * light * scale.observed).sum((0, 2, 3))
        gains = product / (common * light * light).sum((0, 2, 3)).clamp_min(1e-12)
        light = light * gains[:, None, None]
        if self._falloff:
            light = light * _falloff(light, scale.observed, common)
        return light, weight, gains

    def _render(self, point: Point, optics: Optics, scale: Scale) -> tuple[Tensor, Tensor]:
        """The views of light that a blur makes, and their trust [H, W].

        The centre alone [1, C, H, W], or the centre, left and right. Where lights of the sharp
        picture are clipped, their share is a channel more.
        """
        key = (point.strength, point.focus, optics, id(scale))
        if key in self._rendered:
            return self._rendered[key]
        strength = point.strength * scale.factor
        lost = [] if scale.lost is None else [_FAINT * scale.lost]
        width = self._edge_width
        views = self._render_as(
            torch.cat([scale.sharp, *lost]),
            strength * (point.focus - scale.disparity),
            aperture=optics.aperture,
            dual_pixel=optics.dual_pixel,
            left_right=len(scale.observed) > 1,
            edge_width=None if width is None else width * scale.factor,
            infinity=strength * point.focus,
        )
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, max(self._done, _ABOUT))
        found = torch.stack(list(views.images)), views.trust[0]
        self._rendered[key] = found
        if len(self._rendered) > _KEPT:
            self._rendered.pop(next(iter(self._rendered)))
        return found


def _falloff(light: Tensor, observed: Tensor, common: Tensor) -> Tensor:
    """The factor of each view over the frame [V, 1, H, W] by least squares: of yⁱ xʲ, i + j ≤ 4."""
    size = [min(_CELLS, side) for side in light.shape[2:]]
    squares, products = (
        interpolate((common * light * each).sum(1, keepdim=True), size, mode="area").double()
        for each in (light, observed)
    )
    base = _monomials(size).to(squares)
    normal = torch.einsum("ihw,jhw,vchw->vij", base, base, squares)
    right = torch.einsum("ihw,vchw->vi", base, products)
    ridge = 1e-9 * normal.diagonal(dim1=1, dim2=2).amax().clamp_min(1e-30)
    normal = normal + ridge * torch.eye(len(base)).to(normal)
    factors = torch.linalg.solve(normal, right)
    whole = _monomials(list(light.shape[2:])).to(factors)
    return torch.einsum("vi,ihw->vhw", factors, whole)[:, None].to(light)


def _monomials(size: list[int]) -> Tensor:
    """The products yⁱ xʲ, i + j ≤ 4, of places from -1 to 1 over a frame: [15, h, w]."""
    degrees = torch.arange(_FALLOFF + 1)[:, None]
    rows, columns = (((2 * torch.arange(n).double() + 1) / n - 1) ** degrees for n in size)
    i, j = torch.ones(_FALLOFF + 1, _FALLOFF + 1).triu().fliplr().nonzero().unbind(1)
    return rows[i][:, :, None] * columns[j][:, None]


def error_of(residual: Tensor, weight: Tensor) -> float:
    """The mean of Huber's measure, over what counts; infinite if hardly anything does."""
    if float(weight.mean()) < _MIN_WEIGHT:
        return math.inf
    return float((measure_of(residual) * weight).sum() / (weight.sum() * residual.shape[1]))


def measure_of(residual: Tensor) -> Tensor:
    """Huber's measure of differences."""
    size = residual.abs()
    return torch.where(size < BEND, size**2 / 2, BEND * (size - BEND / 2))


def robust_of(residual: Tensor, weight: Tensor) -> Tensor:
    """Weights [V, C, H, W] by which least squares take Huber's measure."""
    return weight * (BEND / residual.abs().clamp_min(1e-9)).clamp_max(1)

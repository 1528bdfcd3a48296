"""What a point makes of the sharp picture, and its difference from what is observed.

Differences are taken of light compressed by x / (x + m), so that no light outweighs a scene.
They count less where they are large (Huber), and not where light is clipped, where a clipped light
is blurred, whose strength nobody knows, nor where the rendering invents. They are of the numbers of
the pictures, not of what a gamma makes of them. With an exposure each view has a falloff of its own
over the frame: that of a wide opening is not that of a narrow one, and outweighs the blur.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from defocus_core.fitting.pictures import Scale, border_of, registered
from defocus_core.fitting.unknowns import Candidate
from defocus_core.optics.aperture import Aperture
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.renderer.render import render

BEND = 0.02  # of compressed light, from which on a difference counts less
_CLIPPED = 0.98  # of the greatest value, in pictures that end at 1
_TRUSTED = 0.9  # fraction of the lens, from which on a pixel counts
_MIN_WEIGHT = 0.05  # mean of a picture of which enough counts
_LOST = 1e-3  # share of clipped light in a pixel of which nothing can be said
_FAINT = 1e-7  # of a channel of lost light, which must not decide how colours are filled in
_FALLOFF = 4  # degree of the light's falloff to the corners, as that of cos⁴
_CELLS = 32  # along a side, within which a factor over the frame is the same
_KEPT = 4  # renderings, as a registration needs no other


class Optics(NamedTuple):
    """The pupil and the photodiodes that a point is rendered with."""

    aperture: Aperture
    dual_pixel: DualPixel


class Modelled(NamedTuple):
    """What a point makes."""

    light: Tensor  # numbers that a camera stores [V, C, H, W]
    weight: Tensor  # [V, 1, H, W]
    gains: Tensor  # the factor of light of each channel [C]; ones if the exposure is the same
    # Of each view the factor in the middle, and its change over half a frame [V, 3]; or none
    shading: Tensor


class Residual:
    """The differences between what points make and what is observed."""

    def __init__(
        self,
        sharp: Tensor,  # [C, H, W]
        disparity: Tensor,  # [H, W]
        observed: tuple[Tensor, ...],
        *,
        exposure: bool,
        side_shading: bool = False,
        depth_repair: str = "auto",
        edge_width: float | None = None,  # as for `render`, in px of the pictures
        threads: int = 1,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """Keep the pictures."""
        self.width = sharp.shape[2]
        self.exposure, self.side_shading = exposure, side_shading
        self._progress, self._done = progress, 0
        self._repair, self._edge_width = depth_repair, edge_width
        self._threads = threads
        self._pictures = (sharp, disparity, observed)
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

    def of(self, point: Candidate, optics: Optics, scale: Scale) -> tuple[Tensor, Tensor]:
        """Differences of compressed light [V, C, H, W], and weights [V, 1, H, W]."""
        light, weight, *_ = self.modelled(point, optics, scale)
        return self.compressed(light) - self.compressed(torch.stack(scale.observed)), weight

    def modelled(self, point: Candidate, optics: Optics, scale: Scale) -> Modelled:
        """What a camera stores of a point."""
        light, weight = self._stored(point, optics, scale)
        observed = torch.stack(scale.observed)
        gains, shading = torch.ones(light.shape[1]), light.new_zeros(0, 3)
        if self.exposure:
            gains = self._factors(light, observed, weight)
            light = light * gains[:, None, None]
        if self.side_shading:
            planes = self._smooth_factors(light, observed, weight, 1)
            light = light * _surface(planes, light)
            shading = planes[:, (0, 0, 1), (0, 1, 0)]
        if self.exposure:
            light = light * _surface(self._smooth_factors(light, observed, weight, _FALLOFF), light)
        return Modelled(light, weight, gains**point.gamma, shading)

    def _stored(self, point: Candidate, optics: Optics, scale: Scale) -> tuple[Tensor, Tensor]:
        """What `modelled` is without factors."""
        modelled, trust = self._render(point, optics, scale)
        if scale.lost is not None:
            modelled, lost = modelled[:, :-1], modelled[:, -1]
            trust = trust * (1 - lost.amax(0) / (_FAINT * _LOST)).clamp(0, 1)
        if len(modelled) > 1:
            modelled = modelled[:1] + point.separation * (modelled[1:] - modelled[:1])
        if point.gamma != 1:
            modelled = modelled.clamp_min(0) ** (1 / point.gamma)
        sure = ((trust - _TRUSTED) / (1 - _TRUSTED)).clamp(0, 1)
        across, down = point.across * scale.factor, point.down * scale.factor
        if across or down or point.magnification != 1:
            modelled = registered(modelled, across, down, point.magnification)
            sure = sure.clone()
            for side, shift in ((sure.mT, across), (sure, down)):
                if border := border_of(shift, point.magnification, len(side)):
                    side[:border] = side[-border:] = 0
        unclipped = (torch.stack(scale.observed).amax(1, keepdim=True) < self._white).float()
        return modelled, sure * unclipped

    def _render(self, point: Candidate, optics: Optics, scale: Scale) -> tuple[Tensor, Tensor]:
        """The views of light that a blur makes, and their trust [H, W].

        The centre alone [1, C, H, W], or the centre, left and right. Where lights of the sharp
        picture are clipped, their share is a channel more.
        """
        key = (point.rendered, optics, id(scale))
        if key in self._rendered:
            return self._rendered[key]
        strength = point.strength * scale.factor
        light = scale.sharp if point.gamma == 1 else scale.sharp.clamp_min(0) ** point.gamma
        views = render(
            light if scale.lost is None else torch.cat([light, _FAINT * scale.lost]),
            strength * (point.focus - scale.disparity),
            aperture=point.turned(optics.aperture),
            dual_pixel=optics.dual_pixel,
            left_right=len(scale.observed) > 1,
            threads=self._threads,
            infinity=strength * point.focus,
            depth_repair=self._repair,
            edge_width=None if self._edge_width is None else self._edge_width * scale.factor,
        )
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, max(self._done, 100))
        fitted = torch.stack(list(views.images)), views.trust[0]
        self._rendered[key] = fitted
        if len(self._rendered) > _KEPT:
            self._rendered.pop(next(iter(self._rendered)))
        return fitted

    def _factors(self, modelled: Tensor, observed: Tensor, weight: Tensor) -> Tensor:
        """The factor of each channel [C] by least squares."""
        common = weight / (observed + self._middle) ** 2
        return (common * modelled * observed).sum((0, 2, 3)) / (common * modelled * modelled).sum(
            (0, 2, 3)
        ).clamp_min(1e-12)

    def _smooth_factors(
        self, modelled: Tensor, observed: Tensor, weight: Tensor, degree: int
    ) -> Tensor:
        """The factor of each view by least squares: of yⁱ xʲ, i + j ≤ degree, [V, i, j]."""
        common = weight / (observed + self._middle) ** 2
        size = [min(_CELLS, side) for side in modelled.shape[2:]]
        squares, products = (
            interpolate((common * modelled * each).sum(1, keepdim=True), size, mode="area").double()
            for each in (modelled, observed)
        )
        i, j = torch.ones(degree + 1, degree + 1).triu().fliplr().nonzero().unbind(1)
        base = torch.einsum("ih,jw->ijhw", *(_powers(n, degree) for n in size))[i, j].to(squares)
        normal = torch.einsum("ihw,jhw,vchw->vij", base, base, squares)
        right = torch.einsum("ihw,vchw->vi", base, products)
        ridge = 1e-9 * normal.diagonal(dim1=1, dim2=2).amax().clamp_min(1e-30)
        ridges = ridge * torch.eye(len(base), dtype=normal.dtype, device=normal.device)
        factors = normal.new_zeros(len(modelled), degree + 1, degree + 1)
        factors[:, i, j] = torch.linalg.solve(normal + ridges, right)
        return factors.to(modelled.dtype)

    def compressed(self, light: Tensor) -> Tensor:
        """Light in [0, 1), of which a half is the middle of what is observed."""
        positive = light.clamp_min(0)
        return positive / (positive + self._middle)


def _powers(size: int, degree: int) -> Tensor:
    """Powers [degree + 1, size] of places from -1 to 1 along a side."""
    place = (2 * torch.arange(size, dtype=torch.float64) + 1) / size - 1
    return place ** torch.arange(degree + 1)[:, None]


def _surface(factors: Tensor, like: Tensor) -> Tensor:
    """Factors [V, i, j] over the frame [V, 1, H, W]."""
    rows, columns = (_powers(n, len(factors[0]) - 1).to(factors) for n in like.shape[-2:])
    return torch.einsum("vij,ih,jw->vhw", factors, rows, columns)[:, None]


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

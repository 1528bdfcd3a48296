"""The blurred picture that a point predicts, and its difference from the observed one.

Differences are taken of light compressed by x / (x + m), so that no bright light outweighs the
scene. Large differences have less weight (Huber); pixels that see clipped light, its blur (of
unknown strength) or invented content have none. With an exposure, least squares find a gain for
each channel, then a factor for each view that varies over the frame, as the falloff of a wide
aperture differs from that of a narrow one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from defocus_core.fitting.pictures import Scale, registered
from defocus_core.renderer.engine.renderer import Renderer
from defocus_core.renderer.engine.scene import Surface
from defocus_core.renderer.engine.settings import Settings

BEND = 0.02  # difference of compressed light above which the weight falls
_CLIPPED = 0.98  # share of the greatest value from which on light is clipped, if that is at most 1
_TRUSTED = 0.9  # least trust of a pixel with a weight
_MIN_WEIGHT = 0.05  # least mean weight of a picture
_LOST = 1e-3  # share of clipped light above which a pixel has no weight
_FAINT = 1e-7  # scale of the channel of clipped light, so small that it changes no invented content
_FALLOFF = 4  # degree of the falloff to the corners, as that of cos⁴
_CELLS = 32  # blocks along a side, whose means the falloff is fitted to
_KEPT = 4  # renderings that are cached, as points that differ in registration share them
_ABOUT = 60  # expected number of renderings of a fit


class Point(NamedTuple):
    """Values of the unknowns of a fit: radii, registration, and separation of left and right."""

    far: float  # signed radius at the least disparity, in px of the sharp picture
    near: float  # signed radius at the greatest disparity, likewise
    across: float = 0.0  # px by which the blurred picture lies to the right of the sharp one
    down: float = 0.0  # px by which it lies below
    growth: float = 0.0  # logarithm of the magnification of the blurred picture about the middle
    # Distance of left and right as a share of that of the sensor's model; negative if exchanged
    separation: float = 1.0


class Residual:
    """The differences between predicted and observed pictures of a pair."""

    def __init__(
        self,
        pictures: Scale,
        settings: Settings,
        *,
        exposure: bool,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """Set how to render; `infinity` of the settings holds a disparity as in `Scale`, no radius.

        `exposure`, `progress`: as for `fit`.
        """
        self._settings, self._exposure = settings, exposure
        self._progress, self._done = progress, 0
        first = pictures.observed[0]
        self._middle = float(first.float().abs().median().clamp_min(1e-3))
        top = float(first.max())
        self._white = _CLIPPED * top if top <= 1.001 else math.inf
        self._has_lost = bool(pictures.lost.any())
        self._views: dict[object, tuple[Tensor, Tensor]] = {}

    def differences(self, point: Point, pictures: Scale) -> tuple[Tensor, Tensor]:
        """Differences of compressed light [V, C, H, W], and their weights [V, 1, H, W]."""
        light, weight, _ = self.modelled(point, pictures)
        one, other = (x.clamp_min(0) for x in (light, pictures.observed))
        return one / (one + self._middle) - other / (other + self._middle), weight

    def error(self, point: Point, pictures: Scale) -> float:
        """The error of a point: `error_of` of its differences."""
        return error_of(*self.differences(point, pictures))

    def modelled(self, point: Point, pictures: Scale) -> tuple[Tensor, Tensor, Tensor]:
        """The views [V, C, H, W] that a point predicts, weights [V, 1, H, W] and gains [C]."""
        light, trust = self._blurred(point, pictures)
        observed = pictures.observed
        if self._has_lost:
            light, lost = light[:, :-1], light[:, -1]
            trust = trust * (1 - lost.amax(0) / (_FAINT * _LOST)).clamp(0, 1)
        if len(light) > 1:
            light = light[:1] + point.separation * (light[1:] - light[:1])
        sure = ((trust - _TRUSTED) / (1 - _TRUSTED)).clamp(0, 1)
        if any((point.across, point.down, point.growth)):
            shift = point.across * pictures.factor, point.down * pictures.factor
            light, inside = registered(light, *shift, math.exp(point.growth))
            sure = sure * inside
        weight = sure * (observed.amax(1, keepdim=True) < self._white).float()
        gains = torch.ones_like(light[0, :, 0, 0])
        if self._exposure:
            common = weight / (observed + self._middle) ** 2
            product = (common * light * observed).sum((0, 2, 3))
            gains = product / (common * light * light).sum((0, 2, 3)).clamp_min(1e-12)
            light = light * gains[:, None, None]
            light = light * _falloff(light, observed, common)
        return light, weight, gains

    def _blurred(self, point: Point, pictures: Scale) -> tuple[Tensor, Tensor]:
        """The blurred views of the sharp picture, and their trust [H, W].

        The views [V, C, H, W] are the centre alone, or centre, left and right. If light of the
        sharp picture is clipped, a further channel holds the share of clipped light.
        """
        key = point.far, point.near, pictures
        if key in self._views:
            return self._views[key]
        far, near = point.far * pictures.factor, point.near * pictures.factor
        width, infinity = self._settings.edge_width, self._settings.infinity
        assert infinity is not None
        settings = replace(
            self._settings,
            edge_width=None if width is None else width * pictures.factor,
            infinity=far + (near - far) * infinity,
        )
        lost = [_FAINT * pictures.lost] if self._has_lost else []
        image = torch.cat([pictures.sharp, *lost])
        surface = Surface(image, far + (near - far) * pictures.disparity)
        views = Renderer(surface, settings).picture()
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, max(self._done, _ABOUT))
        self._views[key] = torch.stack(list(views.images)), views.trust[0]
        if len(self._views) > _KEPT:
            self._views.pop(next(iter(self._views)))
        return self._views[key]


def _falloff(light: Tensor, observed: Tensor, common: Tensor) -> Tensor:
    """The factor [V, 1, H, W] of each view over the frame, a polynomial of yⁱ xʲ, i + j ≤ 4.

    It is fitted so that `light` times it becomes `observed`, with the weights `common`.
    """
    size = [min(_CELLS, side) for side in light.shape[2:]]
    squares, products = (
        interpolate((common * light * each).sum(1, keepdim=True), size, mode="area").double()
        for each in (light, observed)
    )
    base = _monomials(size).to(squares)
    normal = torch.einsum("ihw,jhw,vchw->vij", base, base, squares)
    right = torch.einsum("ihw,vchw->vi", base, products)
    ridge = 1e-9 * normal.diagonal(dim1=1, dim2=2).amax().clamp_min(1e-30)
    factors = torch.linalg.solve(normal + ridge * torch.eye(len(base)).to(normal), right)
    whole = _monomials(list(light.shape[2:])).to(factors)
    return torch.einsum("vi,ihw->vhw", factors, whole)[:, None].to(light)


def _monomials(size: list[int]) -> Tensor:
    """The products yⁱ xʲ, i + j ≤ 4, [15, h, w], with y and x from -1 to 1 over the frame."""
    degrees = torch.arange(_FALLOFF + 1)[:, None]
    rows, columns = (((2 * torch.arange(n).double() + 1) / n - 1) ** degrees for n in size)
    i, j = torch.ones(_FALLOFF + 1, _FALLOFF + 1).triu().fliplr().nonzero().unbind(1)
    return rows[i][:, :, None] * columns[j][:, None]


def error_of(residual: Tensor, weight: Tensor) -> float:
    """The weighted mean of Huber's loss of differences; inf if there is hardly any weight."""
    if float(weight.mean()) < _MIN_WEIGHT:
        return math.inf
    return float((measure_of(residual) * weight).sum() / (weight.sum() * residual.shape[1]))


def measure_of(residual: Tensor) -> Tensor:
    """Huber's loss of each difference."""
    size = residual.abs()
    return torch.where(size < BEND, size**2 / 2, BEND * (size - BEND / 2))

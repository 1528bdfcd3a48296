"""The search for the blur between two pictures: a grid, then Gauss-Newton steps.

A point is the logarithm of the strength k, in px for a disparity of 1, and the disparity in focus.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from defocus_core.optics.aperture import Aperture
from defocus_core.render import render

_RADII = (1.5, 3.0, 6.0, 12.0, 24.0, 48.0)  # px, largest blur of the coarse search
_PLACES = (0.02, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 0.98)  # quantiles of disparity in focus
_COARSE, MIDDLE = 200, 480  # px, width of small pictures
_STEPS = ((_COARSE, 4), (MIDDLE, 4), (None, 3))  # width, most Gauss-Newton steps
_STARTS = 3  # of the best of the coarse search
_BLOCKS = 6  # along each side, for the uncertainty
_CLIPPED = 0.98  # of the greatest value, in pictures that end at 1
_STEP = 0.02  # of the logarithm of the strength, and of the range of disparity
_ENOUGH = 2e-4  # a smaller step is none
_BEND = 0.02  # of compressed light, from which on a residual counts less
_ASIDE = (-1.5, -0.75, 0.0, 0.75, 1.5)  # px of radius that the focus is tried aside
_AS_GOOD = 1.002  # an error as small, by the rounding of the renderer


class _Scale:
    """The pictures at one size."""

    def __init__(self, sharp: Tensor, disparity: Tensor, seen: tuple[Tensor, ...], width: int):
        full = sharp.shape[2]
        self.factor = min(1.0, width / full)
        self.sharp, *self.seen = (self._small(each) for each in (sharp, *seen))
        height, width = self.sharp.shape[1:]
        rows = ((torch.arange(height) + 0.5) * sharp.shape[1] / height).long()
        columns = ((torch.arange(width) + 0.5) * full / width).long()
        self.disparity = disparity[rows][:, columns]

    def _small(self, image: Tensor) -> Tensor:
        if self.factor == 1.0:
            return image
        size = [max(16, round(side * self.factor)) for side in image.shape[1:]]
        return interpolate(image[None], size, mode="area")[0]


class Search:
    """The search for the blur between pictures."""

    def __init__(
        self,
        sharp: Tensor,
        disparity: Tensor,
        seen: tuple[Tensor, ...],
        exposure: bool,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        self.pictures = (sharp, disparity, seen)
        self.exposure, self._progress, self._done = exposure, progress, 0
        self._middle = float(seen[0].float().abs().median().clamp_min(1e-3))
        top = float(seen[0].max())
        self._white = _CLIPPED * top if top <= 1.001 else math.inf
        self.range = float(disparity.max() - disparity.min())
        self.zero = float(disparity.min())
        self._scales: dict[int, _Scale] = {}

    def scale(self, width: int | None) -> _Scale:
        """The pictures at a width in px; None for their own."""
        width = width or self.pictures[0].shape[2]
        if width not in self._scales:
            self._scales[width] = _Scale(*self.pictures, width)
        return self._scales[width]

    def best(self, aperture: Aperture) -> tuple[float, Tensor, Aperture]:
        """The least error, and the logarithm of the strength and the focus [2] that make it."""
        starts = sorted(self._coarse(aperture), key=lambda found: found[0])[:_STARTS]
        found = []
        for _, start in starts:
            point, error = start, math.inf
            for width, most in _STEPS[:1]:
                point, error = self._descended(point, aperture, self.scale(width), most)
            found.append((error, point))
        _, point = min(found, key=lambda each: each[0])
        for wide, most in _STEPS[1:]:
            if wide is None or wide < self.pictures[0].shape[2]:
                point, error = self._descended(point, aperture, self.scale(wide), most)
        return *self._centred(point, error, aperture), aperture

    def _centred(self, point: Tensor, error: float, aperture: Aperture) -> tuple[float, Tensor]:
        """The focus in the middle of those that are as good: within half a px all is sharp."""
        scale, strength = self.scale(None), math.exp(float(point[0]))
        px, errors = torch.tensor(_ASIDE, dtype=torch.float64), []
        for aside in _ASIDE:
            there = point + torch.tensor([0.0, aside / strength], dtype=torch.float64)
            errors.append(self._error(*self.residual(there, aperture, scale)))
        if not all(map(math.isfinite, errors)):
            return error, point
        powers = torch.stack([px**0, px, px**2], 1)
        _, slope, bend = torch.linalg.lstsq(powers, torch.tensor(errors).double()).solution.tolist()
        if bend <= 0:
            return error, point
        aside = min(max(-slope / (2 * bend), -1.0), 1.0)
        moved = point + torch.tensor([0.0, aside / strength], dtype=torch.float64)
        error_there = self._error(*self.residual(moved, aperture, scale))
        return (error_there, moved) if error_there <= error * _AS_GOOD else (error, point)

    def _coarse(self, aperture: Aperture) -> list[tuple[float, Tensor]]:
        """The error of each point of a grid."""
        scale = self.scale(_COARSE)
        values = scale.disparity.flatten().double()
        places = torch.quantile(values, torch.tensor(_PLACES, dtype=torch.float64)).tolist()
        found = []
        for radius, focus in product(_RADII, dict.fromkeys(places)):
            most = float((focus - values).abs().max())
            point = torch.tensor([math.log(radius / most), focus], dtype=torch.float64)
            residual, weight = self.residual(point, aperture, scale, quality="draft")
            found.append((self._error(residual, weight), point))
        return found

    def rendered(
        self, point: Tensor, aperture: Aperture, scale: _Scale, quality: str
    ) -> tuple[list[Tensor], Tensor]:
        """The views [C, H, W] that a blur makes, and their trust [H, W]."""
        strength, focus = math.exp(float(point[0])) * scale.factor, float(point[1])
        views = render(
            scale.sharp,
            strength * (focus - scale.disparity),
            aperture=aperture,
            quality=quality,
            left_right=len(scale.seen) > 1,
            infinity=strength * focus,
        )
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, max(self._done, 100))
        images = [views.render] if len(scale.seen) == 1 else [views.left, views.right]
        return [image for image in images if image is not None], views.trust[0]

    def residual(
        self, point: Tensor, aperture: Aperture, scale: _Scale, quality: str = "standard"
    ) -> tuple[Tensor, Tensor]:
        """Differences of compressed light [V, C, H, W], and weights [V, 1, H, W]."""
        images, trust = self.rendered(point, aperture, scale, quality)
        made, seen = torch.stack(images), torch.stack(list(scale.seen))
        sure = ((trust - 0.9) / 0.1).clamp(0, 1)
        unclipped = (seen.amax(1, keepdim=True) < self._white).float()
        weight = sure * unclipped
        if self.exposure:
            made = made * self.gains(made, seen, weight)[:, None, None]
        return self._compressed(made) - self._compressed(seen), weight

    def gains(self, made: Tensor, seen: Tensor, weight: Tensor) -> Tensor:
        """The factor of each channel [C] by least squares."""
        common = weight / (seen + self._middle) ** 2
        return (common * made * seen).sum((0, 2, 3)) / (common * made * made).sum(
            (0, 2, 3)
        ).clamp_min(1e-12)

    def _compressed(self, light: Tensor) -> Tensor:
        positive = light.clamp_min(0)
        return positive / (positive + self._middle)

    def _error(self, residual: Tensor, weight: Tensor) -> float:
        """The mean of Huber's measure, over what counts; infinite if hardly anything does."""
        if float(weight.mean()) < 0.05:
            return math.inf
        size = residual.abs()
        measure = torch.where(size < _BEND, size**2 / 2, _BEND * (size - _BEND / 2))
        return float((measure * weight).sum() / (weight.sum() * residual.shape[1]))

    def _descended(
        self, point: Tensor, aperture: Aperture, scale: _Scale, most: int
    ) -> tuple[Tensor, float]:
        """A point after Gauss-Newton steps, and its error."""
        residual, weight = self.residual(point, aperture, scale)
        error = self._error(residual, weight)
        for _ in range(most):
            hessian, gradient = self.normal(point, aperture, scale, residual, weight)
            whole = hessian.sum(0)
            damped = whole + 1e-4 * torch.diag(whole.diagonal())
            step = -torch.linalg.solve(damped + 1e-12 * torch.eye(2), gradient.sum(0))
            step = step.clamp(torch.tensor([-0.5, -0.25]), torch.tensor([0.5, 0.25]))
            scaled = torch.tensor([1.0, self.range], dtype=torch.float64)
            for shorter in (1.0, 0.35, 0.1):
                tried = point + shorter * step * scaled
                residual_there, weight_there = self.residual(tried, aperture, scale)
                error_there = self._error(residual_there, weight_there)
                if error_there < error:
                    break
            else:
                return point, error
            point, error = tried, error_there
            residual, weight = residual_there, weight_there
            if float(step.abs().max()) * shorter < _ENOUGH:
                break
        return point, error

    def normal(
        self, point: Tensor, aperture: Aperture, scale: _Scale, residual: Tensor, weight: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Of each block of the picture the matrix [B, 2, 2] and the gradient [B, 2] of a step."""
        size = residual.abs()
        robust = weight * (_BEND / size.clamp_min(1e-9)).clamp_max(1)
        slopes = []
        for index, unit in enumerate((1.0, self.range)):
            moved = point.clone()
            moved[index] += _STEP * unit
            there, _ = self.residual(moved, aperture, scale)
            slopes.append((there - residual) / _STEP)
        jacobian = torch.stack(slopes)  # [2, V, C, H, W]
        pieces_h, pieces_g = [], []
        height, width = residual.shape[2:]
        for row, column in product(range(_BLOCKS), range(_BLOCKS)):
            cut = (
                ...,
                slice(row * height // _BLOCKS, (row + 1) * height // _BLOCKS),
                slice(column * width // _BLOCKS, (column + 1) * width // _BLOCKS),
            )
            slope = jacobian[cut].flatten(1).double()
            weighed = slope * robust[cut].flatten().double()
            pieces_h.append(weighed @ slope.T)
            pieces_g.append(weighed @ residual[cut].flatten().double())
        return torch.stack(pieces_h), torch.stack(pieces_g)

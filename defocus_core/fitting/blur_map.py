"""Which blurs explain which parts of a picture: the start of a fit, for all blurs at once.

Apart from depth edges a pixel shows its own radius alone. So the sharp picture is blurred as a
whole by each of some radii, and each level of disparity keeps how far each radius is from what is
seen. The error of any focus and strength is then a sum over the levels, without a rendering.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import torch
from torch import Tensor

from defocus_core.fitting.pictures import Scale
from defocus_core.fitting.residual import Optics, Residual, measure_of
from defocus_core.fitting.unknowns import Candidate

WIDTH = 320  # px, of pictures that are blurred as a whole
_MIN_RADIUS, _MAX_RADIUS, _RATIO = 0.4, 0.24, 1.15  # px; of the width; of one to the next
_LEVELS = 256  # of disparity
_MIN_WEIGHT = 0.05  # mean of a picture of which enough counts
_APART = 0.15  # of their radii: points that differ by less are one
_BEYOND = 2.0  # ranges of disparity beyond it, where the focus is sought for a given strength


class BlurMap:
    """The error of each radius at each level of disparity."""

    def __init__(self, residual: Residual, optics: Optics, shift: dict[str, float]) -> None:
        """Blur the picture as a whole by each radius."""
        scale = residual.scale(WIDTH)
        self._factor, disparity = scale.factor, scale.disparity.double()
        self.low, self.high = float(disparity.min()), float(disparity.max())
        span = self.high - self.low
        level = ((disparity - self.low) / (span or 1.0) * (_LEVELS - 1)).round().long().flatten()
        self.levels = self.low + span * torch.arange(_LEVELS, dtype=torch.float64) / (_LEVELS - 1)
        maximum = _MAX_RADIUS * scale.sharp.shape[2]
        count = math.ceil(math.log(maximum / _MIN_RADIUS) / math.log(_RATIO))
        sizes = [_MIN_RADIUS * _RATIO**i for i in range(count + 1)]
        turns = bool(optics.aperture.blades or optics.aperture.image)
        signed = [*(-r for r in reversed(sizes)), 0.0, *sizes] if turns else [0.0, *sizes]
        flat = scale.flat()
        points = (Candidate(r / scale.factor, 1.0, **shift) for r in signed)
        rows = [_errors(residual, optics, flat, point, level) for point in points]
        self._radii = torch.tensor(signed, dtype=torch.float64)
        self._turns = turns
        self._errors, self._weights = (torch.stack(each) for each in zip(*rows, strict=True))
        self._pixels = level.numel()

    def points(
        self, focus: float | None, strength: Callable[[float], float] | None
    ) -> list[tuple[float, float]]:
        """Strengths and focuses that are tried, either of which may be given."""
        sizes = self._radii[self._radii > 0] / self._factor
        span = self.high - self.low
        if focus is not None:
            if strength is not None:
                return [(strength(focus), focus)]
            reach = max(abs(focus - self.low), abs(focus - self.high))
            return [(float(r) / reach, focus) for r in sizes] if reach else []
        if strength is not None:
            positions = torch.linspace(self.low - _BEYOND * span, self.high + _BEYOND * span, 801)
            return [(strength(float(d)), float(d)) for d in positions]
        signed = [*(-sizes).tolist(), 0.0, *sizes.tolist()]
        pairs = [(far, near) for far in signed for near in signed if near < far]
        return [((far - near) / span, self.low + far * span / (far - near)) for far, near in pairs]

    def best(self, points: Iterable[tuple[float, float]], count: int) -> list[tuple[float, float]]:
        """The strengths and focuses of least error that are not nearly the same."""
        tried = torch.tensor(list(points), dtype=torch.float64).reshape(-1, 2)
        radii = tried[:, :1] * self._factor * (tried[:, 1:] - self.levels)  # [P, L]
        errors = self._error(radii)
        chosen: list[int] = []
        weights = self._weights.amax(0)
        for index in errors.argsort().tolist():
            if len(chosen) == count or not math.isfinite(float(errors[index])):
                break
            away = ((radii[chosen] - radii[index]).abs() * weights).sum(1)
            size = (radii[index].abs() * weights).sum()
            if not chosen or float(away.min()) > _APART * float(size):
                chosen.append(index)
        return [(float(k), float(d)) for k, d in tried[chosen]]

    def _error(self, radii: Tensor) -> Tensor:
        """The mean error [P] of points of radii [P, L]; infinite where hardly anything counts."""
        known, wanted = self._radii, radii if self._turns else radii.abs()
        index = torch.searchsorted(known, wanted.contiguous()).clamp(1, len(known) - 1)
        fraction = (wanted - known[index - 1]) / (known[index] - known[index - 1])
        level = torch.arange(radii.shape[1]).expand_as(index)
        inside = (fraction >= -1e-9) & (fraction <= 1 + 1e-9)
        sums = [
            (torch.lerp(table[index - 1, level], table[index, level], fraction) * inside).sum(1)
            for table in (self._errors, self._weights)
        ]
        return torch.where(sums[1] > _MIN_WEIGHT * self._pixels, sums[0] / sums[1], math.inf)


def _errors(
    residual: Residual, optics: Optics, flat: Scale, point: Candidate, level: Tensor
) -> tuple[Tensor, Tensor]:
    """The error and the weight [L] of each level of disparity, blurred as a whole."""
    away, weight = residual.of(point, optics, flat, "draft")
    weight = weight.double().flatten()
    error = measure_of(away).mean(1).double().flatten()
    zero = torch.zeros(_LEVELS, dtype=torch.float64)
    return zero.index_add(0, level, error * weight), zero.index_add(0, level, weight)

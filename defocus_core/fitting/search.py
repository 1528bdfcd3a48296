"""The search for the point that explains a pair: all blurs at once, then Gauss-Newton steps.

Apart from depth edges a pixel shows its own radius alone. So at first the sharp picture is blurred
as a whole by each of some radii, and each level of disparity keeps how far each radius is from what
is seen. The error of any focus and strength is then a sum over the levels, without a rendering.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import torch
from torch import Tensor

from defocus_core.fitting.pictures import Scale, offset_of
from defocus_core.fitting.residual import Optics, Residual, error_of, measure_of, robust_of
from defocus_core.fitting.unknowns import MAX_SHIFT, Candidate, Unknown, moved, rotation_of

MIDDLE = 480  # px, width of pictures of middle size
_COARSE = 200  # px, width of small pictures
_STEPS = {_COARSE: 6, MIDDLE: 6, None: 8}  # most Gauss-Newton steps at a width
_STARTS = 6  # blurs that are rendered
_KEPT = {_COARSE: 3, MIDDLE: 2}  # of these are followed at a width
_SAME_PX = 0.25  # px of small pictures, by which radii of one point differ
_DROP_RATIO = 4.0  # times the error of the best: nothing changes that
_CHEAP = ("across", "down", "magnification", "separation")  # unknowns that take no rendering
_TURNS = 4  # rotations tried between a blade and the next
_BLOCKS = 6  # along each side, for the uncertainty
_SEPARATION = 0.5  # of left and right, from which steps descend
_LEAST_STEP = 2e-4  # a smaller step is none
_END_RATIO = 0.999  # times the error before a step: not worth another
_SHORTEST = 0.01  # of the difference that slopes are first taken over
_FRACTIONS = (1.0, 0.35, 0.1)  # fractions of a step that are tried
_DAMPING = 1e-4
# Px by which a nearly sharp surface is moved, how much less error is worth it, and how often.
_PIVOT_PX, _PIVOT_RATIO, _TIMES = (-0.4, -0.2, -0.1, -0.05, 0.05, 0.1, 0.2, 0.4), 0.9, 3
_TAIL = 0.02  # fraction of the pixels, nearer or farther than which there are hardly any
_MAP_WIDTH = 320  # px, of pictures that are blurred as a whole
_MIN_RADIUS, _MAX_RADIUS, _RATIO = 0.4, 0.24, 1.15  # px; of the width; of one to the next
_LEVELS = 256  # of disparity
_MIN_WEIGHT = 0.05  # mean of a picture of which enough counts
_APART = 0.15  # of their radii: points that differ by less are one
_BEYOND = 2.0  # ranges of disparity beyond it, where the focus is sought for a given strength


@dataclass(frozen=True)
class FittedLens:
    """A point, its pupil and photodiodes, and its error."""

    error: float
    point: Candidate
    optics: Optics


class BlurMap:
    """The error of each radius at each level of disparity."""

    def __init__(self, residual: Residual, optics: Optics, shift: dict[str, float]) -> None:
        """Blur the picture as a whole by each radius."""
        scale = residual.scale(_MAP_WIDTH)
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


class Search:
    """The search for the point between two pictures."""

    def __init__(
        self,
        residual: Residual,
        free: Sequence[Unknown],
        *,
        rotation: bool,
        focus: float | None = None,
        strength: Callable[[float], float] | None = None,
    ) -> None:
        """Keep what is to be found."""
        self.residual = residual
        self._free, self._rotation = list(free), rotation
        self._focus, self._strength = focus, strength

    def free(self, optics: Optics) -> list[Unknown]:
        """The unknowns beside a pupil."""
        turns = self._rotation and optics.aperture.blades
        return [*self._free, rotation_of(optics.aperture)] if turns else self._free

    def best(self, choices: Sequence[Optics]) -> FittedLens:
        """The point of least error, and the pupil and photodiodes that make it."""
        first, small = choices[0], self.residual.scale(_COARSE)
        starts = [self._at(point, first, small) for point in self._starts(first)]
        if not starts:
            return FittedLens(math.inf, Candidate(1.0, 0.0), first)
        starts = self._all(starts, _COARSE, self._cheap)
        starts = self._all(_best(starts, _COARSE, small), _COARSE, self._free)
        if self.residual.width > _COARSE:
            starts = self._all(_best(starts, MIDDLE, small), MIDDLE, self._free)
        fitted = self._choose(self._pivot(starts[0]), choices)
        if self.residual.width > MIDDLE or fitted.optics != first:
            fitted = self._descend(fitted, None, self.free(fitted.optics))
        return fitted

    @property
    def _cheap(self) -> list[Unknown]:
        """The unknowns that take no rendering."""
        return [unknown for unknown in self._free if unknown.name in _CHEAP]

    def _all(self, starts: list[FittedLens], width: int, free: list[Unknown]) -> list[FittedLens]:
        """Points after Gauss-Newton steps, the best first."""
        ended = (self._descend(start, width, free) for start in starts)
        return sorted(ended, key=lambda fitted: fitted.error)

    def _starts(self, optics: Optics) -> list[Candidate]:
        """The points from which steps descend."""
        shift = self._shift()
        blurs = BlurMap(self.residual, optics, shift)
        best = blurs.best(blurs.points(self._focus, self._strength), _STARTS)
        if any(unknown.name == "separation" for unknown in self._free):
            shift["separation"] = _SEPARATION
        return [Candidate(strength, focus, **shift) for strength, focus in best]

    def _shift(self) -> dict[str, float]:
        """The shift in whole px, if it is free."""
        names = ("across", "down")
        if not any(unknown.name in names for unknown in self._free):
            return {}
        scale = self.residual.scale(None)
        observed = torch.stack(scale.observed).mean(0)
        return dict(zip(names, offset_of(scale.sharp, observed, int(MAX_SHIFT)), strict=True))

    def _choose(self, fitted: FittedLens, choices: Sequence[Optics]) -> FittedLens:
        """The pupil and the photodiodes that explain the pictures best, near a point."""
        if len(choices) == 1 and not (self._rotation and choices[0].aperture.blades):
            return fitted
        scale = self.residual.scale(MIDDLE)
        candidates = []
        for optics in choices:
            blades = optics.aperture.blades
            turns = _TURNS if self._rotation and blades else 1
            angles = [360 * turn / (turns * max(blades, 1)) for turn in range(turns)]
            tried = (self._at(replace(fitted.point, rotation=a), optics, scale) for a in angles)
            start = min(tried, key=lambda each: each.error)
            same = optics.aperture == choices[0].aperture and not blades
            free = self._cheap if same and len(choices) > 1 else self.free(optics)
            candidates.append(self._descend(start, MIDDLE, free))
        return min(candidates, key=lambda each: each.error)

    def _pivot(self, fitted: FittedLens) -> FittedLens:
        """A point whose most blurred surface keeps its radius; the focus moves by parts of px.

        Nearly sharp surfaces look alike on both sides of the focus: there steps end.
        """
        if self._focus is not None or self._strength is not None:
            return fitted
        scale = self.residual.scale(MIDDLE)
        blur = [unknown for unknown in self._free if unknown.name in ("strength", "focus")]
        rare = torch.tensor([_TAIL, 1 - _TAIL], dtype=torch.float64)
        limits = scale.disparity.flatten().double().quantile(rare).tolist()
        for _ in range(_TIMES):
            point = fitted.point
            limit = max(limits, key=lambda d: abs(fitted.point.focus - d))
            away = point.focus - limit
            strengths = [point.strength - px / away for px in _PIVOT_PX if away]
            pivoted = (
                replace(point, strength=k, focus=limit + point.strength * away / k)
                for k in strengths
                if k > 0
            )
            tried = (self._at(each, fitted.optics, scale) for each in pivoted)
            best = min(tried, key=lambda each: each.error, default=fitted)
            if not best.error < _PIVOT_RATIO * fitted.error:
                return fitted
            fitted = self._descend(best, MIDDLE, blur)
        return fitted

    def _move(self, point: Candidate, free: Sequence[Unknown], steps: Sequence[float]) -> Candidate:
        """A point after a step, with the strength that is known for its focus."""
        there = moved(point, free, steps)
        if self._strength is None:
            return there
        return replace(there, strength=self._strength(there.focus) / there.magnification)

    def _at(self, point: Candidate, optics: Optics, scale: Scale) -> FittedLens:
        return FittedLens(error_of(*self.residual.of(point, optics, scale)), point, optics)

    def _descend(self, start: FittedLens, width: int | None, free: list[Unknown]) -> FittedLens:
        """A point after Gauss-Newton steps at a width; None for that of the pictures.

        Slopes take a rendering each. Where a surface is nearly sharp they change within what they
        are taken over: that is no longer than the last step.
        """
        scale = self.residual.scale(width)
        fitted = self._at(start.point, start.optics, scale)
        first = probes = torch.tensor([unknown.probe for unknown in free], dtype=torch.float64)
        for _ in range(_STEPS[width] if free else 0):
            step = _step(*self.normal(fitted, scale, free, probes.tolist()), free)
            moves = [(self._move(fitted.point, free, (f * step).tolist()), f) for f in _FRACTIONS]
            tried = ((self._at(point, fitted.optics, scale), f) for point, f in moves)
            better = ((there, f) for there, f in tried if there.error < fitted.error)
            there, fraction = next(better, (fitted, 0.0))
            less, fitted = there.error / max(fitted.error, 1e-30), there
            taken = fraction * step.abs()
            probes = torch.minimum(probes, torch.maximum(taken, _SHORTEST * first))
            if less > _END_RATIO or float(taken.max()) < _LEAST_STEP:
                break
        return fitted

    def normal(
        self, fitted: FittedLens, scale: Scale, free: list[Unknown], probes: list[float]
    ) -> tuple[Tensor, Tensor]:
        """Of each block of the picture the matrix [B, P, P] and the gradient [B, P] of a step.

        Slopes are taken over a difference for each unknown.
        """
        residual, weight = self.residual.of(fitted.point, fitted.optics, scale)
        slopes = []
        for unknown, probe in zip(free, probes, strict=True):
            there = self._move(fitted.point, [unknown], [probe])
            slopes.append((self.residual.of(there, fitted.optics, scale)[0] - residual) / probe)
        return _blocks(residual, weight, torch.stack(slopes))


def _errors(
    residual: Residual, optics: Optics, flat: Scale, point: Candidate, level: Tensor
) -> tuple[Tensor, Tensor]:
    """The error and the weight [L] of each level of disparity, blurred as a whole."""
    away, weight = residual.of(point, optics, flat)
    weight = weight.double().flatten()
    error = measure_of(away).mean(1).double().flatten()
    zero = torch.zeros(_LEVELS, dtype=torch.float64)
    return zero.index_add(0, level, error * weight), zero.index_add(0, level, weight)


def _best(fitted: list[FittedLens], width: int, scale: Scale) -> list[FittedLens]:
    """The first of some points, but those clearly worse than the best, and where another ended."""
    ends, kept = torch.stack(scale.disparity.aminmax()), []
    radii: list[Tensor] = []
    for each in fitted[: _KEPT[width]]:
        radius = each.point.strength * scale.factor * (each.point.focus - ends)
        apart = all(float((radius - other).abs().max()) > _SAME_PX for other in radii)
        if apart and each.error <= _DROP_RATIO * fitted[0].error:
            kept.append(each)
            radii.append(radius)
    return kept


def _blocks(residual: Tensor, weight: Tensor, slopes: Tensor) -> tuple[Tensor, Tensor]:
    """Of each block of the picture the matrix [B, P, P] and the gradient [B, P] of a step."""
    robust = robust_of(residual, weight)
    pieces_h, pieces_g = [], []
    height, width = residual.shape[2:]
    for row, column in product(range(_BLOCKS), range(_BLOCKS)):
        cut = (
            ...,
            slice(row * height // _BLOCKS, (row + 1) * height // _BLOCKS),
            slice(column * width // _BLOCKS, (column + 1) * width // _BLOCKS),
        )
        slope = slopes[cut].flatten(1).double()
        weighed = slope * robust[cut].flatten().double()
        pieces_h.append(weighed @ slope.T)
        pieces_g.append(weighed @ residual[cut].flatten().double())
    return torch.stack(pieces_h), torch.stack(pieces_g)


def _step(hessian: Tensor, gradient: Tensor, free: list[Unknown]) -> Tensor:
    """The Gauss-Newton step [P] of blocks, no longer than the unknowns allow."""
    whole = hessian.sum(0)
    damped = whole + _DAMPING * torch.diag(whole.diagonal())
    step: Tensor = torch.linalg.solve(damped + 1e-12 * torch.eye(len(free)), -gradient.sum(0))
    maximum = torch.tensor([unknown.maximum for unknown in free], dtype=torch.float64)
    return step.clamp(-maximum, maximum)

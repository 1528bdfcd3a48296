"""The lens of a real pair: focus and strength of the blur between a sharp and a blurred picture.

A coarse search renders small pictures by all radii of the nearest and the farthest surface, then
Gauss-Newton steps follow the best over larger ones. They take the slope of each unknown over a
difference: that of a blur costs a rendering, that of registration and crosstalk none.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor

from defocus_core.evaluation.similarity import psnr
from defocus_core.fitting.pictures import Scale, offset_of
from defocus_core.fitting.residual import Optics, Point, Residual, error_of, robust_of
from defocus_core.optics.aperture import Aperture
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.renderer.render import render
from defocus_core.tensors.torch_modes import own_modes
from defocus_core.tensors.validation import described

MAX_SHIFT = 16.0  # px
MAX_MAGNIFICATION = 1.02  # or its inverse: about twice a camera's between near and far focus
_WIDTHS = {200: 3, 480: 2, 1024: 1}  # px of the pictures, and how many points are kept there
_JUDGED = 480  # px, of pictures by which errors are told
_SEARCHED, _STARTS = 128, 6  # px, of pictures that are rendered by all radii; points kept there
_RADII = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0)  # px there
_STEPS = 6  # most Gauss-Newton steps at a width
_DROP_RATIO = 4.0  # times the error of the best: nothing changes that
_SAME_PX = 0.25  # px of pictures at a width, by which radii of one point differ
_LEAST_STEP = 2e-4  # a smaller step is none
_END_RATIO = 0.999  # times the error before a step: not worth another
_FRACTIONS = (1.0, 0.35, 0.1)  # fractions of a step that are tried
_SHORTEST = 0.01  # of the difference that slopes are first taken over
_DAMPING = 1e-4
_BLOCKS = 6  # along each side, for the uncertainty
_SEPARATION = 0.5  # of left and right, from which steps descend
_UNTOLD = 1e-9  # curvature of the error by pixel, of an unknown that the pictures tell nothing of
_MAX_CROSSTALK = 0.49  # of light, that is known from none
_MINIMUM = 1e-6  # mean square of compressed light, that is no difference


@dataclass(frozen=True)
class Fit:
    """The blur between two pictures.

    Attributes:
        strength: k, px of radius for a disparity of 1, in the blurred picture.
        focus: d₀, the disparity in focus.
        strength_error: Standard error of the strength, relative.
        focus_error: Standard error of the focus, in disparity.
        shift: Px by which the blurred picture lies to the right of the sharp one, and below.
        magnification: Size of things in the blurred picture over that in the sharp one, about the
            middle; the shift is applied after it.
        gains: Factor of light of each channel from the sharp to the blurred picture.
        psnr: In dB of compressed light, of the pixels that count.
        dual_pixel: The photodiodes of a pair; None of one picture.
        exchanged: Whether what was given for left is what the right photodiodes saw.
        explained: The fraction of the difference between the pictures that the blur explains.
    """

    strength: float
    focus: float
    strength_error: float
    focus_error: float
    shift: tuple[float, float]
    magnification: float
    gains: tuple[float, ...]
    psnr: float
    dual_pixel: DualPixel | None
    exchanged: bool
    explained: float


@dataclass(frozen=True)
class Unknown:
    """An unknown, in units of which one is a large change."""

    name: str  # a field of `Point`
    unit: float  # of its value; of a ratio, of its logarithm
    probe: float  # difference that slopes are taken over, in units
    maximum: float  # greatest step, in units
    is_ratio: bool = False  # whether steps multiply it
    bound: float = math.inf  # greatest value, with either sign; of a ratio, factor either way

    def moved(self, point: Point, step: float) -> Point:
        """A point after a step."""
        value: float = getattr(point, self.name)
        if self.is_ratio:
            value = min(max(value * math.exp(step * self.unit), 1 / self.bound), self.bound)
        else:
            value = min(max(value + step * self.unit, -self.bound), self.bound)
        return point._replace(**{self.name: value})


def fit(
    sharp: Tensor,
    disparity: Tensor,
    blurred: Tensor | tuple[Tensor, ...],
    *,
    aperture: Aperture | None = None,
    dual_pixel: DualPixel | None = None,
    crosstalk: bool = False,
    shift: bool = False,
    depth_repair: str = "auto",
    edge_width: float | None = None,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Fit:
    """Find the blur that turns a sharp picture into a blurred one.

    Args:
        sharp: [C, H, W], linear light.
        disparity: [H, W], of any unit and zero, greater when nearer.
        blurred: [C, H, W], light like that of sharp; or (left, right) of a dual-pixel sensor.
        aperture: The pupil, a round one by default.
        dual_pixel: The photodiodes of a pair, ideal halves by default.
        crosstalk: Whether the crosstalk of a pair is to be found.
        shift: Whether the blurred picture may be shifted by up to 16 px, and each view have a
            falloff of light over the frame.
        depth_repair: As for `render`.
        edge_width: As for `render`.
        threads: As for `render`.
        progress: Called with (renderings done, about how many in all).

    Raises:
        ValueError: If shapes disagree, a value is not finite, the depth is the same everywhere, or
            no pixel tells anything, as of pictures that are white.
    """
    observed = blurred if isinstance(blurred, tuple) else (blurred,)
    _check(sharp, disparity, observed)
    span = float(disparity.max() - disparity.min())
    blur = [
        Unknown("strength", 1.0, 0.02, 0.5, is_ratio=True),
        Unknown("focus", span, 0.02, 0.25),
    ]
    cheap = [Unknown("magnification", 0.01, 0.1, 0.5, is_ratio=True, bound=MAX_MAGNIFICATION)]
    if shift:
        cheap += [Unknown(name, 1.0, 0.25, 2.0, bound=MAX_SHIFT) for name in ("across", "down")]
    if crosstalk and len(observed) > 1:
        cheap.append(Unknown("separation", 1.0, 0.1, 1.0, bound=1.2))
    optics = Optics(aperture or Aperture(), dual_pixel or DualPixel())
    with torch.no_grad(), own_modes(sharp.device):
        rendered = partial(render, depth_repair=depth_repair, threads=threads)
        residual = Residual(
            sharp,
            disparity,
            observed,
            falloff=shift,
            rendered=rendered,
            edge_width=edge_width,
            progress=progress,
        )
        search = Search(residual, blur, cheap)
        return search.fit_of(search.best(optics), optics)


def _check(sharp: Tensor, disparity: Tensor, observed: tuple[Tensor, ...]) -> None:
    """Refuse pictures that do not belong together."""
    if sharp.dim() != 3 or disparity.shape != sharp.shape[1:]:
        raise ValueError(
            "sharp must be [C, H, W] and disparity [H, W] of the same size, got "
            f"{described(sharp)} and {described(disparity)}; resample one of them"
        )
    for each in observed:
        if each.shape != sharp.shape:
            got = described(each)
            raise ValueError(f"blurred must have the shape of sharp, got {got}; crop one of them")
    for name, values in (("sharp", sharp), ("disparity", disparity), ("blurred", observed[0])):
        if not bool(torch.isfinite(values).all()):
            raise ValueError(f"{name} must be finite; infinitely far is a disparity of 0")
    if float(disparity.max() - disparity.min()) <= 0:
        raise ValueError(
            "disparity must differ somewhere: one plane does not tell where focus is; give a scene "
            "of several depths"
        )


class Search:
    """The search for the point between two pictures."""

    def __init__(self, residual: Residual, blur: list[Unknown], cheap: list[Unknown]) -> None:
        """Keep what is to be found: by renderings, and without."""
        self._residual, self._cheap, self._free = residual, cheap, blur + cheap

    def best(self, optics: Optics) -> Point:
        """The point of least error."""
        scale, first = self._residual.scale(_SEARCHED), self._first()
        signed = [*(-r for r in _RADII), 0.0, *_RADII]
        low, high = scale.ends
        ends = ((far, near) for far in signed for near in signed if near < far)
        slopes = [(far, (far - near) / (high - low)) for far, near in ends]
        points = [
            first._replace(strength=slope / scale.factor, focus=low + far / slope)
            for far, slope in slopes
        ]
        points = self._apart(points, optics, scale)[:_STARTS]
        if not points:
            raise ValueError(
                "hardly a pixel tells anything: nearly all are clipped, or seen from beyond the "
                "border; give a darker picture, or one that is blurred less"
            )
        for width, kept in _WIDTHS.items():
            scale = self._residual.scale(width)
            if width == min(_WIDTHS):
                points = [self._descend(point, optics, scale, self._cheap) for point in points]
            points = [self._descend(point, optics, scale, self._free) for point in points]
            points = self._apart(points, optics, scale)[:kept]
            if self._residual.width <= width:
                break
        return points[0]

    def _first(self) -> Point:
        """The registration from which steps descend: the shift in whole px, if it is free."""
        names = {unknown.name for unknown in self._cheap}
        first = Point(1.0, 0.0, separation=_SEPARATION if "separation" in names else 1.0)
        if "across" not in names:
            return first
        scale = self._residual.scale(None)
        across, down = offset_of(scale.sharp, scale.observed.mean(0), int(MAX_SHIFT))
        return first._replace(across=across, down=down)

    def _apart(self, points: list[Point], optics: Optics, scale: Scale) -> list[Point]:
        """Points, the best first, without those that a better one is like."""
        errors = {point: self._error(point, optics, scale) for point in points}
        points, kept = sorted(points, key=errors.__getitem__), list[Point]()
        for point in points:
            if not errors[point] <= _DROP_RATIO * errors[points[0]] < math.inf:
                break
            radii = [[p.strength * (p.focus - end) for end in scale.ends] for p in (point, *kept)]
            away = (max(map(abs, map(operator.sub, radii[0], other))) for other in radii[1:])
            if all(px * scale.factor > _SAME_PX for px in away):
                kept.append(point)
        return kept

    def _error(self, point: Point, optics: Optics, scale: Scale) -> float:
        return error_of(*self._residual.of(point, optics, scale))

    def _descend(self, point: Point, optics: Optics, scale: Scale, free: list[Unknown]) -> Point:
        """A point after Gauss-Newton steps at a width.

        Where a surface is nearly sharp slopes change within what they are taken over: that is no
        longer than the last step.
        """
        error = self._error(point, optics, scale)
        first = probes = torch.tensor([unknown.probe for unknown in free], dtype=torch.float64)
        maximum = torch.tensor([unknown.maximum for unknown in free], dtype=torch.float64)
        for _ in range(_STEPS):
            hessian, gradient = (x.sum(0) for x in self._normal(point, optics, scale, free, probes))
            damped = hessian + torch.diag(_DAMPING * hessian.diagonal() + 1e-12)
            step = torch.linalg.solve(damped, -gradient)
            step = step / (step.abs() / maximum).max().clamp_min(1)
            for fraction in _FRACTIONS:
                there = _moved(point, free, fraction * step)
                if (less := self._error(there, optics, scale)) < error:
                    break
            else:
                break
            ratio, point, error = less / max(error, 1e-30), there, less
            taken = fraction * step.abs()
            probes = torch.minimum(probes, torch.maximum(taken, _SHORTEST * first))
            if ratio > _END_RATIO or float(taken.max()) < _LEAST_STEP:
                break
        return point

    def _normal(
        self, point: Point, optics: Optics, scale: Scale, free: list[Unknown], probes: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Of each block of the picture the matrix [B, P, P] and the gradient [B, P] of a step."""
        residual, weight = self._residual.of(point, optics, scale)
        there = (unknown.moved(point, float(p)) for unknown, p in zip(free, probes, strict=True))
        slopes = [self._residual.of(each, optics, scale)[0] - residual for each in there]
        robust = robust_of(residual, weight)
        tables = torch.stack([residual, *(s / p for s, p in zip(slopes, probes, strict=True))])
        hessian, gradient = list[Tensor](), list[Tensor]()
        for rows in (tables * robust.sqrt()).double().tensor_split(_BLOCKS, dim=-2):
            for block in rows.tensor_split(_BLOCKS, dim=-1):
                away, *slope = block.flatten(1)
                hessian.append(torch.stack(slope) @ torch.stack(slope).T)
                gradient.append(torch.stack(slope) @ away)
        return torch.stack(hessian), torch.stack(gradient)

    def fit_of(self, point: Point, optics: Optics) -> Fit:
        """What was found, with its uncertainty: blocks of the picture stand for chance.

        The covariance is that of clustered residuals, H⁻¹ (Σ g gᵀ) H⁻¹ (Liang & Zeger 1986).
        """
        scale, free = self._residual.scale(_JUDGED), self._free
        away, weight = self._residual.of(point, optics, scale)
        total = float(weight.sum()) * away.shape[1]
        square = float((away.square() * weight).sum()) / total
        sharp = point._replace(strength=_MINIMUM / (scale.ends[1] - scale.ends[0]))
        before, its_weight = self._residual.of(sharp, optics, scale)
        unlike = float((before.square() * its_weight).sum() / its_weight.sum()) / away.shape[1]
        probes = torch.tensor([unknown.probe for unknown in free], dtype=torch.float64)
        blocks, gradient = self._normal(point, optics, scale, free, probes)
        hessian = blocks.sum(0)
        inverse = torch.linalg.pinv(hessian)
        variance = (inverse @ (gradient.T @ gradient) @ inverse).diagonal().clamp_min(0)
        untold = hessian.diagonal() <= _UNTOLD * total
        errors = variance.sqrt().masked_fill(untold, math.inf).tolist()
        pair, sensor = len(scale.observed) > 1, optics.dual_pixel
        fraction = (1 - abs(point.separation) * (1 - 2 * float(sensor.crosstalk))) / 2
        return Fit(
            strength=point.strength * point.magnification,
            focus=point.focus,
            strength_error=errors[0],
            focus_error=errors[1] * free[1].unit,
            shift=(point.across, point.down),
            magnification=point.magnification,
            gains=tuple(self._residual.modelled(point, optics, scale)[2].tolist()),
            psnr=psnr(square),
            dual_pixel=replace(sensor, crosstalk=min(max(fraction, 0.0), _MAX_CROSSTALK))
            if pair
            else None,
            exchanged=point.separation < 0,
            explained=1 - square / unlike if unlike > _MINIMUM else 0.0,
        )


def _moved(point: Point, free: Sequence[Unknown], steps: Tensor) -> Point:
    """A point after a step in each of the unknowns that are free."""
    for unknown, step in zip(free, steps.tolist(), strict=True):
        point = unknown.moved(point, step)
    return point

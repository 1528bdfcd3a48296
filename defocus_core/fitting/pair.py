"""The lens of a real pair: focus and strength of the blur between a sharp and a blurred picture.

A coarse search blurs small pictures as a whole, then Gauss-Newton steps follow the best points over
larger ones. They take the slope of each unknown over a difference: that of a blur costs a
rendering, that of registration and crosstalk none.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor

from defocus_core.evaluation.similarity import psnr
from defocus_core.fitting.pictures import Scale, clipped, offset_of
from defocus_core.fitting.residual import Point, Residual, error_of, measure_of, robust_of
from defocus_core.optics.aperture import Aperture
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.renderer.render import render
from defocus_core.tensors.threads import own_modes
from defocus_core.tensors.validation import described

MAX_SHIFT = 16.0  # px
MAX_MAGNIFICATION = 1.02  # or its inverse: about twice a camera's between near and far focus
# Of each unknown, in the order of `Point`: the difference that slopes are first taken over, the
# greatest step, and the greatest value of either sign; px are those of the pictures at a width.
_PROBES = torch.tensor([0.2, 0.2, 0.25, 0.25, 0.001, 0.1], dtype=torch.float64)
_STEPS = torch.tensor([4.0, 4.0, 2.0, 2.0, 0.005, 1.0], dtype=torch.float64)
_BOUNDS = torch.tensor(
    [math.inf, math.inf, MAX_SHIFT, MAX_SHIFT, math.log(MAX_MAGNIFICATION), 1.2],
    dtype=torch.float64,
)
_LEAST_RANGE = 1e-3  # px of radius between the farthest and the nearest surface
_SEARCHED, _LEVELS = 128, 64  # px, of pictures that are blurred as a whole; levels of disparity
_ROOTS = torch.linspace(-5.5, 5.5, 23, dtype=torch.float64)  # of the radii there, in px
_TRIED, _STARTS = 12, 4  # points of it that are rendered, and that are followed
_WIDTHS = {200: 3, 480: 2, 1024: 1}  # px of the pictures, and how many points are kept there
_MIN_WEIGHT = 0.05  # of the pixels, of which enough count
_MOST_STEPS = 6  # at a width
_DROP_RATIO = 4.0  # times the error of the best: nothing changes that
_SAME_PX = 0.25  # px of pictures at a width, by which radii of one point differ
_LEAST_STEP = 0.003  # of the difference that slopes are first taken over; a smaller step is none
_EXACT = 1e-10  # error of pictures that differ by nothing else
_SHORTEST = 0.01  # of the difference that slopes are first taken over
_DAMPINGS = (1e-6, 0.03, 1.0, 30.0)  # of steps that are tried, in turn
_TOLD = 1e-3  # of the greatest curvature, that damps an unknown of which nothing is told
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
        gains: Factor of light of each channel from the sharp to the blurred picture; of grey ones
            one.
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


def fit(
    sharp: Tensor,
    disparity: Tensor,
    blurred: Tensor | tuple[Tensor, ...],
    *,
    aperture: Aperture | None = None,
    dual_pixel: DualPixel | None = None,
    crosstalk: bool = False,
    exposure: bool = False,
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
        exposure: Whether each channel may have a factor between the pictures, and each blurred one
            a falloff of light over the frame.
        shift: Whether the blurred picture may be shifted by up to 16 px.
        depth_repair: As for `render`.
        edge_width: As for `render`.
        threads: As for `render`.
        progress: Called with (renderings done, about how many in all).

    Raises:
        ValueError: If shapes disagree, a value is not finite, the depth is the same everywhere, or
            no pixel tells anything, as of pictures that are white.
    """
    given = blurred if isinstance(blurred, tuple) else (blurred,)
    _check(sharp, disparity, given)
    if all(bool((each == each[:1]).all()) for each in (sharp, *given)):
        sharp, given = sharp[:1], tuple(each[:1] for each in given)  # grey is one channel
    low, high = (float(x) for x in disparity.aminmax())
    names = ["far", "near", "growth"] + ["across", "down"] * shift
    names += ["separation"] * (crosstalk and len(given) > 1)
    sensor = dual_pixel or DualPixel()
    rendered = partial(
        render, aperture=aperture, dual_pixel=sensor, depth_repair=depth_repair, threads=threads
    )
    with torch.no_grad(), own_modes(sharp.device):
        depth = ((disparity.double() - low) / (high - low)).to(sharp)
        pictures = Scale(sharp, depth, torch.stack(given), clipped(sharp))
        residual = Residual(
            pictures,
            rendered,
            exposure=exposure,
            infinity=low / (low - high),
            edge_width=edge_width,
            progress=progress,
        )
        search = Search(residual, pictures, [Point._fields.index(name) for name in names])
        found = search.fit_of(search.best(), sensor)
    return replace(
        found,
        strength=found.strength / (high - low),
        focus=low + found.focus * (high - low),
        focus_error=found.focus_error * (high - low),
    )


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

    def __init__(self, residual: Residual, pictures: Scale, free: list[int]) -> None:
        """Keep which unknowns, by number, are to be found: the radii first."""
        self._residual, self._free = residual, free
        self._widths = {width: pictures.reduced(width) for width in (_SEARCHED, *_WIDTHS)}
        self._all = pictures

    def best(self) -> Point:
        """The point of least error."""
        points = self._apart(self._starts(self._first()), _SEARCHED)[:_STARTS]
        if not points:
            raise ValueError(
                "hardly a pixel tells anything: nearly all are clipped, or seen from beyond the "
                "border; give a darker picture, or one that is blurred less"
            )
        for width, kept in _WIDTHS.items():
            pictures, ended = self._widths[width], list[Point]()
            for point in points:
                if width == min(_WIDTHS):
                    point = self._descend(point, pictures, self._free[2:])
                ended.append(self._descend(point, pictures, self._free))
                if self._error(ended[-1], pictures) < _EXACT:
                    break
            points = self._apart(ended, width)[:kept]
            if pictures is self._all:
                break
        return points[0]

    def _first(self) -> Point:
        """The registration from which steps descend: the shift in whole px, if it is free."""
        names = {Point._fields[number] for number in self._free}
        first = Point(0.0, 0.0, separation=_SEPARATION if "separation" in names else 1.0)
        if "across" not in names:
            return first
        across, down = offset_of(self._all.sharp, self._all.observed.mean(0), int(MAX_SHIFT))
        return first._replace(across=across, down=down)

    def _starts(self, first: Point) -> list[Point]:
        """Points of little error where each disparity is blurred as the whole picture would be."""
        small = self._widths[_SEARCHED]
        mean, zero = small.observed.mean(0, keepdim=True), torch.zeros_like(small.disparity)
        flat = Scale(small.sharp, zero, mean, small.lost, small.factor)
        level = (small.disparity * (_LEVELS - 1)).round().long().flatten().cpu()
        tables = []
        for radius in (_ROOTS * _ROOTS.abs()).tolist():
            point = first._replace(far=radius / flat.factor, near=radius / flat.factor)
            away, weight = (x.double().mean((0, 1)) for x in self._residual.of(point, flat))
            tables.append([weight, weight * measure_of(away)])
        count, error = (
            torch.stack([level.bincount(x.flatten().cpu(), _LEVELS) for x in each])
            for each in zip(*tables, strict=True)
        )
        far, near = (_ROOTS * _ROOTS.abs())[torch.triu_indices(len(_ROOTS), len(_ROOTS), 1)].flip(0)
        radii = far[:, None] + (near - far)[:, None] * torch.linspace(0, 1, _LEVELS)
        place = (radii.sign() * radii.abs().sqrt() - _ROOTS[0]) / (_ROOTS[1] - _ROOTS[0])
        index = place.long().clamp_max(len(_ROOTS) - 2)
        count, error = (
            torch.lerp(x.gather(0, index), x.gather(0, index + 1), place - index).sum(1)
            for x in (count, error)
        )
        sure = (error / count).masked_fill(count < _MIN_WEIGHT * len(level), math.inf)
        best = [i for i in sure.argsort().tolist()[:_TRIED] if sure[i] < math.inf]
        pairs = zip((far / flat.factor).tolist(), (near / flat.factor).tolist(), strict=True)
        points = [first._replace(far=one, near=other) for one, other in pairs]
        return [points[index] for index in best]

    def _apart(self, points: list[Point], width: int) -> list[Point]:
        """Points, the best first, without those that a better one is like."""
        errors = {point: self._error(point, self._widths[width]) for point in points}
        points, kept, radii = sorted(points, key=errors.__getitem__), list[Point](), list[Tensor]()
        for point in points:
            if not errors[point] <= _DROP_RATIO * errors[points[0]] < math.inf:
                break
            ends = torch.tensor(point[:2]) * self._widths[width].factor
            if all(float((ends - other).abs().max()) > _SAME_PX for other in radii):
                kept.append(point)
                radii.append(ends)
        return kept

    def _error(self, point: Point, pictures: Scale) -> float:
        return error_of(*self._residual.of(point, pictures))

    def _descend(self, point: Point, pictures: Scale, free: list[int]) -> Point:
        """A point after Gauss-Newton steps.

        Where a surface is nearly sharp slopes change within what they are taken over: that is no
        longer than the last step.
        """
        lengths = torch.ones(len(free), dtype=torch.float64)
        for _ in range(_MOST_STEPS):
            probes = _probes(point, pictures, free)
            normal = self._normal(point, pictures, free, lengths[:, None] * probes)
            hessian, gradient = (x.sum(0) for x in normal)
            hessian, gradient = hessian / lengths.outer(lengths), gradient / lengths
            told = hessian.diagonal().clamp_min(_TOLD * hessian.diagonal().max() + 1e-30)
            here = self._residual.of(point, pictures)
            for damping in _DAMPINGS:
                step = -torch.linalg.solve(hessian + torch.diag(damping * told), gradient)
                step = step / ((step @ probes).abs() / _longest(pictures)[free]).max().clamp_min(1)
                there = _moved(point, free, step @ probes)
                # Of the same pixels: else it counts which are seen from beyond the border
                away, weight = self._residual.of(there, pictures)
                common = torch.minimum(weight, here[1])
                if (error := error_of(away, common)) < error_of(here[0], common):
                    break
            else:
                break
            point, lengths = there, lengths.minimum(step.abs().clamp_min(_SHORTEST))
            if error < _EXACT or float(step.abs().max()) < _LEAST_STEP:
                break
        return point

    def _normal(
        self, point: Point, pictures: Scale, free: list[int], probes: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Of each block of the picture the matrix [B, P, P] and the gradient [B, P] of a step.

        The step is in units of the probes [P, P], a row each.
        """
        away, weight = self._residual.of(point, pictures)
        moved = [_moved(point, free, probe) for probe in probes]
        tables = [away] + [self._residual.of(there, pictures)[0] - away for there in moved]
        table = (torch.stack(tables) * robust_of(away, weight).sqrt()).double().cpu()
        products = [
            block.flatten(1) @ block.flatten(1).T
            for rows in table.tensor_split(_BLOCKS, dim=-2)
            for block in rows.tensor_split(_BLOCKS, dim=-1)
        ]
        both = torch.stack(products)
        return both[:, 1:, 1:], both[:, 1:, 0]

    def fit_of(self, point: Point, sensor: DualPixel) -> Fit:
        """What was found, with its uncertainty."""
        pictures = self._widths[max(_WIDTHS)]
        (away, weight), free = self._residual.of(point, pictures), self._free
        total = float(weight.sum()) * away.shape[1]
        square = float((away.square() * weight).sum()) / total
        still = point._replace(far=_MINIMUM, near=0.0)
        before, its_weight = self._residual.of(still, pictures)
        unlike = float((before.square() * its_weight).sum() / its_weight.sum()) / away.shape[1]
        probes = _probes(point, pictures, free)
        hessian, gradient = self._normal(point, pictures, free, probes)
        strength, focus = point.far - point.near, point.far / (point.far - point.near)
        slopes = torch.zeros(2, len(free), dtype=torch.float64)
        slopes[:, :2] = torch.tensor([[1, -1], [1 - focus, focus]]) / strength
        slopes = slopes @ probes.T
        errors = (slopes @ _covariance(hessian, gradient) @ slopes.T).diagonal().sqrt()
        if bool((hessian.sum(0).diagonal()[:2] <= _UNTOLD * total).any()):
            errors = torch.full_like(errors, math.inf)
        fraction = (1 - abs(point.separation) * (1 - 2 * float(sensor.crosstalk))) / 2
        crosstalk = min(max(fraction, 0.0), _MAX_CROSSTALK)
        return Fit(
            strength=strength * math.exp(point.growth),
            focus=focus,
            strength_error=float(errors[0]),
            focus_error=float(errors[1]),
            shift=(point.across, point.down),
            magnification=math.exp(point.growth),
            gains=tuple(self._residual.modelled(point, pictures)[2].tolist()),
            psnr=psnr(square),
            dual_pixel=replace(sensor, crosstalk=crosstalk) if len(away) > 1 else None,
            exchanged=point.separation < 0,
            explained=1 - square / unlike if unlike > _MINIMUM else 0.0,
        )


def _covariance(hessian: Tensor, gradient: Tensor) -> Tensor:
    """The covariance [P, P], by the jackknife: of a step without each block [B], in turn."""
    rest = hessian.sum(0) - hessian
    away: Tensor = (torch.linalg.pinv(rest) @ gradient[..., None])[..., 0]
    return away.T @ away * (1 - 1 / len(away))


def _longest(pictures: Scale) -> Tensor:
    """The greatest step of each unknown."""
    return _STEPS * _px(pictures)


def _px(pictures: Scale) -> Tensor:
    """The px of a pair for a px of smaller pictures; of what is no px, 1."""
    return torch.tensor([1 / pictures.factor] * 4 + [1.0] * 2, dtype=torch.float64)


def _probes(point: Point, pictures: Scale, free: list[int]) -> Tensor:
    """What slopes are first taken over [P, P], a row each: the unknowns, but of the radii others.

    All radii grow in proportion, then as is square to that, so that their range grows. Steps of
    both hardly depend on each other, be the focus within the range of depth or not.
    """
    probes = torch.diag(_PROBES * _px(pictures))
    far, near = point.far, point.near
    ends = torch.tensor([[far, near], [-near, far]], dtype=torch.float64)
    ends = ends / ends.abs().max().clamp_min(1e-12)
    ends[1] *= 1 if ends[1, 0] >= ends[1, 1] else -1
    probes[:2, :2] = ends * probes[0, 0]
    return probes[free][:, free]


def _moved(point: Point, free: list[int], steps: Tensor) -> Point:
    """A point after a step in each of the unknowns that are free."""
    values = torch.tensor(point, dtype=torch.float64)
    values[free] += steps
    values[0] = torch.maximum(values[0], values[1] + _LEAST_RANGE)
    return Point(*values.clamp(-_BOUNDS, _BOUNDS).tolist())

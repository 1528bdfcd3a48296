"""The lens of a real pair: focus and strength of the blur between a sharp and a blurred picture.

A coarse search blurs small pictures uniformly, with one radius after another; then Gauss-Newton
steps improve the best points on larger and larger pictures.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from defocus_core.evaluation.similarity import psnr
from defocus_core.fitting.pictures import Scale, clipped, offset_of
from defocus_core.fitting.residual import BEND, Point, Residual, error_of, measure_of
from defocus_core.optics.aperture import Aperture
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.renderer.engine.settings import Settings
from defocus_core.tensors.threads import own_modes
from defocus_core.tensors.validation import described

MAX_SHIFT = 16  # px
MAX_MAGNIFICATION = 1.02  # greatest, and 1 / least: about twice that of a camera's focus range
_BOUNDS = torch.tensor([1e6, 1e6, MAX_SHIFT, MAX_SHIFT, math.log(MAX_MAGNIFICATION), 1.2]).double()
# First step of finite differences for each unknown, in px of the reduced pictures
_PROBES = torch.tensor([0.2, 0.2, 0.25, 0.25, 0.001, 0.1]).double()
_LONGEST = torch.tensor([20.0, 20.0, 8.0, 8.0, 5.0, 10.0]).double()  # longest step, in _PROBES
_LEAST_STEP = 0.003  # shortest step of the search, in _PROBES; it ends there
_SHORTEST = 0.01  # least step of finite differences, in _PROBES
_MOST_STEPS = 6  # at each width
_LEAST_GAIN = 1e-4  # least relative improvement of the error by a step
_DAMPINGS = (1e-6, 0.03, 1.0, 30.0)  # of a step, tried in turn
_TOLD = 1e-3  # least curvature by which an unknown is damped, as a share of the greatest one
_LEAST_RANGE = 1e-3  # px of radius between the farthest and the nearest surface
# The coarse search: width in px, levels of disparity, signed square roots of the radii in px, and
# number of its points that are rendered
_SEARCHED, _LEVELS = 128, 64
_ROOTS = torch.linspace(-5.5, 5.5, 23, dtype=torch.float64)
_TRIED = 12
# Widths in px of the reduced pictures, and the number of points that are improved at each
_WIDTHS = {200: 4, 480: 3, 1024: 2}
_MIN_WEIGHT = 0.05  # least share of the pixels with a weight
_DROP_RATIO = 4.0  # points of more than this times the least error are dropped
_SAME_PX = 0.25  # points whose radii differ by less px of the reduced pictures are the same
_EXACT = 1e-10  # error at which the blur explains all of the difference
_BLOCKS = 3  # blocks along each side for the uncertainty: real lenses vary over a third of a frame
_SEPARATION = 0.5  # of left and right, at which the search begins
_UNTOLD = 1e-9  # curvature of the error per pixel, below which an unknown is undetermined
_MAX_CROSSTALK = 0.49  # share of light; left and right are equal at 0.5
_MINIMUM = 1e-6  # mean square of compressed light, below which pictures are equal


@dataclass(frozen=True)
class Fit:
    """The blur that was found between two pictures."""

    strength: float  # k, px of radius for a disparity of 1, in the blurred picture
    focus: float  # d₀, the disparity in focus
    strength_error: float  # standard error of the strength, relative
    focus_error: float  # standard error of the focus, in disparity
    shift: tuple[float, float]  # (x, y) in px from sharp to blurred, to the right and down
    magnification: float  # from sharp to blurred, about the middle, applied before the shift
    gains: tuple[float, ...]  # factor of light of each channel from sharp to blurred; one if grey
    psnr: float  # in dB, of compressed light over the pixels with a weight
    dual_pixel: DualPixel | None  # the photodiodes of a pair; None for a single picture
    crosstalk_error: float  # standard error of their crosstalk, 0 if it was not fitted
    exchanged: bool  # whether left and right were given in the wrong order
    explained: float  # fraction of the difference between the pictures that the blur explains


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
        disparity: [H, W], of any unit and offset, greater when nearer.
        blurred: [C, H, W], light like that of sharp; or (left, right) of a dual-pixel sensor.
        aperture: The pupil, a round one by default.
        dual_pixel: The photodiodes behind (left, right), ideal halves by default.
        crosstalk: Whether to find the crosstalk of these photodiodes.
        exposure: Whether to find a factor of light for each channel, and a falloff of light over
            the frame for each blurred picture.
        shift: Whether the blurred picture may be shifted by up to 16 px.
        depth_repair: As for `render`.
        edge_width: As for `render`.
        threads: As for `render`.
        progress: Called with the number of renderings done and about how many there are in all.

    Raises:
        ValueError: If shapes disagree, a value is not finite, the depth is the same everywhere, or
            no pixel has information, as in white pictures.
    """
    given = blurred if isinstance(blurred, tuple) else (blurred,)
    _check(sharp, disparity, given)
    if all(bool((each == each[:1]).all()) for each in (sharp, *given)):
        sharp, given = sharp[:1], tuple(each[:1] for each in given)  # grey is one channel
    low, high = (float(x) for x in disparity.aminmax())
    sought = (True, True, shift, shift, True, crosstalk and len(given) > 1)
    sensor = dual_pixel or DualPixel()
    settings = Settings(
        aperture=aperture or Aperture(),
        dual_pixel=sensor,
        left_right=len(given) > 1,
        depth_repair=depth_repair,
        edge_width=edge_width,
        infinity=low / (low - high),
        threads=threads,
        back="torch",  # the compiled back rounds radii, but a search needs slopes
    )
    with torch.no_grad(), own_modes(sharp.device):
        depth = ((disparity.double() - low) / (high - low)).to(sharp)
        pictures = Scale(sharp, depth, torch.stack(given), clipped(sharp))
        residual = Residual(pictures, settings, exposure=exposure, progress=progress)
        search = Search(residual, pictures, [n for n, is_free in enumerate(sought) if is_free])
        found = search.fit_of(search.best(), sensor)
    return replace(
        found,
        strength=found.strength / (high - low),
        focus=low + found.focus * (high - low),
        focus_error=found.focus_error * (high - low),
    )


def _check(sharp: Tensor, disparity: Tensor, observed: tuple[Tensor, ...]) -> None:
    """Refuse pictures whose sizes disagree or whose values cannot be used."""
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
        problem = "disparity must differ somewhere: one plane does not tell where focus is"
        raise ValueError(f"{problem}; give a scene of several depths")


class Search:
    """The search for the values of the unknowns, a `Point`, that explain a pair of pictures."""

    def __init__(self, residual: Residual, pictures: Scale, free: list[int]) -> None:
        """Set the pictures, and the unknowns: `free` are their indices in `Point`, first 0, 1."""
        self._residual, self._free, self._all = residual, free, pictures
        self._widths = {width: pictures.reduced(width) for width in (_SEARCHED, *_WIDTHS)}

    def best(self) -> Point:
        """The point of least error."""
        points = self._distinct(self._starts(), _SEARCHED)
        if not points:
            why = "nearly all are clipped, or seen from beyond the border"
            remedy = "give a darker picture, or one that is blurred less"
            raise ValueError(f"hardly a pixel can be used: {why}; {remedy}")
        for width, count in _WIDTHS.items():
            pictures, ended = self._widths[width], list[Point]()
            for point in points[:count]:
                ended.append(self._descend(point, pictures))
                if self._residual.error(ended[-1], pictures) < _EXACT:
                    break
            points = self._distinct(ended, width)
            if pictures is self._all:
                break
        return points[0]

    def _starts(self) -> list[Point]:
        """Points of little error, estimated without occlusion.

        Each pixel is read from the picture that is blurred uniformly with the radius of its
        disparity.
        """
        first = Point(0.0, 0.0, separation=_SEPARATION if 5 in self._free else 1.0)
        if 2 in self._free:
            across, down = offset_of(self._all.sharp, self._all.observed.mean(0), MAX_SHIFT)
            first = first._replace(across=across, down=down)
        small, radii = self._widths[_SEARCHED], _ROOTS * _ROOTS.abs()
        mean, zero = small.observed.mean(0, keepdim=True), torch.zeros_like(small.disparity)
        flat = Scale(small.sharp, zero, mean, small.lost, small.factor)
        level = (small.disparity * (_LEVELS - 1)).round().long().flatten().cpu()
        tables = []
        for radius in (radii / flat.factor).tolist():
            away, weight = self._residual.differences(first._replace(far=radius, near=radius), flat)
            both = weight.mean((0, 1)), (weight * measure_of(away)).mean((0, 1))
            tables.append([level.bincount(x.double().flatten().cpu(), _LEVELS) for x in both])
        table = torch.stack([torch.stack(each) for each in tables], 1)  # [2, radii, levels]
        far, near = radii[torch.triu_indices(len(radii), len(radii), 1)].flip(0)
        blur = far[:, None] + (near - far)[:, None] * torch.linspace(0, 1, _LEVELS)
        place = (blur.sign() * blur.abs().sqrt() - _ROOTS[0]) / (_ROOTS[1] - _ROOTS[0])
        index = place.long().clamp_max(len(_ROOTS) - 2)
        one, other = (x[:, index, torch.arange(_LEVELS)] for x in (table[:, :-1], table[:, 1:]))
        weight, error = torch.lerp(one, other, place - index).sum(2)
        error = (error / weight).masked_fill(weight < _MIN_WEIGHT * len(level), math.inf)
        ends = torch.stack([far, near], 1)[error.argsort()[:_TRIED]] / flat.factor
        return [first._replace(far=one, near=other) for one, other in ends.tolist()]

    def _distinct(self, points: list[Point], width: int) -> list[Point]:
        """The points, best first, without bad ones and those close to a better one.

        `width`: that of the pictures in px.
        """
        pictures = self._widths[width]
        errors = {point: self._residual.error(point, pictures) for point in points}
        kept: list[Point] = []
        for point in sorted(points, key=errors.__getitem__):
            away = (max(abs(point.far - x.far), abs(point.near - x.near)) for x in kept)
            if errors[point] <= _DROP_RATIO * min(errors.values()) < math.inf and all(
                px * pictures.factor > _SAME_PX for px in away
            ):
                kept.append(point)
        return kept

    def _descend(self, point: Point, pictures: Scale) -> Point:
        """The point to which Gauss-Newton steps lead from a point.

        The step of the finite differences is at most as long as the last step of the search, as
        slopes change within a longer one where a surface is nearly sharp.
        """
        lengths = torch.ones(len(self._free), dtype=torch.float64)
        longest = (_LONGEST * _scaled_probes(pictures))[self._free]
        for _ in range(_MOST_STEPS):
            probes = _probes(point, pictures, self._free)
            normal = self._normal(point, pictures, lengths[:, None] * probes)
            hessian, gradient = (x.sum(0) for x in normal)
            hessian, gradient = hessian / lengths.outer(lengths), gradient / lengths
            told = hessian.diagonal().clamp_min(_TOLD * hessian.diagonal().max() + 1e-30)
            here = self._residual.differences(point, pictures)
            for damping in _DAMPINGS:
                step = -torch.linalg.solve(hessian + torch.diag(damping * told), gradient)
                step = step / ((step @ probes).abs() / longest).max().clamp_min(1)
                there = _moved(point, self._free, step @ probes)
                # Errors of the same pixels; else pixels that see beyond the border would decide
                away, weight = self._residual.differences(there, pictures)
                common = torch.minimum(weight, here[1])
                before, after = error_of(here[0], common), error_of(away, common)
                if after < before:
                    break
            else:
                break
            point, lengths = there, lengths.minimum(step.abs().clamp_min(_SHORTEST))
            if after < _EXACT or float(step.abs().max()) < _LEAST_STEP:
                break
            if after > (1 - _LEAST_GAIN) * before:
                break
        return point

    def _normal(self, point: Point, pictures: Scale, probes: Tensor) -> tuple[Tensor, Tensor]:
        """The matrix [B, P, P] and gradient [B, P] of the normal equations, for each block.

        The frame is cut into B blocks. `probes` [P, P]: a step of the unknowns in each row, for
        finite differences.
        """
        away, weight = self._residual.differences(point, pictures)
        moved = [_moved(point, self._free, probe) for probe in probes]
        tables = [away] + [self._residual.differences(there, pictures)[0] - away for there in moved]
        # Weights by which least squares minimise Huber's measure
        robust = weight * (BEND / away.abs().clamp_min(1e-9)).clamp_max(1)
        table = (torch.stack(tables) * robust.sqrt()).double().cpu()
        products = [
            block.flatten(1) @ block.flatten(1).T
            for rows in table.tensor_split(_BLOCKS, dim=-2)
            for block in rows.tensor_split(_BLOCKS, dim=-1)
        ]
        both = torch.stack(products)
        return both[:, 1:, 1:], both[:, 1:, 0]

    def fit_of(self, point: Point, sensor: DualPixel) -> Fit:
        """The fit at a point, with its standard errors."""
        pictures, strength = self._widths[max(_WIDTHS)], point.far - point.near
        still, focus = point._replace(far=_MINIMUM, near=0.0), point.far / strength
        unlike, square = (
            float((away.square() * weight).sum() / weight.sum()) / away.shape[1]
            for away, weight in (self._residual.differences(x, pictures) for x in (still, point))
        )
        slopes = torch.zeros(3, len(_PROBES), dtype=torch.float64)  # of strength, focus, crosstalk
        slopes[:2, :2] = torch.tensor([[1, -1], [1 - focus, focus]]) / strength
        slopes[2, 5] = 0.5
        errors = self._errors(point, pictures, slopes[:, self._free])
        fraction = (1 - abs(point.separation) * (1 - 2 * float(sensor.crosstalk))) / 2
        crosstalk, is_pair = min(max(fraction, 0.0), _MAX_CROSSTALK), len(self._all.observed) > 1
        return Fit(
            strength=strength * math.exp(point.growth),
            focus=focus,
            strength_error=errors[0],
            focus_error=errors[1],
            shift=(point.across, point.down),
            magnification=math.exp(point.growth),
            gains=tuple(self._residual.modelled(point, pictures)[2].tolist()),
            psnr=psnr(square),
            dual_pixel=replace(sensor, crosstalk=crosstalk) if is_pair else None,
            crosstalk_error=errors[2],
            exchanged=point.separation < 0,
            explained=1 - square / unlike if unlike > _MINIMUM else 0.0,
        )

    def _errors(self, point: Point, pictures: Scale, slopes: Tensor) -> list[float]:
        """Standard errors of N numbers, found by a jackknife over the blocks of the frame.

        `slopes`: [N, P], derivatives of the numbers by the unknowns.
        """
        probes = _probes(point, pictures, self._free)
        hessian, gradient = self._normal(point, pictures, probes)
        _, weight = self._residual.differences(point, pictures)
        count = float(weight.sum()) * len(pictures.sharp)
        if bool((hessian.sum(0).diagonal()[:2] <= _UNTOLD * count).any()):
            return [math.inf] * len(slopes)
        rest = torch.linalg.pinv(hessian.sum(0) - hessian)
        away = slopes @ probes.T @ (rest @ gradient[..., None])  # [B, N, 1]
        sizes: list[float] = (away.square().sum(0) * (1 - 1 / len(away))).sqrt()[:, 0].tolist()
        return sizes


def _scaled_probes(pictures: Scale) -> Tensor:
    """The first step of finite differences for each unknown, in px of the full pictures."""
    return _PROBES / torch.tensor([pictures.factor] * 4 + [1.0] * 2, dtype=torch.float64)


def _probes(point: Point, pictures: Scale, free: list[int]) -> Tensor:
    """First steps of the free unknowns for finite differences: [P, P], a step in each row.

    Both radii of the point change together: the first row scales them; the second is orthogonal to
    the first and widens their range. Steps along both hardly depend on each other, whether the
    focus is within the range of depth or not.
    """
    probes = torch.diag(_scaled_probes(pictures))
    far, near = point.far, point.near
    ends = torch.tensor([[far, near], [-near, far]], dtype=torch.float64)
    ends = ends / ends.abs().max().clamp_min(1e-12)
    ends[1] *= 1 if ends[1, 0] >= ends[1, 1] else -1
    probes[:2, :2] = ends * probes[0, 0]
    return probes[free][:, free]


def _moved(point: Point, free: list[int], steps: Tensor) -> Point:
    """The point after a step in each free unknown, limited to the bounds."""
    values = torch.tensor(point, dtype=torch.float64)
    values[free] += steps
    values[0] = torch.maximum(values[0], values[1] + _LEAST_RANGE)
    return Point(*values.clamp(-_BOUNDS, _BOUNDS).tolist())

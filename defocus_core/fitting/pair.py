"""The lens of a real pair: focus and strength of the blur between a sharp and a blurred picture.

Both, and what else is unknown, are found by a coarse search over small pictures, then by
Gauss-Newton steps over larger ones. A pair that no blur explains, or something else does, is
refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from defocus_core.evaluation.metrics import near_edges
from defocus_core.evaluation.similarity import psnr
from defocus_core.fitting.pictures import Scale, offset_of, registered
from defocus_core.fitting.residual import Optics, Residual
from defocus_core.fitting.search import MIDDLE, FittedLens, Search
from defocus_core.fitting.unknowns import MAX_MAGNIFICATION, MAX_SHIFT, Candidate, Unknown, unknowns
from defocus_core.optics.aperture import Aperture
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.tensors.torch_modes import own_modes
from defocus_core.tensors.validation import described

_WIDTH = 480  # px, of the pictures that are judged
_SMALL = 48  # px, of pictures whose blur hardly shows
_EXPLAINED = 1 / 3  # minimum fraction of the difference that a lens explains, before much noise
_ALL = 0.9  # fraction from which on nothing else is wrong, however much is blurred
_ALIKE = 0.5  # least correlation of pictures of one scene
_ONE_SCENE = 0.8  # that of pictures of one scene, of which one is put right
_MORE = 0.6  # of the error, or of what a correlation lacks, that is left by what explains more
_CLOSER = 0.85  # of the error of the sharp picture, that a shift leaves
_MOVED = 0.4  # px, the least shift that is proposed
_CHANGED = 0.02  # the least change of exposure or of gamma that is proposed; lack of correlation
_BOUND = 1 - 1e-9  # of the greatest magnification, which rounding leaves
_MINIMUM = 1e-6  # mean square of compressed light, that is no difference


class Refusal(NamedTuple):
    """Why a blur is not what two pictures differ by."""

    code: str  # a word of `defocus_core.errors.CODES`
    problem: str  # in words, without a full stop
    remedy: str  # what to do about it; options stand in angle quotes


class JudgedPair(NamedTuple):
    """What a blur makes, what is observed and what is sharp, in compressed light, [C, H, W]."""

    modelled: Tensor
    observed: Tensor
    sharp: Tensor
    weight: Tensor  # [1, H, W]

    @classmethod
    def of(cls, residual: Residual, point: Candidate, optics: Optics) -> JudgedPair:
        """That of a point; of a pair its mean."""
        scale = residual.scale(_WIDTH)
        modelled, weight, *_ = residual.modelled(point, optics, scale)
        still = residual.modelled(_without_blur(point, scale), optics, scale).light
        observed = torch.stack(scale.observed)
        modelled, observed, still = (
            residual.compressed(each.mean(0)) for each in (modelled, observed, still)
        )
        return cls(modelled, observed, still, weight.amin(0))

    def error(self, modelled: Tensor) -> float:
        """The mean square of what a picture differs from what is observed."""
        total = self.weight.sum().clamp_min(1e-9) * len(modelled)
        return float(((modelled - self.observed) ** 2 * self.weight).sum() / total)

    @property
    def explained(self) -> float:
        """The fraction of the difference between the pictures that the blur explains."""
        before = self.error(self.sharp)
        return 1 - self.error(self.modelled) / before if before > _MINIMUM else 0.0


def _without_blur(point: Candidate, scale: Scale) -> Candidate:
    """A point of the same pictures without blur."""
    minimum = 1e-9 / max(float(scale.disparity.abs().max()), 1e-9)
    return replace(point, strength=minimum, focus=0.0)


def refusals_of(
    evidence: JudgedPair, options: dict[str, bool], point: Candidate
) -> Iterator[Refusal]:
    """Why a point is not the lens of two pictures, the plainest reason alone."""
    if evidence.error(evidence.sharp) <= _MINIMUM:
        yield Refusal(
            "not-explained",
            "the pictures do not differ: nothing is blurred",
            "give a picture that is blurred",
        )
        return
    of_small = _small_correlation(evidence.sharp, evidence.observed)
    cause = None if options["shift"] else _shift_cause(evidence, of_small)
    if cause is None and of_small >= _ALIKE:
        cause = _other_cause(evidence, options)
    alike = min(of_small, _correlation(evidence))
    if cause is not None:
        yield cause
    elif alike < _ALIKE and evidence.explained < _ALL:
        problem = f"the pictures do not show one scene: correlation {alike:.2f}"
        yield Refusal("not-one-scene", problem, "give a pair of one scene, as the camera saw it")
    elif evidence.explained < _EXPLAINED:
        fraction = max(evidence.explained, 0.0)
        problem = f"a blur explains {fraction:.0%} of what the pictures differ by"
        remedy = "see ‹shift›, ‹exposure› and ‹gamma›, or take it as it is by ‹accept›"
        yield Refusal("not-explained", problem, remedy)
    elif max(abs(point.across), abs(point.down)) >= MAX_SHIFT:
        problem = f"the pictures lie {MAX_SHIFT:g} px or more apart, as far as is sought"
        yield Refusal("out-of-range", problem, "crop them to the same place")
    elif abs(math.log(point.magnification)) >= _BOUND * math.log(MAX_MAGNIFICATION):
        problem = f"one picture is magnified by {MAX_MAGNIFICATION - 1:.0%} or more"
        yield Refusal("out-of-range", f"{problem}, as far as is sought", "scale it to the other")


def _shift_cause(evidence: JudgedPair, of_small: float) -> Refusal | None:
    """That one of the pictures lies beside the other, if that explains more than a blur."""
    for image, left in ((evidence.sharp, _CLOSER), (evidence.modelled, _MORE)):
        across, down = _offset(image, evidence.observed)
        there = registered(image[None], across, down, 1.0)[0]
        explains = (
            of_small >= _ALIKE and evidence.error(there) < left * evidence.error(image)
        ) or _puts_right(of_small, _small_correlation(there, evidence.observed))
        if math.hypot(across, down) > _MOVED and explains:
            problem = f"a shift of ({across:.1f}, {down:.1f}) px explains more than a blur alone"
            return Refusal("other-cause", problem, "add ‹shift›")
    return None


def _puts_right(before: float, after: float) -> bool:
    """Whether a change that raises the correlation so much is what was wrong."""
    return after > _ONE_SCENE and max(1 - after, _CHANGED) < _MORE * (1 - before)


def _other_cause(evidence: JudgedPair, options: dict[str, bool]) -> Refusal | None:
    """What explains more than a blur, if something does: the exposure or the gamma."""
    # a wrong lens hides a curve that the sharp picture shows
    images = evidence.modelled, evidence.sharp
    tried = (_curves(image, evidence.observed, evidence.weight) for image in images)
    before, (factor, _, scaled), (_, power, curved) = min(tried, key=lambda each: each[2][2])
    scaled = min(before, scaled)
    if not options["gamma"] and abs(power - 1) > _CHANGED and curved < _MORE * scaled:
        problem = f"a gamma of {power:.2f} explains more than a blur alone"
        return Refusal("other-cause", problem, "add ‹gamma›")
    if not options["exposure"] and abs(factor - 1) > _CHANGED and scaled < _MORE * before:
        problem = f"an exposure of {factor:.2f} times explains more than a blur alone"
        return Refusal("other-cause", problem, "add ‹exposure›")
    return None


def _small(image: Tensor) -> Tensor:
    """A picture [C, h, w] in which a blur hardly shows."""
    height = max(8, round(_SMALL * image.shape[1] / image.shape[2]))
    return interpolate(image[None], (height, _SMALL), mode="area")[0]


def _curves(
    modelled: Tensor, observed: Tensor, weight: Tensor
) -> tuple[float, tuple[float, float, float], tuple[float, float, float]]:
    """The error of small pictures; then factor, power and error by a factor, and by both."""
    modelled, observed, weight = (_small(each) for each in (modelled, observed, weight))
    x, y = (
        (c / (1 - c).clamp_min(1e-6)).clamp_min(1e-4).log().double() for c in (modelled, observed)
    )
    w = (weight * modelled * (1 - modelled)).double()  # where compressed light changes most
    mean_x, mean_y = ((w * each).sum() / w.sum().clamp_min(1e-12) for each in (x, y))
    slope = (w * (x - mean_x) * (y - mean_y)).sum() / (w * (x - mean_x) ** 2).sum().clamp_min(1e-12)

    def error(light: Tensor) -> float:
        return float((weight * (torch.sigmoid(light) - observed) ** 2).sum())

    lines = [(float((mean_y - k * mean_x).exp()), float(k)) for k in (1.0, slope)]
    fits = [(a, k, error(k * x + math.log(a))) for a, k in lines]
    return error(x), fits[0], fits[1]


def _offset(image: Tensor, observed: Tensor) -> tuple[float, float]:
    """The shift in px from a picture to another: whole px, then parts of them."""
    across, down = offset_of(image, observed, int(MAX_SHIFT))
    near = registered(image[None], across, down, 1.0)[0]
    slopes = torch.stack(torch.gradient(near, dim=(2, 1)))  # [2, C, H, W], along x and y
    border = int(MAX_SHIFT)
    inner = (..., slice(border, -border), slice(border, -border))
    slopes, away = slopes[inner].flatten(1).double(), (near - observed)[inner].flatten()
    normal = slopes @ slopes.T + 1e-12 * torch.eye(2, dtype=torch.float64)
    step = torch.linalg.solve(normal, slopes @ away.double()).clamp(-1, 1)
    return across + float(step[0]), down + float(step[1])


def _small_correlation(*pair: Tensor) -> float:
    """That of two pictures so small that a blur hardly shows."""
    first, second = (image - image.mean() for image in map(_small, pair))
    return float((first * second).sum() / (first.norm() * second.norm()).clamp_min(1e-12))


def _correlation(evidence: JudgedPair) -> float:
    """That of what a blur makes and what is observed, without what is wider than a sixteenth."""
    side = max(3, evidence.modelled.shape[2] // 16) | 1
    rest = []
    for image in (evidence.modelled, evidence.observed):
        wide = avg_pool2d(image[None], side, 1, side // 2, count_include_pad=False)[0]
        rest.append((image - wide) * evidence.weight.sqrt())
    norm = (rest[0].norm() * rest[1].norm()).clamp_min(1e-12)
    return float((rest[0] * rest[1]).sum() / norm)


_NEAR_EDGE = 4.0  # px from a step of depth
_MAX_CROSSTALK = 0.49  # of light, that is known from none
_MIN_SLOPE = 1e-9  # of the error, for an unknown that the pictures tell something of


@dataclass(frozen=True)
class Fit:
    """The blur between two pictures.

    Attributes:
        strength: k, px of radius for a disparity of 1, in the blurred picture.
        focus: d₀, the disparity in focus.
        strength_error: Standard error of the strength, relative.
        focus_error: Standard error of the focus, in disparity.
        gamma: Power of the numbers of the pictures that is linear light.
        gamma_error: Its standard error, relative.
        shift: Px by which the blurred picture lies to the right of the sharp one, and below.
        magnification: Size of things in the blurred picture over that in the sharp one, about the
            middle; the shift is applied after it.
        gains: Factor of light of each channel from the sharp to the blurred picture.
        psnr: In dB of compressed light, of all pixels that count, of those near depth edges and of
            others; nan where there are none.
        aperture: The pupil, with its rotation.
        dual_pixel: The photodiodes of a pair; None of one picture.
        crosstalk_error: Standard error of the crosstalk, 0 if it was not sought.
        exchanged: Whether what was given for left is what the right photodiodes saw.
        shading: Of left and right the factor in the middle, and its change over half a frame
            along x and y; empty if it was not sought.
        explained: The fraction of the difference between the pictures that the blur explains.
        doubts: What these pictures could not tell, in words.
        refusals: Why this is not the lens of these pictures; empty if it may well be.
    """

    strength: float
    focus: float
    strength_error: float
    focus_error: float
    gamma: float
    gamma_error: float
    shift: tuple[float, float]
    magnification: float
    gains: tuple[float, ...]
    psnr: tuple[float, float, float]
    aperture: Aperture
    dual_pixel: DualPixel | None
    crosstalk_error: float
    exchanged: bool
    shading: tuple[tuple[float, ...], ...]
    explained: float
    doubts: tuple[str, ...]
    refusals: tuple[Refusal, ...]


def fit(
    sharp: Tensor,
    disparity: Tensor,
    blurred: Tensor | tuple[Tensor, Tensor],
    *,
    apertures: Sequence[Aperture] = (Aperture(),),
    rotation: bool = False,
    dual_pixels: Sequence[DualPixel] = (DualPixel(),),
    crosstalk: bool = False,
    focus: float | None = None,
    strength: Callable[[float], float] | None = None,
    exposure: bool = False,
    side_shading: bool = False,
    gamma: bool = False,
    shift: bool = False,
    depth_repair: str = "auto",
    edge_width: float | None = None,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Fit:
    """Find the blur that turns a sharp picture into a blurred one.

    Args:
        sharp: [C, H, W], linear light; with gamma, of which some power is.
        disparity: [H, W], of any unit and zero, greater when nearer.
        blurred: [C, H, W], light like that of sharp; or (left, right) of a dual-pixel sensor.
        apertures: Pupils to choose from.
        rotation: Whether pupils with blades are turned.
        dual_pixels: Photodiodes of a pair to choose from.
        crosstalk: Whether the crosstalk of a pair is to be found.
        focus: The disparity in focus, if it is known.
        strength: The strength by the disparity in focus, if it is known.
        exposure: Whether each channel may have a factor between the two pictures, and each blurred
            one a falloff of light over the frame.
        side_shading: Whether left and right may have a factor each, a plane over the frame.
        gamma: Whether the power is to be found by which the pictures are linear light.
        shift: Whether the blurred picture may be shifted by up to 16 px, and magnified by 2 %.
        depth_repair: As for `render`.
        edge_width: As for `render`.
        threads: As for `render`.
        progress: Called with (renderings done, about how many in all).

    Raises:
        ValueError: If shapes disagree, a value is not finite, the depth is the same everywhere and
            the focus not known, or no pixel tells anything, as of pictures that are white.
    """
    given = blurred if isinstance(blurred, tuple) else (blurred,)
    _check(sharp, disparity, given, plane=focus is not None)
    sharp, *observed = _one_channel(sharp, *given)
    free = {
        "strength": strength is None,
        "focus": focus is None,
        "gamma": gamma,
        **dict.fromkeys(("across", "down", "magnification"), shift),
        "separation": crosstalk and len(observed) > 1,
    }
    span = float(disparity.max() - disparity.min())
    with torch.no_grad(), own_modes(sharp.device):
        residual = Residual(
            sharp,
            disparity,
            tuple(observed),
            exposure=exposure,
            side_shading=side_shading,
            depth_repair=depth_repair,
            edge_width=edge_width,
            threads=threads,
            progress=progress,
        )
        rows = unknowns(span, (name for name, is_free in free.items() if is_free))
        search = Search(residual, rows, rotation=rotation, focus=focus, strength=strength)
        fitted = search.best([Optics(*each) for each in product(apertures, dual_pixels)])
        if not math.isfinite(fitted.error):
            raise ValueError(
                "hardly a pixel tells anything: nearly all are clipped, or seen from beyond the "
                "border; give a darker picture, or one that is blurred less"
            )
        sought = {"shift": shift, "exposure": exposure, "gamma": gamma}
        return _fit_of(search, fitted, disparity, sought)


def _one_channel(*pictures: Tensor) -> list[Tensor]:
    """Pictures [C, H, W] with one channel, if all channels are the same."""
    same = all(bool((each == each[:1]).all()) for each in pictures)
    return [each[:1] if same else each for each in pictures]


def _check(sharp: Tensor, disparity: Tensor, observed: tuple[Tensor, ...], *, plane: bool) -> None:
    """Refuse pictures that do not belong together."""
    if sharp.dim() != 3 or disparity.shape != sharp.shape[1:]:
        raise ValueError(
            "sharp must be [C, H, W] and disparity [H, W] of the same size, got "
            f"{described(sharp)} and {described(disparity)}"
        )
    for each in observed:
        if each.shape != sharp.shape:
            raise ValueError(f"blurred must have the shape of sharp, got {described(each)}")
    for name, values in (("sharp", sharp), ("disparity", disparity), ("blurred", observed[0])):
        if not bool(torch.isfinite(values).all()):
            raise ValueError(f"{name} must be finite; infinitely far is a disparity of 0")
    if float(disparity.max() - disparity.min()) <= 0 and not plane:
        raise ValueError(
            "disparity must differ somewhere: one plane does not tell where focus is; give its "
            "‹focus›"
        )


def _fit_of(search: Search, fitted: FittedLens, disparity: Tensor, sought: dict[str, bool]) -> Fit:
    """What was found, with its uncertainty: blocks of the picture stand for chance.

    The covariance is that of clustered residuals, H⁻¹ (Σ g gᵀ) H⁻¹ (Liang & Zeger 1986).
    """
    scale, point, optics = search.residual.scale(MIDDLE), fitted.point, fitted.optics
    free = search.free(optics)
    residual, weight = search.residual.of(point, optics, scale)
    errors = _errors(search, fitted, scale, free, float(weight.sum()))
    radius = point.strength * scale.factor * (point.focus - scale.disparity)
    pair = len(scale.observed) > 1
    modelled = search.residual.modelled(point, optics, scale)
    evidence = JudgedPair.of(search.residual, point, optics)
    return Fit(
        point.strength * point.magnification,
        point.focus,
        errors.get("strength", 0.0),
        errors.get("focus", 0.0),
        point.gamma,
        errors.get("gamma", 0.0),
        (point.across, point.down),
        point.magnification,
        tuple(modelled.gains.tolist()),
        _psnr(residual, weight, radius),
        point.turned(optics.aperture),
        _with_crosstalk(optics.dual_pixel, point.separation) if pair else None,
        errors.get("separation", 0.0) / 2,
        point.separation < 0,
        tuple(map(tuple, modelled.shading.tolist())),
        evidence.explained,
        tuple(_doubts(fitted, disparity, errors)),
        tuple(refusals_of(evidence, sought, point)),
    )


def _errors(
    search: Search, fitted: FittedLens, scale: Scale, free: list[Unknown], count: float
) -> dict[str, float]:
    """The standard error of each unknown; infinite where the pictures tell nothing of it."""
    if not free:
        return {}
    hessian, gradient = search.normal(fitted, scale, free)
    inverse = torch.linalg.pinv(hessian.sum(0))
    variance = (inverse @ (gradient.T @ gradient) @ inverse).diagonal().clamp_min(0)
    untold = hessian.sum(0).diagonal() <= _MIN_SLOPE * count
    sizes = variance.sqrt().masked_fill(untold, math.inf)
    return {u.name: u.unit * float(size) for u, size in zip(free, sizes, strict=True)}


def _with_crosstalk(dual_pixel: DualPixel, separation: float) -> DualPixel:
    """Photodiodes whose left and right are as far apart as found."""
    fraction = (1 - abs(separation) * (1 - 2 * float(dual_pixel.crosstalk))) / 2
    return replace(dual_pixel, crosstalk=min(max(fraction, 0.0), _MAX_CROSSTALK))


def _psnr(residual: Tensor, weight: Tensor, radius: Tensor) -> tuple[float, float, float]:
    """In dB, of all, of pixels near depth edges, and of others."""
    near = near_edges(radius, _NEAR_EDGE)

    def of(which: Tensor) -> float:
        chosen = weight * which
        count = float(chosen.sum()) * residual.shape[1]
        return psnr(float((residual**2 * chosen).sum()) / count) if count else math.nan

    return of(torch.ones_like(near)), of(near), of(~near)


def _doubts(fitted: FittedLens, disparity: Tensor, errors: dict[str, float]) -> list[str]:
    """What the pictures do not tell."""
    point, nearest, farthest = fitted.point, float(disparity.max()), float(disparity.min())
    maximum = point.strength * max(abs(point.focus - nearest), abs(point.focus - farthest))
    doubts = {
        "the focus lies beyond all depths of the picture, and is extrapolated": (
            "focus" in errors and not farthest <= point.focus <= nearest
        ),
        "the strength may be off by more than 10 %": errors.get("strength", 0.0) > 0.1,
        "the focus may be off by more than a tenth of the range of disparity": (
            errors.get("focus", 0.0) > 0.1 * (nearest - farthest)
        ),
        "the gamma may be off by more than 10 %": errors.get("gamma", 0.0) > 0.1,
        "the rotation of the blades may be off by more than 10 degrees": (
            errors.get("rotation", 0.0) > 10
        ),
        "left and right are exchanged: the first is what the right photodiodes saw": (
            point.separation < 0
        ),
        "the crosstalk may be off by more than 0.1": errors.get("separation", 0.0) > 0.2,
        "hardly anything is blurred: strength and focus are uncertain": (
            maximum < 1.5 and not errors.keys().isdisjoint({"strength", "focus"})
        ),
    }
    return [words for words, holds in doubts.items() if holds]

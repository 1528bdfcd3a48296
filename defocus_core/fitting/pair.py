"""The lens of a real pair: focus and strength of the blur between a sharp and a blurred picture.

Both, and what else is unknown, are found by a coarse search over small pictures, then by
Gauss-Newton steps over larger ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import torch
from torch import Tensor

from defocus_core.evaluation.metrics import near_edges
from defocus_core.evaluation.similarity import psnr
from defocus_core.fitting.pictures import Scale
from defocus_core.fitting.refusals import JudgedPair, Refusal, refusals_of
from defocus_core.fitting.residual import Optics, Residual
from defocus_core.fitting.search import MIDDLE, FittedLens, Search
from defocus_core.fitting.unknowns import Unknown, unknowns
from defocus_core.optics.aperture import Aperture
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.tensors.torch_modes import own_modes
from defocus_core.tensors.validation import described

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
    blurred: Tensor | tuple[Tensor, ...],
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
            f"{described(sharp)} and {described(disparity)}; resample one of them"
        )
    for each in observed:
        if each.shape != sharp.shape:
            got = described(each)
            raise ValueError(f"blurred must have the shape of sharp, got {got}; crop one of them")
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
    hessian, gradient = search.normal(fitted, scale, free, [each.probe for each in free])
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

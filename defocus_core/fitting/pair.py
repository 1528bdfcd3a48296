"""The lens of a real pair: focus and strength of the blur between a sharp and a blurred picture.

Both, and what else is unknown, are found by a coarse search over small pictures, then by
Gauss-Newton steps over larger ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

from defocus_core.fitting.residual import Residual
from defocus_core.fitting.search import MIDDLE, Found, Search
from defocus_core.fitting.unknowns import MOST_SHIFT, unknowns
from defocus_core.optics.aperture import Aperture
from defocus_core.tensors.torch_modes import own_modes
from defocus_core.tensors.validation import described

_LEAST_SLOPE = 1e-9  # of the error, for an unknown that the pictures tell something of


@dataclass(frozen=True)
class Fit:
    """The blur between two pictures.

    Attributes:
        strength: k, px of radius for a disparity of 1.
        focus: d₀, the disparity in focus.
        strength_error: Standard error of the strength, relative.
        focus_error: Standard error of the focus, in disparity.
        gamma: Power of the numbers of the pictures that is linear light.
        gamma_error: Its standard error, relative.
        shift: Px by which the blurred picture lies to the right of the sharp one, and below.
        gains: Factor of light of each channel from the sharp to the blurred picture.
        psnr: In dB of compressed light, of all pixels that count, of those near depth edges and of
            others; nan where there are none.
        aperture: The pupil, with its rotation.
        doubts: What these pictures could not tell, in words.
    """

    strength: float
    focus: float
    strength_error: float
    focus_error: float
    gamma: float
    gamma_error: float
    shift: tuple[float, float]
    gains: tuple[float, ...]
    psnr: tuple[float, float, float]
    aperture: Aperture
    doubts: tuple[str, ...]


def fit(
    sharp: Tensor,
    disparity: Tensor,
    blurred: Tensor | tuple[Tensor, Tensor],
    *,
    apertures: Sequence[Aperture] = (Aperture(),),
    rotation: bool = False,
    exposure: bool = False,
    gamma: bool = False,
    shift: bool = False,
    depth_repair: str = "auto",
    edge_width: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Fit:
    """Find the blur that turns a sharp picture into a blurred one.

    Args:
        sharp: [C, H, W], linear light; with gamma, of which some power is.
        disparity: [H, W], of any unit and zero, greater when nearer.
        blurred: [C, H, W], light like that of sharp; or (left, right) of a dual-pixel sensor.
        apertures: Pupils to choose from.
        rotation: Whether pupils with blades are turned.
        exposure: Whether each channel may have a factor between the two pictures.
        gamma: Whether the power is to be found by which the pictures are linear light.
        shift: Whether the blurred picture may be shifted by up to 16 px.
        depth_repair: As for `render`.
        edge_width: As for `render`.
        progress: Called with (renderings done, about how many in all).

    Raises:
        ValueError: If shapes disagree, a value is not finite, the depth is the same everywhere, or
            no pixel tells anything, as of pictures that are white.
    """
    seen = blurred if isinstance(blurred, tuple) else (blurred,)
    _check(sharp, disparity, seen)
    span = float(disparity.max() - disparity.min())
    with torch.no_grad(), own_modes(sharp.device):
        residual = Residual(
            sharp,
            disparity,
            seen,
            exposure=exposure,
            depth_repair=depth_repair,
            edge_width=edge_width,
            progress=progress,
        )
        free = unknowns(span, gamma=gamma, shift=shift)
        search = Search(residual, free, rotation=rotation)
        found = search.best(apertures)
        if not math.isfinite(found.error):
            raise ValueError(
                "hardly a pixel tells anything: nearly all are clipped, or seen from beyond the "
                "border; give a darker picture, or one that is blurred less"
            )
        return _told(search, found, disparity)


def _check(sharp: Tensor, disparity: Tensor, seen: tuple[Tensor, ...]) -> None:
    """Refuse pictures that do not belong together."""
    if sharp.dim() != 3 or disparity.shape != sharp.shape[1:]:
        raise ValueError(
            "sharp must be [C, H, W] and disparity [H, W] of the same size, got "
            f"{described(sharp)} and {described(disparity)}"
        )
    for each in seen:
        if each.shape != sharp.shape:
            raise ValueError(f"blurred must have the shape of sharp, got {described(each)}")
    for name, values in (("sharp", sharp), ("disparity", disparity), ("blurred", seen[0])):
        if not bool(torch.isfinite(values).all()):
            raise ValueError(f"{name} must be finite; infinitely far is a disparity of 0")
    if float(disparity.max() - disparity.min()) <= 0:
        raise ValueError("disparity must differ somewhere: one plane does not tell where focus is")


def _told(search: Search, found: Found, disparity: Tensor) -> Fit:
    """What was found, with its uncertainty: blocks of the picture stand for chance.

    The covariance is that of clustered residuals, H⁻¹ (Σ g gᵀ) H⁻¹ (Liang & Zeger 1986).
    """
    scale, point = search.residual.scale(MIDDLE), found.point
    free = search.free(found.aperture)
    residual, weight = search.residual.of(point, found.aperture, scale)
    hessian, gradient = search.normal(found, scale, free)
    inverse = torch.linalg.pinv(hessian.sum(0))
    variance = (inverse @ (gradient.T @ gradient) @ inverse).diagonal().clamp_min(0)
    untold = hessian.sum(0).diagonal() <= _LEAST_SLOPE * float(weight.sum())
    sizes = variance.sqrt().masked_fill(untold, math.inf)
    errors = {u.name: u.unit * float(size) for u, size in zip(free, sizes, strict=True)}
    radius = point.strength * scale.factor * (point.focus - scale.disparity)
    return Fit(
        point.strength,
        point.focus,
        errors["strength"],
        errors["focus"],
        point.gamma,
        errors.get("gamma", 0.0),
        (point.across, point.down),
        tuple(search.residual.gains(point, found.aperture, scale).tolist()),
        _psnr(residual, weight, radius),
        point.turned(found.aperture),
        tuple(_doubts(found, disparity, errors)),
    )


def _psnr(residual: Tensor, weight: Tensor, radius: Tensor) -> tuple[float, float, float]:
    """In dB, of all, of pixels near depth edges, and of others."""
    steep = torch.zeros_like(radius, dtype=torch.bool)
    steep[:, 1:] |= (radius[:, 1:] - radius[:, :-1]).abs() > 1
    steep[1:] |= (radius[1:] - radius[:-1]).abs() > 1
    near = max_pool2d(steep[None, None].float(), 9, 1, padding=4)[0, 0] > 0

    def of(which: Tensor) -> float:
        chosen = weight * which
        count = float(chosen.sum()) * residual.shape[1]
        error = float((residual**2 * chosen).sum()) / count if count else math.nan
        return -10 * math.log10(max(error, 1e-12)) if count else math.nan

    return of(torch.ones_like(near)), of(near), of(~near)


def _doubts(found: Found, disparity: Tensor, errors: dict[str, float]) -> list[str]:
    """What the pictures do not tell."""
    point, nearest, farthest = found.point, float(disparity.max()), float(disparity.min())
    most = point.strength * max(abs(point.focus - nearest), abs(point.focus - farthest))
    doubts = {
        "the focus lies beyond all depths of the picture, and is extrapolated": not (
            farthest <= point.focus <= nearest
        ),
        "the strength is known to more than 10 % only": errors["strength"] > 0.1,
        "the focus is known to a tenth of the range of disparity only": (
            errors["focus"] > 0.1 * (nearest - farthest)
        ),
        "the gamma is known to more than 10 % only": errors.get("gamma", 0.0) > 0.1,
        f"the pictures are shifted by {MOST_SHIFT:g} px or more": (
            max(abs(point.across), abs(point.down)) >= MOST_SHIFT
        ),
        "the rotation of the blades is known to 10 degrees or less well": (
            errors.get("rotation", 0.0) > 10
        ),
        "hardly anything is blurred: strength and focus are uncertain": most < 1.5,
    }
    return [words for words, holds in doubts.items() if holds]

"""The lens of a real pair: focus and strength of the blur between a sharp and a blurred picture.

The radius of the blur is affine in disparity, r = k (d₀ - d), whatever units d has (`thin_lens`):
k is the strength in px for a disparity of 1, d₀ is the disparity in focus. Both are found by a
coarse search over small pictures, then by Gauss-Newton steps over larger ones whose residuals are
weighed down where they are large (Huber), where light is clipped, and where the rendering invents.
Differences are taken of light compressed by x / (x + m), so that a lamp does not outweigh a scene.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

from defocus_core.fit_search import MIDDLE, Search
from defocus_core.optics.aperture import Aperture
from defocus_core.runtime.torch_modes import own_modes
from defocus_core.runtime.validation import described


@dataclass(frozen=True)
class Fit:
    """The blur between two pictures.

    Attributes:
        strength: k, px of radius for a disparity of 1.
        focus: d₀, the disparity in focus.
        strength_error: Standard error of the strength, relative.
        focus_error: Standard error of the focus, in disparity.
        gains: Factor of each channel from the sharp to the blurred picture.
        psnr: In dB of compressed light, of all pixels that count, of those near depth edges and of
            others; nan where there are none.
        aperture: The pupil.
        doubts: What these pictures could not tell, in words.
    """

    strength: float
    focus: float
    strength_error: float
    focus_error: float
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
    exposure: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Fit:
    """Find the blur that turns a sharp picture into a blurred one.

    Args:
        sharp: [C, H, W], linear light.
        disparity: [H, W], of any unit and zero, greater when nearer.
        blurred: [C, H, W], linear light; or (left, right) of a dual-pixel sensor.
        apertures: Pupils to choose from.
        exposure: Whether each channel may have a factor between the two pictures.
        progress: Called with (renderings done, about how many in all).

    Raises:
        ValueError: If shapes disagree, a value is not finite, or the depth is the same everywhere.
    """
    seen = blurred if isinstance(blurred, tuple) else (blurred,)
    _check(sharp, disparity, seen)
    with torch.no_grad(), own_modes(sharp.device):
        search = Search(sharp, disparity, seen, exposure, progress)
        best = min((search.best(each) for each in apertures), key=lambda found: found[0])
        return _told(search, *best[1:])


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


def _told(search: Search, point: Tensor, aperture: Aperture) -> Fit:
    """What was found, with its uncertainty: blocks of the picture stand for chance.

    The covariance is that of clustered residuals, H⁻¹ (Σ g gᵀ) H⁻¹ (Liang & Zeger 1986).
    """
    scale = search.scale(MIDDLE if search.pictures[0].shape[2] > MIDDLE else None)
    residual, weight = search.residual(point, aperture, scale)
    hessian, gradient = search.normal(point, aperture, scale, residual, weight)
    inverse = torch.linalg.pinv(hessian.sum(0))
    covariance = inverse @ (gradient.T @ gradient) @ inverse
    errors = covariance.diagonal().clamp_min(0).sqrt()
    strength, focus = math.exp(float(point[0])), float(point[1])
    images, _ = search.rendered(point, aperture, scale, "standard")
    gains = torch.ones(len(scale.sharp))
    if search.exposure:
        gains = search.gains(torch.stack(images), torch.stack(list(scale.seen)), weight)
    return Fit(
        strength,
        focus,
        float(errors[0]),
        float(errors[1]) * search.range,
        tuple(gains.tolist()),
        _psnr(residual, weight, strength * (focus - scale.disparity) * scale.factor),
        aperture,
        tuple(_doubts(search, strength, focus, errors)),
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


def _doubts(search: Search, strength: float, focus: float, errors: Tensor) -> list[str]:
    """What the pictures do not tell."""
    doubts = []
    nearest, farthest = search.zero + search.range, search.zero
    if not farthest <= focus <= nearest:
        doubts.append("the focus lies beyond all depths of the picture, and is extrapolated")
    if float(errors[0]) > 0.1:
        doubts.append("the strength is known to more than 10 % only")
    if float(errors[1]) > 0.1:
        doubts.append("the focus is known to a tenth of the range of disparity only")
    most = strength * max(abs(focus - nearest), abs(focus - farthest))
    if most < 1.5:
        doubts.append("hardly anything is blurred: strength and focus are uncertain")
    return doubts

"""Error metrics of a picture against its truth, at depth edges and elsewhere.

PSNR and SSIM are computed from what a screen shows: sRGB-encoded values, clipped to [0, 1]; RMSE
and the percentile from linear light. All is computed in float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.evaluation.similarity import REACH, psnr, similarity

# A depth edge lies between neighbours whose CoC radii differ by more px than this.
_EDGE = 1.0
_LUMA = (0.2126, 0.7152, 0.0722)


@dataclass(frozen=True)
class Errors:
    """Errors of a picture against its truth."""

    psnr: float  # dB, of sRGB-encoded values with a peak of 1
    psnr_edges: float | None  # the same over the pixels near depth edges; None if there are none
    psnr_elsewhere: float | None  # the same over all other pixels; None if there are none
    rel_rmse: float  # linear RMSE divided by the mean of the truth
    ssim: float  # structural similarity of encoded luma
    p999: float  # 99.9th percentile of the absolute error, linear


def measure(picture: Tensor, truth: Tensor, signed_radius: Tensor, *, border: int) -> Errors:
    """All errors of a picture, without the border, which depends on content outside the frame.

    Args:
        picture: [3, H, W], linear.
        truth: [3, H, W], linear.
        signed_radius: [H, W] px.
        border: px left out on each side, the greatest CoC radius rounded up. Pixels within `border`
            px of a depth edge count as near it.

    Raises:
        ValueError: If shapes differ, the border leaves less than 11 px, or a pixel of the picture
            is not finite.
    """
    if picture.shape != truth.shape or picture.shape[-2:] != signed_radius.shape:
        wanted = f"[3, H, W] of the signed_radius {tuple(signed_radius.shape)}"
        got = f"{tuple(picture.shape)} and {tuple(truth.shape)}"
        raise ValueError(f"picture and truth must be {wanted}, got {got}")
    if min(signed_radius.shape) - 2 * border < 2 * REACH + 1:
        raise ValueError(f"border must leave 11 px at least, got {border}; use a larger picture")
    if not bool(torch.isfinite(picture).all()):
        raise ValueError("picture must be finite, got NaN or infinity")
    edges = near_edges(signed_radius, border)
    inner = (..., slice(border, -border or None), slice(border, -border or None))
    picture, truth, edges = picture[inner].double(), truth[inner].double(), edges[inner]
    shown, aim = encoded(picture), encoded(truth)
    squares = (shown - aim).square().mean(0)  # [H, W]
    error = picture - truth
    return Errors(
        psnr=decibels(squares),
        psnr_edges=decibels(squares[edges]) if bool(edges.any()) else None,
        psnr_elsewhere=None if bool(edges.all()) else decibels(squares[~edges]),
        rel_rmse=float(error.square().mean().sqrt() / truth.mean()),
        ssim=ssim(luma(shown), luma(aim)),
        p999=percentile(error.abs(), 99.9),
    )


def encoded(linear: Tensor) -> Tensor:
    """Linear values encoded as sRGB (IEC 61966-2-1), clipped to [0, 1]."""
    x = linear.clamp(0, 1)
    curve = 1.055 * x.clamp(min=0.003) ** (1 / 2.4) - 0.055
    return torch.where(x <= 0.0031308, 12.92 * x, curve)


def luma(rgb: Tensor) -> Tensor:
    """Luma [H, W] of encoded Rec. 709 pixels [3, H, W]."""
    return torch.einsum("chw,c->hw", rgb, rgb.new_tensor(_LUMA))


def decibels(squares: Tensor) -> float:
    """PSNR of squared errors for a peak of 1; 99 if their mean is below 1e-10."""
    return psnr(float(squares.mean()))


def ssim(a: Tensor, b: Tensor) -> float:
    """Mean structural similarity of pictures [H, W] in [0, 1], over windows within the frame."""
    return float(similarity(a, b).mean())


def percentile(values: Tensor, percent: float) -> float:
    """A percentile (0 to 100) of values, interpolated linearly between the two nearest."""
    position = percent / 100 * (values.numel() - 1)
    lower = math.floor(position)
    top = values.flatten().topk(values.numel() - lower).values
    low, high = float(top[-1]), float(top[max(len(top) - 2, 0)])
    return low + (position - lower) * (high - low)


def near_edges(signed_radius: Tensor, distance: float) -> Tensor:
    """Mask [H, W] of the pixels within `distance` px of a depth edge.

    A depth edge lies between neighbours in a row or a column whose signed radii differ by more than
    1 px; both neighbours belong to it.
    """
    H, W = signed_radius.shape
    across, down = (signed_radius.diff(dim=dim).abs() > _EDGE for dim in (1, 0))
    edge = pad(across, (1, 0)) | pad(across, (0, 1))
    edge |= pad(down, (0, 0, 1, 0)) | pad(down, (0, 0, 0, 1))
    # A convolution counts the edge pixels within the disc around each pixel.
    reach = math.floor(distance)
    offset = torch.arange(-reach, reach + 1, dtype=torch.float64, device=edge.device)
    disc = (offset[:, None].square() + offset.square() <= distance * distance).double()
    size = (H + 2 * reach, W + 2 * reach)
    spectrum = torch.fft.rfft2(edge.double(), s=size) * torch.fft.rfft2(disc, s=size)
    count: Tensor = torch.fft.irfft2(spectrum, s=size)
    return count[reach : reach + H, reach : reach + W] > 0.5

"""Motion between frames: chained over several frames, and the change of depth that goes with it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

# Degree of the polynomial of radii; pixels that it is fitted to, at most; rounds; distance from it
# in medians, and in px at least, of pixels that both frames show; weight of no change.
_DEGREE, _SAMPLE, _ROUNDS, _CLOSE, _LEAST, _RIDGE = 2, 1 << 16, 4, 4.0, 0.05, 1e-6


class Frame(NamedTuple):
    """A frame of a shot, as it is needed for another one.

    Attributes:
        image: [C, H, W] linear.
        signed_radius: [H, W] px, through the lens of the other frame.
        motion: [2, H, W] px, right and down, to where the surface of each pixel is in the next
            frame on the way to the other one; None where nothing is known to move.
    """

    image: Tensor
    signed_radius: Tensor
    motion: Tensor | None = None


def places(size: tuple[int, int], like: Tensor) -> Tensor:
    """The places [2, H, W] of the pixels of a frame: columns, then rows."""
    rows, columns = (torch.arange(n, dtype=like.dtype, device=like.device) for n in size)
    return torch.stack(torch.meshgrid(columns, rows, indexing="xy"))


def nearest_pixels(at: Tensor, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """The numbers [H, W] of the pixels nearest to places [2, H, W], and whether they exist."""
    column, row = at.round()
    inside = (column >= 0) & (column < size[1]) & (row >= 0) & (row < size[0])
    number = row.clamp(0, size[0] - 1) * size[1] + column.clamp(0, size[1] - 1)
    return torch.where(inside, number, 0).long(), inside


def chained(motions: Sequence[Tensor], radii: Sequence[Tensor], step: float) -> Tensor:
    """The motion [2, H, W] from the first of some frames to the one after the last of them.

    At each frame on the way the motion of the pixel there is taken if it is of the same surface, as
    its radius tells; a surface that is hidden there is taken to move on as it did.

    Args:
        motions: [2, H, W] px each, from every frame to the next.
        radii: [H, W] px each, of the same frames.
        step: Greatest difference of radii in px of one surface in two frames.
    """
    total, last, own = motions[0], motions[0], radii[0]
    size = own.shape[0], own.shape[1]
    start = places(size, total)
    for motion, radius in zip(motions[1:], radii[1:], strict=True):
        index, inside = nearest_pixels(start + total, size)
        there = radius.flatten()[index]
        same = inside & ((there - own).abs() <= step)
        own = torch.where(same, there, own)
        last = torch.where(same, motion.flatten(1)[:, index], last)
        total = total + last
    return total


def approached(radius: Tensor, there: Tensor) -> tuple[Tensor, float]:
    """Radii of a neighbour as they would be in the frame, if the camera has moved.

    A camera that comes nearer by e makes disparity d to d + e d² + …: a polynomial of the radius is
    fitted to the pixels that both frames show, which are most of them.

    Args:
        radius: [n] px of the neighbour.
        there: [n] px of the frame, where the motion leads.

    Returns:
        [n] px, and the median distance in px of pixels that both show from the polynomial.
    """
    whole = (radius.isfinite() & there.isfinite()).nonzero()[:, 0]
    sample = whole[:: max(1, len(whole) // _SAMPLE)]
    if len(sample) <= _DEGREE:
        return radius, 0.0
    x, y = radius[sample].double(), there[sample].double()
    middle, scale = x.mean(), x.std().clamp(min=1e-6)
    powers = ((x - middle) / scale)[:, None] ** torch.arange(_DEGREE + 1, device=x.device)
    off, change = y - x, torch.zeros_like(x)
    coefficients = x.new_zeros(_DEGREE + 1)
    for _ in range(_ROUNDS):
        distance = (off - change).abs()
        close = distance <= (_CLOSE * distance.median()).clamp(min=_LEAST)
        gram = powers[close].mT @ powers[close]
        gram += _RIDGE * len(x) * torch.eye(_DEGREE + 1, dtype=x.dtype, device=x.device)
        coefficients = torch.linalg.solve(gram, powers[close].mT @ off[close])
        change = powers @ coefficients
    spread = float((off - change).abs().median())
    every = ((radius.double() - middle) / scale)[:, None] ** torch.arange(
        _DEGREE + 1, device=x.device
    )
    return radius + (every @ coefficients).to(radius.dtype), spread

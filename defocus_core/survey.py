"""What a first look over a picture tells: its ranges, and how steep and how bright it is."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.threads import threaded
from defocus_core.tiling import Box

# Rows looked at at once.
_BAND = 256


class Survey(NamedTuple):
    """A picture in a few numbers.

    Attributes:
        least: Signed radius in px.
        most: The same.
        steepest: Greatest differences of radius between neighbours in px: down, across.
        darkest: Least value of all channels.
        brightness: [H, W], of each pixel that of its brightest channel.
    """

    least: float
    most: float
    steepest: tuple[float, float]
    darkest: float
    brightness: Tensor


def bands(height: int, rows: int = _BAND) -> list[tuple[int, int]]:
    """First and last row + 1 of the bands of a frame."""
    return list(pairwise([*range(0, height, rows), height]))


def survey(pixels: Tensor, signed_radius: Tensor, dtype: torch.dtype, threads: int) -> Survey:
    """Look at each pixel once.

    Args:
        pixels: [C, H, W].
        signed_radius: [H, W] px.
        dtype: To compute in.
        threads: Bands of rows looked at at once.

    Raises:
        ValueError: If a value is not finite.
    """
    H, W = signed_radius.shape

    def looked_at(rows: tuple[int, int]) -> tuple[Tensor, Tensor]:
        band = Box(rows[0], 0, rows[1] - rows[0], W)
        some, r = (band.of(x.detach()).to(dtype) for x in (pixels, signed_radius))
        below = signed_radius.detach()[rows[0] : rows[1] + 1].to(dtype)
        steps = [
            step.abs().amax() if step.numel() else r.new_zeros(())
            for step in (below.diff(dim=0), r.diff(dim=1))
        ]
        return torch.stack([*torch.aminmax(r), *steps, *torch.aminmax(some)]), some.amax(0)

    found, brightness = zip(*threaded(looked_at, bands(H), threads), strict=True)
    numbers = torch.stack(found)
    least, most, down, across, darkest, brightest = numbers.unbind(1)
    ends = torch.stack([least.amin(), most.amax(), darkest.amin(), brightest.amax()])
    for name, pair in (("signed_radius", ends[:2]), ("image", ends[2:])):
        if not bool(torch.isfinite(pair).all()):
            raise ValueError(f"{name} must be finite, got NaN or infinity; repair it first")
    return Survey(
        least=float(ends[0]),
        most=float(ends[1]),
        steepest=(float(down.amax()), float(across.amax())),
        darkest=float(ends[2]),
        brightness=torch.cat(brightness),
    )

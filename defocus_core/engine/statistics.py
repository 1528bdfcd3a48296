"""Statistics of a picture: the range and steepness of its radii, and its brightness."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.images.box import Box
from defocus_core.images.neighbourhoods import ends_of
from defocus_core.images.order_statistics import Ranks, counted
from defocus_core.images.source import Pixels, banded, bands
from defocus_core.runtime.threads import threaded

# Px of radius: any picture is a point beside it.
MOST = 1e8
# Light beyond this, of either sign, would make sums over an aperture or a frame overflow float32.
BRIGHTEST = 1e30
# Every how many rows and columns the brightness of a pixel is taken where a sample is enough.
_SAMPLED = 3


class Survey(NamedTuple):
    """A picture in a few numbers. The brightness of a pixel is that of its brightest channel.

    Attributes:
        least: Signed radius in px.
        most: The same.
        steepest: Greatest differences of radius between neighbours in px: down, across.
        darkest: Least value of all channels.
        brightest: Greatest value of all channels.
        brightness: Of all pixels.
        lit: Brightness of some pixels, evenly spread.
        black: How many of these are not positive.
    """

    least: float
    most: float
    steepest: tuple[float, float]
    darkest: float
    brightest: float
    brightness: Ranks
    lit: Ranks
    black: int


def survey(
    pixels: Pixels,
    signed_radius: Pixels,
    dtype: torch.dtype,
    threads: int,
) -> Survey:
    """Look at each pixel once.

    Args:
        pixels: [C, H, W].
        signed_radius: [H, W] px.
        dtype: To compute in.
        threads: Bands of rows looked at at once.

    Raises:
        ValueError: If a value is not finite, a radius beyond `MOST`, or light beyond `BRIGHTEST`.
    """
    H, W = signed_radius.shape

    def looked_at(rows: tuple[int, int]) -> tuple[Tensor, Tensor, list[Tensor]]:
        """Statistics of radii, the least and greatest value of colours, and counts that add up."""
        some = Box(rows[0], 0, rows[1] - rows[0], W).of(pixels).detach().to(dtype)
        brightness = some.amax(0)
        few = _few(brightness, rows[0])
        counts = [counted(brightness), counted(few), (few <= 0).sum()]
        radii = _of_radii(signed_radius[rows[0] : rows[1] + 1].detach().to(dtype), rows)
        return radii, torch.stack([some.amin(), brightness.amax()]), counts

    of_radii: list[Tensor] = []
    values: list[Tensor] = []
    total: list[Tensor] = []
    for radii, pair, counts in threaded(looked_at, bands(H, W), threads):
        of_radii.append(radii)
        values.append(pair)
        total = [a + b for a, b in zip(total, counts, strict=True)] if total else counts
    brightness, lit, black = total
    least, most, down, across = torch.stack(of_radii).unbind(1)
    darkest, brightest = torch.stack(values).unbind(1)
    ends = torch.stack([least.amin(), most.amax(), darkest.amin(), brightest.amax()])
    for name, pair in (("signed_radius", ends[:2]), ("image", ends[2:])):
        if not bool(torch.isfinite(pair).all()):
            raise ValueError(f"{name} must be finite, got NaN or infinity; repair it first")
    if max(-ends[0], ends[1]) > MOST:
        raise ValueError(
            f"signed_radius must be within {MOST:g} px, got {ends[0]:.3g} to {ends[1]:.3g} px; "
            "check the units of depth and lens, and write inf for sky"
        )
    if max(-ends[2], ends[3]) > BRIGHTEST:
        raise ValueError(
            f"image must be within ±{BRIGHTEST:g}, got {ends[2]:.3g} to {ends[3]:.3g}; "
            "scale it, light has no unit here"
        )

    def brightness_again() -> Iterator[Tensor]:
        return (band.to(dtype).amax(0) for band in banded(pixels))

    def lit_again() -> Iterator[Tensor]:
        return map(_few, brightness_again(), (first for first, _ in bands(H, W)))

    return Survey(
        least=float(ends[0]),
        most=float(ends[1]),
        steepest=(float(down.amax()), float(across.amax())),
        darkest=float(ends[2]),
        brightest=float(ends[3]),
        brightness=Ranks(brightness, brightness_again, dtype),
        lit=Ranks(lit, lit_again, dtype),
        black=int(black),
    )


def _of_radii(band: Tensor, rows: tuple[int, int]) -> Tensor:
    """Least and greatest radius of some rows, and greatest step down and across: [4].

    Args:
        band: [h, W] px, these rows and the one below them.
        rows: First and last row + 1.
    """
    radii = band[: rows[1] - rows[0]]
    steps = band.diff(dim=0), radii.diff(dim=1)
    steepest = [float(ends_of(step).abs().amax()) if step.numel() else 0.0 for step in steps]
    return torch.cat([ends_of(radii), radii.new_tensor(steepest)])


def _few(brightness: Tensor, first: int) -> Tensor:
    """Some pixels of a band that begins at a row: the same of the frame, however it is banded."""
    return brightness[-first % _SAMPLED :: _SAMPLED, ::_SAMPLED]

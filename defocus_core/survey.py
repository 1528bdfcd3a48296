"""What a first look over a picture tells: its ranges, and how steep and how bright it is."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.ramps import has_ramps
from defocus_core.ranks import Ranks, counted
from defocus_core.source import Pixels, banded, bands
from defocus_core.terraces import Levels, are_few, levels_of
from defocus_core.threads import threaded
from defocus_core.tiling import Box

# Every how many rows and columns a pixel is looked at where some will do.
_SOME = 3


class Survey(NamedTuple):
    """A picture in a few numbers. The brightness of a pixel is that of its brightest channel.

    Attributes:
        least: Signed radius in px.
        most: The same.
        steepest: Greatest differences of radius between neighbours in px: down, across.
        ramps: Whether soft edges of depth are to be made steps.
        terraces: Whether small steps are to be made slopes.
        darkest: Least value of all channels.
        brightest: Greatest value of all channels.
        brightness: Of all pixels.
        lit: Brightness of some pixels, evenly spread.
        black: How many of these are not positive.
    """

    least: float
    most: float
    steepest: tuple[float, float]
    ramps: bool
    terraces: bool
    darkest: float
    brightest: float
    brightness: Ranks
    lit: Ranks
    black: int


def survey(pixels: Pixels, signed_radius: Pixels, dtype: torch.dtype, threads: int) -> Survey:
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

    def looked_at(
        rows: tuple[int, int],
    ) -> tuple[Tensor, bool, Levels, Tensor, Tensor, Tensor]:
        around = signed_radius[rows[0] : rows[1] + 2].detach().to(dtype)
        below = around[: rows[1] + 1 - rows[0]]
        r = around[: rows[1] - rows[0]]
        some = Box(rows[0], 0, rows[1] - rows[0], W).of(pixels).detach().to(dtype)
        steps = [
            step.abs().amax() if step.numel() else r.new_zeros(())
            for step in (below.diff(dim=0), r.diff(dim=1))
        ]
        brightness = some.amax(0)
        few = _few(brightness, rows[0])
        ends = torch.stack([*torch.aminmax(r), *steps, *torch.aminmax(some)])
        ramps = has_ramps(around, float(torch.maximum(*steps)))
        some_rows = slice(-rows[0] % _SOME, rows[1] - rows[0], _SOME)
        levels = levels_of(r[some_rows], around[1:][some_rows])
        return ends, ramps, levels, counted(brightness), counted(few), (few <= 0).sum()

    found = threaded(looked_at, bands(H, W), threads)
    of_first, ramps, first_levels, counts, lit, black = next(found)
    of_bands, levels = [of_first], [first_levels]
    for numbers_of_it, ramps_of_it, levels_of_it, *more in found:
        of_bands.append(numbers_of_it)
        levels.append(levels_of_it)
        ramps = ramps or ramps_of_it
        for summed, each in zip((counts, lit, black), more, strict=True):
            summed += each
    numbers = torch.stack(of_bands)
    least, most, down, across, darkest, brightest = numbers.unbind(1)
    ends = torch.stack([least.amin(), most.amax(), darkest.amin(), brightest.amax()])
    for name, pair in (("signed_radius", ends[:2]), ("image", ends[2:])):
        if not bool(torch.isfinite(pair).all()):
            raise ValueError(f"{name} must be finite, got NaN or infinity; repair it first")

    def brightness_again() -> Iterator[Tensor]:
        return (band.to(dtype).amax(0) for band in banded(pixels))

    def lit_again() -> Iterator[Tensor]:
        return map(_few, brightness_again(), (first for first, _ in bands(H, W)))

    return Survey(
        least=float(ends[0]),
        most=float(ends[1]),
        steepest=(float(down.amax()), float(across.amax())),
        ramps=ramps,
        terraces=are_few(levels),
        darkest=float(ends[2]),
        brightest=float(ends[3]),
        brightness=Ranks(counts, brightness_again, dtype),
        lit=Ranks(lit, lit_again, dtype),
        black=int(black),
    )


def _few(brightness: Tensor, first: int) -> Tensor:
    """Some pixels of a band that begins at a row: the same of the frame, however it is banded."""
    return brightness[-first % _SOME :: _SOME, ::_SOME]

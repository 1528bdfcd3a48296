"""What a first look over a picture tells: its ranges, and how steep and how bright it is."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.ramps import has_ramps
from defocus_core.ranks import Ranks, counted
from defocus_core.soft_edges import soft_edges
from defocus_core.source import Pixels, banded, bands
from defocus_core.terraces import Levels, are_few, levels_of
from defocus_core.threads import threaded
from defocus_core.tiling import Box

# Every how many rows and columns a pixel is looked at where some will do.
_SOME = 3


class _Band(NamedTuple):
    """What some rows of a picture tell.

    Attributes:
        ends: [6] least and greatest radius, greatest steps, least and greatest value.
        ramps: Whether there are any.
        soft_edges: Whether there are any.
        levels: Of depth.
    """

    ends: Tensor
    ramps: bool
    soft_edges: bool
    levels: Levels


class Survey(NamedTuple):
    """A picture in a few numbers. The brightness of a pixel is that of its brightest channel.

    Attributes:
        least: Signed radius in px.
        most: The same.
        steepest: Greatest differences of radius between neighbours in px: down, across.
        ramps: Whether ramps of depth are to be made steps.
        soft_edges: Whether some of them are soft edges, to be put where colours have theirs.
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
    soft_edges: bool
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

    def looked_at(rows: tuple[int, int]) -> tuple[_Band, list[Tensor]]:
        """What a band tells, and counts that add up."""
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
        soft = ramps and bool(_soft_edges(signed_radius, rows).any())
        some_rows = slice(-rows[0] % _SOME, rows[1] - rows[0], _SOME)
        levels = levels_of(r[some_rows], around[1:][some_rows])
        counts = [counted(brightness), counted(few), (few <= 0).sum()]
        return _Band(ends, ramps, soft, levels), counts

    told: list[_Band] = []
    total: list[Tensor] = []
    for band, counts in threaded(looked_at, bands(H, W), threads):
        told.append(band)
        total = [a + b for a, b in zip(total, counts, strict=True)] if total else counts
    brightness, lit, black = total
    numbers = torch.stack([band.ends for band in told])
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
        ramps=any(band.ramps for band in told),
        soft_edges=any(band.soft_edges for band in told),
        terraces=are_few([band.levels for band in told]),
        darkest=float(ends[2]),
        brightest=float(ends[3]),
        brightness=Ranks(brightness, brightness_again, dtype),
        lit=Ranks(lit, lit_again, dtype),
        black=int(black),
    )


def _few(brightness: Tensor, first: int) -> Tensor:
    """Some pixels of a band that begins at a row: the same of the frame, however it is banded."""
    return brightness[-first % _SOME :: _SOME, ::_SOME]


def _soft_edges(signed_radius: Pixels, rows: tuple[int, int]) -> Tensor:
    """Soft edges in some rows of a frame, as they are found in the whole of it."""
    first = max(rows[0] - 2, 0)
    found = soft_edges(signed_radius[first : rows[1] + 2].detach())
    return found[rows[0] - first : rows[1] - first]

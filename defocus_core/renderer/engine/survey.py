"""The survey of a picture: statistics of all its pixels, computed before rendering."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.engine.limits import (
    BRIGHTER,
    BRIGHTEST,
    GREATEST_PX,
    ORDINARY,
    RANGE,
    SQUARED,
)
from defocus_core.tensors.neighbourhoods import range_of, tally

# At most as many discs are drawn one by one, brightest first, as have the area of _FRAMES frames;
# but all that are _ALWAYS times as bright as ordinary pixels, as their rounding noise would be
# seen.
_FRAMES, _ALWAYS = 8.0, 100.0
_BITS = 16  # first bits of a number, by which numbers are counted


@dataclass(frozen=True)
class Ranks:
    """Numbers looked up by ascending rank, from 1; negative numbers count as 0.

    Floating-point numbers that are not negative have the same order as their bits.
    """

    values: Tensor  # [...], at least 0
    counts: Tensor  # [2^15] count of numbers by their first 16 bits, the sign being 0

    @classmethod
    def counted(cls, values: Tensor) -> Ranks:
        """Ranks of values [...] of float32 or float64, counted on their device."""
        positive = values.clamp(min=0).abs_()  # not even -0
        bits = positive.view(torch.int64 if positive.dtype.itemsize == 8 else torch.int32)
        first = bits.flatten() >> (positive.dtype.itemsize * 8 - _BITS)
        return cls(positive, tally(first, 1 << (_BITS - 1)))

    def bounds(self, rank: int) -> tuple[float, float]:
        """Two numbers between which the number of the given rank lies."""
        return self._limits(int(torch.searchsorted(self.counts.cumsum(0), rank)))

    def exactly(self, rank: int) -> float:
        """The number of the given rank."""
        first = int(torch.searchsorted(self.counts.cumsum(0), rank))
        low, high = self._limits(first)
        alike = self.values[(self.values >= low) & (self.values <= high)].sort().values
        return float(alike[rank - 1 - int(self.counts[:first].sum())])

    def _limits(self, first: int) -> tuple[float, float]:
        """The least and the greatest number whose first 16 bits are `first`."""
        size = self.values.dtype.itemsize
        bits = torch.tensor([first, first + 1], dtype=torch.int64 if size == 8 else torch.int32)
        bits = (bits << (size * 8 - _BITS)) - torch.tensor([0, 1], dtype=bits.dtype)
        low, high = bits.view(self.values.dtype).tolist()
        return low, high


class Survey(NamedTuple):
    """Statistics of a picture. The brightness of a pixel is that of its brightest channel."""

    minimum: float  # least signed radius in px
    maximum: float  # greatest signed radius in px
    # Greatest differences of radius between neighbours in px: down, across
    steepest: tuple[float, float]
    channels: tuple[tuple[float, float], ...]  # least and greatest value of each channel
    brightness: Ranks  # the brightness of all pixels

    @property
    def darkest(self) -> float:
        """The least value of all channels."""
        return min(least for least, _ in self.channels)

    @property
    def brightest(self) -> float:
        """The greatest value of all channels."""
        return max(greatest for _, greatest in self.channels)


def surveyed(pixels: Tensor, signed_radius: Tensor, dtype: torch.dtype) -> Survey:
    """The statistics of a picture.

    `pixels`: [C, H, W]; `signed_radius`: [H, W] px.
    """
    radii, brightness = signed_radius.detach().to(dtype), None
    ranges = [range_of(radii)]
    for dim in (0, 1):
        step = radii.diff(dim=dim)
        ranges.append(range_of(step) if step.numel() else radii.new_zeros(2))
    for channel in pixels.detach():  # one at a time: they may be of half precision
        values = channel.to(dtype)
        ranges.append(range_of(values))
        brightness = values if brightness is None else brightness.maximum(values)
    assert brightness is not None
    ranks = Ranks.counted(brightness)
    # one copy to the host; counts of pixels are exact in double precision
    together = torch.cat([torch.stack(ranges).flatten().double(), ranks.counts.double()]).cpu()
    numbers, counts = together.tensor_split([2 * len(ranges)])
    (minimum, maximum), *others = numbers.view(-1, 2).tolist()
    survey = Survey(
        minimum=minimum,
        maximum=maximum,
        steepest=(max(map(abs, others[0])), max(map(abs, others[1]))),
        channels=tuple((least, greatest) for least, greatest in others[2:]),
        brightness=Ranks(ranks.values, counts.long()),
    )
    _check(survey, dtype)
    return survey


def _check(survey: Survey, dtype: torch.dtype) -> None:
    """Raise ValueError if radii or light are not finite, or too large to be rendered."""
    darkest, brightest, radii = survey.darkest, survey.brightest, (survey.minimum, survey.maximum)
    every = [end for ends in survey.channels for end in ends]
    for name, numbers in (("signed_radius", radii), ("image", every)):
        if not all(map(math.isfinite, numbers)):
            raise ValueError(f"{name} must be finite, got NaN or infinity; repair it first")
    if max(-survey.minimum, survey.maximum) > GREATEST_PX:
        raise ValueError(
            f"signed_radius must be within {GREATEST_PX:g} px, got {radii[0]:.3g} to "
            f"{radii[1]:.3g} px; check the units of depth and lens, and write inf for sky"
        )
    if max(-darkest, brightest) > float(torch.tensor(BRIGHTEST, dtype=dtype)):
        raise ValueError(
            f"image must be within ±{BRIGHTEST:g}, got {darkest:.3g} to {brightest:.3g}; "
            "scale it, light has no unit here"
        )


def border_range(signed_radius: Tensor) -> tuple[float, float]:
    """The least and the greatest of signed radii [H, W] on the edge of the frame."""
    r = signed_radius.detach()
    lines = torch.cat([line.flatten() for line in (r[:1], r[-1:], r[:, :1], r[:, -1:])])
    minimum, maximum = range_of(lines).tolist()
    return minimum, maximum


def highlight_limit(survey: Survey) -> float:
    """The brightness above which a pixel is a highlight."""
    brightness, radius = survey.brightness, max(-survey.minimum, survey.maximum, 1.0)
    # negative light is never a highlight, nor twice as much of it a bound
    maximum, pixels = max(survey.brightest, 0.0), brightness.values.numel()
    rank = max(1, int(ORDINARY * pixels))
    if brightness.bounds(rank)[0] >= maximum / BRIGHTER:
        return maximum
    ordinary = brightness.exactly(rank)
    if ordinary >= maximum / BRIGHTER:
        return maximum
    drawn = max(1, int(_FRAMES * pixels / (math.pi * radius**2)))
    beyond = brightness.bounds(max(1, pixels - drawn))[1]
    return max(BRIGHTER * ordinary, min(beyond, _ALWAYS * ordinary, maximum))


def needs_double(survey: Survey, limit: float) -> bool:
    """Whether float32 is not precise enough for a picture.

    Transforms in float32 round to 1e-7 of the brightest value, which shows in dark areas; squares
    of very bright colours overflow, and squares of very dark ones underflow. Pixels brighter than
    `limit` do not count: they are highlights, which are not transformed.
    """
    brightness, bright = survey.brightness, min(survey.brightest, limit)
    size = max(bright, -survey.darkest)
    if size > SQUARED or 0 < size < 1 / SQUARED:
        return True
    black = int(brightness.counts[0])  # and denormal numbers, which are as dark
    lit = brightness.values.numel() - black
    if not lit:
        return False
    median = black + (lit + 1) // 2
    low, high = brightness.bounds(median)
    if bright <= RANGE * low or bright > RANGE * high:
        return bright > RANGE * high
    return bright > RANGE * brightness.exactly(median)

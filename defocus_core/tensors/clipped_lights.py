"""Clipped lights: blobs that a picture of 8 bits holds as white, with the light they lost.

White of 8 bits is the end of the scale, not a measure: a lamp a hundred times as bright as a wall
is stored as hardly more, and its blur would be a grey disc. Blobs near the end of the scale are
made brighter by a gain, all channels alike, so that their hue stays. What tells a lamp from a
surface just beyond white: a lamp is small; its light is beyond white in all channels, so that it
has no colour left, or it is very small; and its surroundings are darker. What is in focus makes no
disc: it is left as it is.

A blob depends on the level from which on pixels count. Each level of brightness adds its own share
of the gain, by the blobs of that level, so that the light is continuous in the threshold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.tensors.derived import Mapped
from defocus_core.tensors.source import Pixels, Scalar, banded, bands
from defocus_core.tensors.sparse_masks import positions_of
from defocus_core.tensors.validation import number, whole

# Sides of blobs, the roots of their areas: up to which a blob is a light, and from which on a
# surface, as shares of the side of a square of the area of the frame. Of blobs of a colour, and of
# white ones; and the same in px that count in small frames.
_COLORED, _WHITE, _MIN_PX = (0.004, 0.012), (0.025, 0.075), (3.0, 8.0)
# The least channel, as a share of white, up to which a blob has a colour, and from which on none.
_HUE = (0.6, 0.9)
# Brightness of the surroundings, as a share of the blob's, up to which a blob is a light, and from
# which on a part of a surface; of blobs of a colour, and of white ones. The surroundings reach this
# share of the width to each side, so many px at least.
_COLORED_BESIDE, _WHITE_BESIDE = (0.3, 0.6), (0.6, 0.9)
_AROUND, _MIN_AROUND = 0.012, 4
# Radius in px up to which a blob is in focus, and from which on it gets all of its light.
_BLURRED = (1.0, 3.0)
# Levels of brightness at which blobs are found, the closer the brighter.
_LEVELS = (0.0, 0.3, 0.5, 0.65, 0.75, 0.82, 0.88, 0.91, 0.94, 0.97, 1.0)
# Coarse pixels across the surroundings to a side.
_COARSE = 6
# Light above 1 by more than rounding was measured, and is left as it is.
_MEASURED = 1.001
# A blob is a light if it gets more than this share of the gain.
_COUNTED = 0.05


def with_lights(
    image: Pixels,
    threshold: Scalar,
    gain: Scalar,
    *,
    colors: int | None = None,
    signed_radius: Pixels | None = None,
) -> Pixels:
    """A picture whose clipped lights have the light they may have had.

    Args:
        image: [C, H, W], linear light of 0 to 1; brighter pictures are returned as they are.
        threshold: The brightness, of the brightest channel, at which the gain begins, below 1.
        gain: The factor at the end of the scale, 1 or more.
        colors: How many channels are colours, the first ones; None for all.
        signed_radius: [H, W] px; blobs that are in focus are left alone. None if all are blurred.

    Returns:
        [C, H, W], a tensor if the image is one. Gradients flow to a tensor, threshold and gain.

    Raises:
        ValueError: If an argument is not one of the above.
    """
    return ClippedLights(image, threshold, gain, colors=colors, signed_radius=signed_radius).added


class ClippedLights:
    """The clipped lights of a picture.

    Attributes:
        added: [C, H, W], the picture with their light.
        count: The number of blobs that got light.
        measured: Whether there is light above 1: then the picture stays.
    """

    def __init__(
        self,
        image: Pixels,
        threshold: Scalar,
        gain: Scalar,
        *,
        colors: int | None = None,
        signed_radius: Pixels | None = None,
    ) -> None:
        """Find the blobs; arguments are those of `with_lights`."""
        if not 0 <= (minimum := number("threshold", threshold, "in linear light")) < 1:
            raise ValueError(
                f"threshold must be 0 or more and below 1, got {threshold}; 0.93 suits most"
            )
        if number("gain", gain, "it is a factor") < 1:
            raise ValueError(f"gain must be 1 or more, got {gain}; 1 changes nothing")
        count = image.shape[0] if colors is None else whole("colors", colors, "channels of colour")
        self.measured = any(float(band[:count].amax()) > _MEASURED for band in banded(image))
        self.added, self.count = image, 0
        if self.measured:
            return
        levels, self.count = _found(image, signed_radius, minimum, count)
        lit = _lit(image, threshold, gain, count, levels)
        self.added = lit.at_once(1) if isinstance(image, Tensor) else lit


class _BlobLevel(NamedTuple):
    """The blobs of pixels brighter than a level."""

    low: float
    high: float
    runs: Runs  # the runs of these pixels
    fraction: Tensor  # [n] the share of the gain that each run gets


def _found(
    image: Pixels, signed_radius: Pixels | None, threshold: float, colors: int
) -> tuple[list[_BlobLevel], int]:
    """The blobs of each level from the threshold on, and the number of lights."""
    size = image.shape[-2], image.shape[-1]
    pairs = [pair for pair in pairwise(_LEVELS) if pair[1] > threshold]
    around = max(_MIN_AROUND, round(_AROUND * size[1]))
    runs_of_level: list[list[tuple[Runs, Tensor]]] = [[] for _ in pairs]
    for first, end in bands(image):
        top = max(first - around, 0)
        light = image[..., top : min(end + around, size[0]), :].detach()[:colors]
        bright, minimum = light.amax(0), light[:, first - top : end - top].amin(0)
        blur = torch.full_like(minimum, _BLURRED[1])
        if signed_radius is not None:
            blur = signed_radius[first:end].detach().abs().to(minimum)
        for level, (low, _) in zip(runs_of_level, pairs, strict=True):
            level.append(_band(bright, (minimum, blur), (first, end), top, low, around))
    levels = []
    for level, (low, high) in zip(runs_of_level, pairs, strict=True):
        runs, values = zip(*level, strict=True)
        joined = Runs.joined([*runs])
        fractions = _fractions(joined, torch.cat(values, 1), max(low, _LEVELS[1]), size)
        levels.append(_BlobLevel(low, high, joined, fractions))
    return levels, _count(levels, threshold, size[1])


def _band(
    bright: Tensor,  # [h, W] the brightest channel of the band, and of rows around it
    summed: tuple[Tensor, Tensor],
    rows: tuple[int, int],
    top: int,
    level: float,
    around: int,
) -> tuple[Runs, Tensor]:
    """The runs of a band that are brighter than a level, and sums over each of them.

    `summed`: [h, W] the least channel of the band, and the radius of its blur in px. Returns the
    runs; of each [3, n] the sums, and its surroundings times its area.
    """
    runs = Runs.of(bright[rows[0] - top : rows[1] - top] > level, rows[0])
    if not len(runs.row):
        return runs, bright.new_zeros(3, 0).double()
    sums = pad(torch.stack(summed).flatten(1).cumsum(1, dtype=torch.float64), (1, 0))
    start = (runs.row - rows[0]) * bright.shape[1]
    minimum, blur = sums[:, start + runs.end] - sums[:, start + runs.first]
    coarse_pixel = max(1, around // _COARSE)
    beside = _beside(bright, level, coarse_pixel, around // coarse_pixel)
    row = (runs.row - top) // coarse_pixel
    limits = (beside[row, column // coarse_pixel] for column in (runs.first, runs.end - 1))
    return runs, torch.stack([minimum, blur, sum(limits) / 2 * runs.area])


def _beside(bright: Tensor, level: float, coarse_pixel: int, around: int) -> Tensor:
    """Mean brightness of what is not above a level around each coarse px; the level without any."""
    dark = (bright <= level).to(bright)
    down, across = (-n % coarse_pixel for n in bright.shape)
    coarse = pad(torch.stack([dark, dark * bright]), (0, across, 0, down))
    rows, columns = (n // coarse_pixel for n in coarse.shape[1:])
    coarse = coarse.view(2, rows, coarse_pixel, columns, coarse_pixel).sum(4).sum(2)
    both = coarse.double() / coarse_pixel**2
    for dim in (-2, -1):
        length = both.shape[dim]
        sums = torch.cat([torch.zeros_like(both.narrow(dim, 0, 1)), both.cumsum(dim)], dim)
        at = torch.arange(length, device=bright.device)
        after = sums.index_select(dim, (at + around + 1).clamp(max=length))
        both = after - sums.index_select(dim, (at - around).clamp(min=0))
    fraction, light = both
    return torch.where(fraction > 0.5, light / fraction.clamp(min=0.5), level)


def _fractions(runs: Runs, sums: Tensor, level: float, size: tuple[int, int]) -> Tensor:
    """The share of the gain that each run gets, by its blob.

    `sums`: [3, n] of its least channel, of its blur, and of its surroundings; `size`: (height,
    width) of the frame.
    """
    blob = runs.blobs(size[1])
    values = torch.cat([runs.area.double()[None], sums])
    totals = values.new_zeros(4, int(blob.max()) + 1 if len(blob) else 0)
    area, minimum, blur, beside = totals.index_add(1, blob, values)
    white = _step(minimum / area, *_HUE)
    across = math.sqrt(size[0] * size[1])
    colored, bleached = (
        [max(fraction * across, px) for fraction, px in zip(fractions, _MIN_PX, strict=True)]
        for fractions in (_COLORED, _WHITE)
    )
    small = 1 - _step(area.sqrt(), *_between(colored, bleached, white))
    apart = 1 - _step(beside / (area * level), *_between(_COLORED_BESIDE, _WHITE_BESIDE, white))
    return (small * apart * _step(blur / area, *_BLURRED))[blob]


def _between(colored: Sequence[float], white: Sequence[float], fraction: Tensor) -> list[Tensor]:
    """Bounds of blobs from those of a colour, at a share of 0, to those of white ones, at 1."""
    return [a + (b - a) * fraction for a, b in zip(colored, white, strict=True)]


def _count(levels: list[_BlobLevel], threshold: float, width: int) -> int:
    """The number of blobs, of the least level above the threshold, that hold a light."""
    above = [level for level in levels if level.low >= threshold] or levels[-1:]
    base = above[0].runs
    lights = [level.runs for level in above]
    positions = [
        (runs.row[level.fraction > _COUNTED], runs.first[level.fraction > _COUNTED])
        for level, runs in zip(above, lights, strict=True)
    ]
    at = [torch.cat(part) for part in zip(*positions, strict=True)]
    blobs: Tensor = torch.unique(base.blobs(width)[base.holding(at[0], at[1], width)])
    return len(blobs)


def _step(values: Tensor, low: Tensor | float, high: Tensor | float) -> Tensor:
    """A smooth step from 0 at `low` to 1 at `high`."""
    x = ((values - low) / (high - low)).clamp(0, 1)
    return x * x * (3 - 2 * x)


def _lit(
    image: Pixels, threshold: Scalar, gain: Scalar, colors: int, levels: list[_BlobLevel]
) -> Mapped:
    """The picture with the light of its blobs, window by window."""

    def read(rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
        window = image[..., slice(*rows), slice(*columns)]
        light, rest = window.tensor_split([colors])
        bright = light.amax(0)
        at = positions_of(bright.detach() > levels[0].low)
        if not len(at):
            return window
        row, column = at.unbind(1)
        shining = bright[row, column]
        fraction = torch.zeros_like(shining)
        for low, high, runs, fractions in levels:
            above = (shining.detach() > low).nonzero()[:, 0]
            run = runs.holding(row[above] + rows[0], column[above] + columns[0], image.shape[-1])
            lower, upper = (
                _step(shining[above].clamp(max=bound), threshold, 1) for bound in (low, high)
            )
            upper = upper if high < 1 else _step(shining[above], threshold, 1)
            fraction = fraction.index_add(0, above, (upper - lower) * fractions[run].to(fraction))
        factor = torch.ones_like(bright).index_put((row, column), 1 + (gain - 1) * fraction)
        return torch.cat([light * factor, rest]).to(image.dtype)

    return Mapped(read, image.shape, image)


class Runs(NamedTuple):
    """The runs of a mask, in order of their first pixels."""

    row: Tensor  # [n] row of each run
    first: Tensor  # [n] column of its first pixel
    end: Tensor  # [n] column after its last pixel

    @classmethod
    def of(cls, mask: Tensor, top: int) -> Runs:
        """The runs of rows [h, W] of a mask, of which the first is row `top`."""
        steps = torch.nn.functional.pad(mask.to(torch.int8), (1, 1)).diff(dim=1)
        row, first = torch.nonzero(steps > 0).unbind(1)
        return cls(row + top, first, torch.nonzero(steps < 0)[:, 1])

    @classmethod
    def joined(cls, bands: list[Runs]) -> Runs:
        """The runs of bands from the top on."""
        return cls(*(torch.cat(part) for part in zip(*bands, strict=True)))

    @property
    def area(self) -> Tensor:
        """The number of pixels of each run."""
        return self.end - self.first

    def holding(self, row: Tensor, column: Tensor, width: int) -> Tensor:
        """The number of the run that holds each pixel of the mask, in a frame of some width."""
        firsts = self.row * width + self.first
        return torch.searchsorted(firsts, row * width + column, right=True) - 1

    def blobs(self, width: int) -> Tensor:
        """For each run the number of its blob, from 0 on, in a frame of some width."""
        one, other = self._touching(width)
        label = torch.arange(len(self.row), device=self.row.device)
        while True:
            first, second = label[one], label[other]
            apart = first != second
            if not bool(apart.any()):
                number: Tensor = torch.unique(label, return_inverse=True)[1]
                return number
            one, other, first, second = (x[apart] for x in (one, other, first, second))
            minimum = torch.minimum(first, second)
            # of two trees of runs the root of one is below that of the other from now on
            label = label.scatter_reduce(0, torch.maximum(first, second), minimum, "amin")
            while not torch.equal(root := label[label], label):
                label = root

    def _touching(self, width: int) -> tuple[Tensor, Tensor]:
        """Pairs of runs of neighbouring rows that share a side or a corner."""
        stride = width + 2
        firsts, limits = self.row * stride + self.first, self.row * stride + self.end
        low = torch.searchsorted(limits, firsts + stride)
        high = torch.searchsorted(firsts, limits + stride, right=True)
        count = (high - low).clamp(min=0)
        one = torch.arange(len(low), device=low.device).repeat_interleave(count)
        before = (count.cumsum(0) - count).repeat_interleave(count)
        rank = torch.arange(len(one), device=low.device) - before
        return one, low.repeat_interleave(count) + rank

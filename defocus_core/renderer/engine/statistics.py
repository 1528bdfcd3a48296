"""Statistics of a picture: the range and steepness of its radii, and its brightness."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.inpainting.known_layer import KnownLayer
from defocus_core.tensors.box import Box
from defocus_core.tensors.neighbourhoods import range_of, ranges_of
from defocus_core.tensors.order_statistics import Ranks, counted
from defocus_core.tensors.source import Pixels, banded, bands
from defocus_core.tensors.threads import threaded

# Greatest radius in px: any picture is a point beside it.
_MAX_PX = 1e8
# Greatest light of either sign: beyond it, sums over an aperture or a frame would overflow float32.
BRIGHTEST = 1e30
# Brightness as a multiple of the median, and by itself (or one divided by it), beyond which
# float32 is too coarse.
_RANGE, _SQUARED = 1e3, 1e15


class Survey(NamedTuple):
    """Statistics of a picture. The brightness of a pixel is that of its brightest channel."""

    minimum: float  # least signed radius in px
    maximum: float  # greatest signed radius in px
    # Greatest differences of radius between neighbours in px: down, across
    steepest: tuple[float, float]
    channels: tuple[tuple[float, float], ...]  # least and greatest value of each channel
    brightness: Ranks  # order statistics of the brightness of all pixels

    @property
    def darkest(self) -> float:
        """Least value of all channels."""
        return min(least for least, _ in self.channels)

    @property
    def brightest(self) -> float:
        """Greatest value of all channels."""
        return max(greatest for _, greatest in self.channels)


def surveyed(pixels: Pixels, signed_radius: Pixels, dtype: torch.dtype, threads: int) -> Survey:
    """The statistics of a picture, of which each pixel is read once.

    `pixels`: [C, H, W]; `signed_radius`: [H, W] px.
    """
    (survey,) = _surveyed(pixels, signed_radius, dtype, threads)
    return survey


def surveyed_each(pixels: Tensor, signed_radius: Tensor, dtype: torch.dtype) -> list[Survey]:
    """What `surveyed` says of each picture of a batch, [C, B, H, W] and [B, H, W]."""
    return _surveyed(pixels, signed_radius, dtype, 1)


def _surveyed(
    pixels: Pixels, signed_radius: Pixels, dtype: torch.dtype, threads: int
) -> list[Survey]:
    W, batch = signed_radius.shape[-1], len(signed_radius.shape) > 2

    def band_statistics(rows: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
        """Statistics of radii, least and greatest values of channels, counts of brightness."""
        band = Box(rows[0], 0, rows[1] - rows[0], W).of(pixels).detach().to(dtype)
        brightness = band.amax(0)
        radii = signed_radius[..., rows[0] : rows[1] + 1, :].detach().to(dtype)
        limits = torch.cat([band.amin((-2, -1)), band.amax((-2, -1))])
        limits = limits.movedim(0, -1)
        return _radius_statistics(radii, rows), limits, counted(brightness, each=batch)

    radius_range, color_range, counts = [], [], torch.zeros((), dtype=torch.long)
    for of_radii, pair, band_counts in threaded(band_statistics, bands(pixels), threads):
        radius_range.append(of_radii)
        color_range.append(pair)
        counts = band_counts + counts
    every = torch.cat([torch.stack(radius_range), torch.stack(color_range)], -1)
    every = every if batch else every[:, None]  # [bands, B, 4 + 2 C]
    least_of = [0, *range(4, 4 + pixels.shape[0])]
    greatest_of = [1, 2, 3, *range(4 + pixels.shape[0], every.shape[-1])]
    least, greatest = every[..., least_of].amin(0), every[..., greatest_of].amax(0)
    extremes = torch.cat([least, greatest], 1).tolist()
    of_each = counts.cpu() if batch else counts.cpu()[None]
    pictures = [pixels[:, number] for number in range(len(extremes))] if batch else [pixels]
    return [
        _checked(numbers, own, picture, dtype)
        for numbers, own, picture in zip(extremes, of_each, pictures, strict=True)
    ]


def _checked(numbers: list[float], counts: Tensor, pixels: Pixels, dtype: torch.dtype) -> Survey:
    """The survey of a picture.

    `pixels`: [C, H, W].
    """
    count = pixels.shape[0]
    minimum, maximum, down, across = numbers[0], *numbers[count + 1 : count + 4]
    least, greatest = numbers[1 : count + 1], numbers[count + 4 :]
    for name, every in (("signed_radius", [minimum, maximum]), ("image", least + greatest)):
        if not all(map(math.isfinite, every)):
            raise ValueError(f"{name} must be finite, got NaN or infinity; repair it first")
    darkest, brightest = min(least), max(greatest)
    if max(-minimum, maximum) > _MAX_PX:
        raise ValueError(
            f"signed_radius must be within {_MAX_PX:g} px, got {minimum:.3g} to {maximum:.3g} px; "
            "check the units of depth and lens, and write inf for sky"
        )
    if max(-darkest, brightest) > float(torch.tensor(BRIGHTEST, dtype=dtype)):
        raise ValueError(
            f"image must be within ±{BRIGHTEST:g}, got {darkest:.3g} to {brightest:.3g}; "
            "scale it, light has no unit here"
        )

    def brightness_again() -> Iterator[Tensor]:
        return (band.to(dtype).amax(0) for band in banded(pixels))

    return Survey(
        minimum=minimum,
        maximum=maximum,
        steepest=(down, across),
        channels=tuple(zip(least, greatest, strict=True)),
        brightness=Ranks(counts, brightness_again, dtype),
    )


def border_range(signed_radius: Pixels) -> tuple[float, float]:
    """The least and the greatest signed radius [..., H, W] on the edge of the frame."""
    H, W = signed_radius.shape[-2:]
    lines = [signed_radius[..., :1, :], signed_radius[..., H - 1 :, :]]
    for first, last in bands(signed_radius):
        lines += [signed_radius[..., first:last, at] for at in (slice(1), slice(W - 1, W))]
    minimum, maximum = range_of(torch.cat([line.detach().flatten() for line in lines])).tolist()
    return minimum, maximum


def with_hidden(hidden: KnownLayer, limits: tuple[float, float]) -> tuple[float, float]:
    """Least and greatest signed radius in px of visible surfaces and of a known hidden layer."""
    minimum, maximum = limits
    for color, radius, mask in zip(*map(banded, hidden), strict=True):
        where = mask.bool()
        known = radius[where]
        for name, values in (("color", color[:, where]), ("signed_radius", known)):
            if not bool((values.abs() <= BRIGHTEST).all()):
                raise ValueError(
                    f"hidden.{name} must be finite and within ±{BRIGHTEST:g} where the mask is "
                    "true; leave unknown pixels out"
                )
        if len(known):
            nearest, farthest = range_of(known).tolist()
            minimum, maximum = min(minimum, nearest), max(maximum, farthest)
    return minimum, maximum


def channels_with(
    hidden: KnownLayer, channels: tuple[tuple[float, float], ...]
) -> tuple[tuple[float, float], ...]:
    """Least and greatest value of each channel of visible pixels and of a known hidden layer."""
    ends = [torch.tensor(channels, dtype=torch.float64)]
    for color, _, mask in zip(*map(banded, hidden), strict=True):
        known = color[:, mask.bool()].double()
        if known.numel():
            ends.append(torch.stack([known.amin(1), known.amax(1)], 1).cpu())
    every = torch.stack(ends)
    least, greatest = every[..., 0].amin(0).tolist(), every[..., 1].amax(0).tolist()
    return tuple(zip(least, greatest, strict=True))


def needs_double(survey: Survey, limit: float) -> bool:
    """Whether float32 is too coarse.

    Its transforms round to 1e-7 of the brightest, which shows in the dark; and squares of very
    bright colours are infinite, of very dark ones 0. Pixels brighter than the limit do not
    count: they are highlights, which are not transformed.
    """
    bright = min(survey.brightest, limit)
    size = max(bright, -survey.darkest)
    if size > _SQUARED or 0 < size < 1 / _SQUARED:
        return True
    black = int(survey.brightness.counts[0])  # and denormal numbers, which are as dark
    lit = survey.brightness.total - black
    if not lit:
        return False
    median = black + (lit + 1) // 2
    low, high = survey.brightness.about(median)
    if bright <= _RANGE * low or bright > _RANGE * high:
        return bright > _RANGE * high
    return bright > _RANGE * survey.brightness.exactly(median)


def _radius_statistics(band: Tensor, rows: tuple[int, int]) -> Tensor:
    """Least and greatest radius of a band, and greatest step down and across: [..., 4].

    `band`: [..., h, W] px, the rows of the band and the one below them.
    """
    radii = band[..., : rows[1] - rows[0], :]
    steps = band.diff(dim=-2), radii.diff(dim=-1)
    steepest = [
        ranges_of(step).abs().amax(-1, keepdim=True)
        if step.numel()
        else radii.new_zeros((*radii.shape[:-2], 1))
        for step in steps
    ]
    return torch.cat([ranges_of(radii), *steepest], -1)

"""Clipped lights: white blobs of an 8-bit picture, and the light that they lost.

White in 8 bits is the end of the scale, not a measure: a lamp a hundred times as bright as a wall
is stored as hardly more, and its blur would be a grey disc. Blobs near the end of the scale are
made brighter by a gain. A lamp differs from a surface just beyond white: it is small, its
surroundings are darker, and it is very small or clipped in all channels, so that it has no colour.
Blobs in focus make no disc and stay as they are.

The lost hue of a blob is that of its rim, where the light of the lamp is not yet clipped; a blob
without a rim keeps its own. The larger the rim relative to the blob, the less light was clipped,
and the lower is the gain. The gain has a shoulder: the disc of a blurred blob stays below white,
where it would lose its hue again.

A blob depends on the level above which pixels belong to it. Each level of brightness adds its share
of the gain to the blobs of that level, so that the light is continuous in the threshold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, pad

from defocus_core.allowed_values import AUTO_LIGHTS
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import bands, in_bands
from defocus_core.tensors.neighbourhoods import positions_of
from defocus_core.tensors.validation import Scalar, number, whole

# Sides of blobs (roots of their areas) up to which a blob is a light, and from which on a surface,
# relative to the root of the area of the frame, for coloured and for white blobs; then the same in
# px, as minima in small frames.
_COLORED, _WHITE, _MIN_PX = (0.004, 0.012), (0.025, 0.075), (3.0, 8.0)
# The least channel, as a share of white, up to which a pixel is coloured, and from which on white;
# and the share of white pixels up to which a blob is coloured, and from which on white.
_HUE, _BLEACHED = (0.6, 0.9), (0.05, 0.25)
# Brightness of the surroundings, as a share of the blob's, up to which a blob is a light, and from
# which on a part of a surface, for coloured and for white blobs. Reach of the surroundings to each
# side as a share of the longer side, and in px at least.
_COLORED_BESIDE, _WHITE_BESIDE = (0.3, 0.6), (0.45, 0.75)
_AROUND, _MIN_AROUND = 0.012, 4
# Radius up to which a blob is as good as sharp, as a share of the largest, with its bounds in px;
# and its multiple from which on a blob gets all of its light.
_SHARP, _SHARP_PX, _BLURRED = 0.2, (1.0, 3.0), 3
# Levels of brightness at which blobs are found, more closely spaced near white.
_LEVELS = (0.0, 0.3, 0.5, 0.65, 0.75, 0.82, 0.88, 0.91, 0.94, 0.97, 1.0)
# Coarse pixels across the surroundings to a side.
_COARSE = 6
# Light that exceeds 1 by more than rounding was measured, and stays as it is.
_MEASURED = 1.001
# A blob is a light if it gets more than this share of the gain.
_COUNTED = 0.05
# Reach of the rim from a blob as a share of the longer side, and in px at least. Light of the rim,
# as a share of white above the surroundings, up to which its hue has no weight, and from which on
# full weight; the same for the difference of its brightest and its least channel.
_RIM, _MIN_RIM, _SAYS_HUE, _SATURATED = 0.003, 2, (0.2, 0.4), (0.15, 0.3)
_TINY = 1e-6
_WIDEST = 1e6  # px, where no blur is given
# Brightness of a disc, as a share of white, above which its gain is reduced; its upper limit.
_KNEE, _BRIGHTEST = 0.6, 0.9


def with_lights(
    image: Tensor,
    threshold: Scalar = AUTO_LIGHTS[0],
    gain: Scalar = AUTO_LIGHTS[1],
    *,
    colors: int | None = None,
    signed_radius: Tensor | None = None,
) -> Tensor:
    """A picture whose clipped lights have their estimated light.

    Args:
        image: [C, H, W], linear light of 0 to 1; brighter pictures are returned as they are.
        threshold: The brightness, of the brightest channel, at which the gain begins, below 1.
        gain: The factor at the end of the scale for a blob that is clipped up to its rim, 1 or
            more.
        colors: How many channels are colours, the first ones; None for all.
        signed_radius: [H, W] px; blobs that are in focus are left alone, and discs of others stay
            below white. None means that all are blurred widely.

    Returns:
        [C, H, W]. Gradients flow to threshold and gain, if tensors, and to image, with the blobs as
        found.

    Raises:
        ValueError: If an argument is not one of the above, or the radius needs a gradient, for
            which the size of a disc has none.
    """
    return ClippedLights(image, threshold, gain, colors=colors, signed_radius=signed_radius).added


class ClippedLights:
    """The clipped lights of a picture.

    Attributes:
        added: [C, H, W], the picture with their light.
        count: The number of blobs that got light.
        measured: Whether there is light above 1, in which case the picture stays.
    """

    def __init__(
        self,
        image: Tensor,
        threshold: Scalar,
        gain: Scalar,
        *,
        colors: int | None = None,
        signed_radius: Tensor | None = None,
    ) -> None:
        """Find the blobs; arguments are those of `with_lights`."""
        if not 0 <= (minimum := number("threshold", threshold, "in linear light")) < 1:
            raise ValueError(
                f"threshold must be 0 or more and below 1, got {threshold}; 0.93 suits most"
            )
        if number("gain", gain, "it is a factor") < 1:
            raise ValueError(f"gain must be 1 or more, got {gain}; 1 changes nothing")
        if signed_radius is not None and signed_radius.requires_grad:
            problem = "signed_radius must need no gradient, which clipped lights do not carry to it"
            raise ValueError(f"{problem}; give signed_radius.detach()")
        count = image.shape[0] if colors is None else whole("colors", colors, "channels of colour")
        self.measured = float(image[:count].detach().amax()) > _MEASURED
        self.added, self.count = image, 0
        if self.measured:
            return
        levels, self.count = _found(image, signed_radius, minimum, count)
        self.added = _lit(image, threshold, gain, count, levels)


class _BlobLevel(NamedTuple):
    """The blobs of pixels brighter than a level."""

    low: float
    high: float
    runs: Runs  # the runs of these pixels, in rows
    lamps: _Lamps  # the number of the blob of each run


class _Lamps(NamedTuple):
    """Estimates of the lamps behind blobs."""

    fraction: Tensor  # [n] how far it is one, 0 to 1
    clipped: Tensor  # [n] share of it that is clipped
    disc: Tensor  # [n] area of the blob as a share of that of its blur disc
    hue: Tensor  # [C, n] colour of the rim, whose brightest channel is 1
    says_hue: Tensor  # [n] how far there is a rim, 0 to 1

    def select(self, which: Tensor) -> _Lamps:
        """The lamps of some indices."""
        return _Lamps(*(values[..., which] for values in self))

    def gain(self, gain: Scalar) -> Tensor:
        """The gain [n] of each lamp, given that of a wholly clipped one."""
        own = 1 + (gain - 1) * self.clipped * (1.5 - 0.5 * self.clipped)
        over = ((own * self.disc - _KNEE) / (_BRIGHTEST - _KNEE)).clamp(min=0)
        shown = _KNEE + (_BRIGHTEST - _KNEE) * over.tanh()
        return torch.where(over > 0, shown / self.disc.clamp(min=_TINY), own).clamp(min=1)


def _found(
    image: Tensor, signed_radius: Tensor | None, threshold: float, colors: int
) -> tuple[list[_BlobLevel], int]:
    """The blobs of each level from the threshold on, and the number of lights."""
    size = image.shape[-2], image.shape[-1]
    pairs = [pair for pair in pairwise(_LEVELS) if pair[1] > threshold]
    around = max(_MIN_AROUND, round(_AROUND * max(size)))
    reach = max(_MIN_RIM, round(_RIM * max(size)))
    blur = image.new_full(size, _WIDEST) if signed_radius is None else signed_radius.detach().abs()
    sharp = float((_SHARP * blur.amax()).clamp(*_SHARP_PX))
    levels = []
    for low, high in pairs:
        of_bands = [
            _band(image[:colors].detach(), blur, rows, low, around, reach) for rows in bands(image)
        ]
        runs = Runs.concatenate([each for each, _ in of_bands])
        sums = torch.cat([each for _, each in of_bands], 1)
        lamps = _lamps(runs, sums, max(low, _LEVELS[1]), size, sharp)
        levels.append(_BlobLevel(low, high, runs, lamps))
    return levels, _count(levels, threshold, size[1])


def _band(
    image: Tensor,  # [C, H, W] the colours
    blur: Tensor,  # [H, W] px
    rows: tuple[int, int],
    level: float,
    around: int,
    reach: int,
) -> tuple[Runs, Tensor]:
    """The runs of a band that are brighter than a level, and sums over each run.

    Returns the runs and sums [6 + 2 C, n]: white pixels and blur of the run; brightness and light
    of its surroundings; the number of pixels of its rim, their brightness, weight, squared weight,
    and weighted light.
    """
    top, coarse_pixel = max(rows[0] - around, 0), max(1, around // _COARSE)
    light = _wide(image[:, top : rows[1] + around])
    mask, above = light.amax(0) > level, rows[0] - top
    own = mask[above : rows[1] - top]
    runs = Runs.from_mask(own, above)
    total = light.new_zeros(3 + len(light), len(runs.row)).double()
    if not len(runs.row):
        return runs, torch.cat([total, total])
    row, column = positions_of(own).unbind(1)
    blurred, row = blur[row + rows[0], column].to(light), row + above
    white = _step(light[:, row, column].amin(0), *_HUE)
    which = runs.holding(row, column, light.shape[-1])
    beside = _surrounding_mean(light, mask, level, around // coarse_pixel, coarse_pixel)
    beside = beside[:, row // coarse_pixel, column // coarse_pixel]
    total.index_add_(1, which, torch.cat([white[None], blurred[None], beside]).double())
    rim = _rim(light, mask, runs, (row, column, which), reach)
    return runs._replace(row=runs.row + top), torch.cat([total, rim])


def _rim(
    light: Tensor, mask: Tensor, runs: Runs, pixels: tuple[Tensor, Tensor, Tensor], reach: int
) -> Tensor:
    """Sums of number, brightness, weight and weighted light of the pixels beside each run.

    They are the mean of those to its sides and of those above and below, so that a turned picture
    has the same. `light`: [C, h, W]; `mask`: [h, W], what is bright of it; `pixels`: row, column
    and run of those of the runs; `reach`: px to each side. Returns [3 + C, n].
    """
    (height, width), bright = mask.shape, light.amax(0)
    every = torch.arange(len(runs.row), device=light.device)
    ends = [(runs.row, runs.first, 0, -1, every), (runs.row, runs.end - 1, 0, 1, every)]
    row, column, which = pixels
    for down in (-1, 1):
        last = ~mask[(row + down).clamp(0, height - 1), column]
        ends.append((row[last], column[last], down, 0, which[last]))
    total = light.new_zeros(3 + len(light), len(runs.row)).double()
    for row, column, down, across, of in ends:
        for away in range(1, reach + 1):
            y, x = row + down * away, column + across * away
            at = y.clamp(0, height - 1), x.clamp(0, width - 1)
            dark = ((y == at[0]) & (x == at[1]) & ~mask[at]).to(light)
            weight = dark * bright[at] ** 2
            sums = [torch.stack([dark, dark * bright[at], weight]), weight * light[:, *at]]
            total.index_add_(1, of, torch.cat(sums).double())
    return total / 2


def _surrounding_mean(
    light: Tensor, mask: Tensor, level: float, around: int, coarse_pixel: int
) -> Tensor:
    """Mean brightness and light [1 + C] of the dark pixels around each coarse pixel.

    It is the level where few are dark. `around`: coarse pixels to each side.
    """
    down, across = (-n % coarse_pixel for n in mask.shape)
    values = torch.cat([torch.ones_like(light[:1]), light.amax(0, keepdim=True), light])
    dark = pad(values * ~mask, (0, across, 0, down))
    sums = avg_pool2d(dark, coarse_pixel).double()
    for size, margin in (((2 * around + 1, 1), (around, 0)), ((1, 2 * around + 1), (0, around))):
        sums = avg_pool2d(sums, size, 1, margin, divisor_override=1)
    fraction, of_dark = sums[:1], sums[1:]
    return torch.where(fraction > 0.5, of_dark / fraction.clamp(min=0.5), level)


def _lamps(runs: Runs, sums: Tensor, level: float, size: tuple[int, int], sharp: float) -> _Lamps:
    """The lamp of each run, by its blob.

    `sums`: those of `_band`; `size`: (height, width) of the frame; `sharp`: radius in px up to
    which a blob is in focus.
    """
    blob, colors = runs.blobs(size[1]), len(sums) // 2 - 3
    values = torch.cat([runs.area.double()[None], sums])
    totals = values.new_zeros(len(values), int(blob.max()) + 1 if len(blob) else 0)
    totals = totals.index_add(1, blob, values)
    area, bleached, blur, beside = totals[:4]
    ground = (totals[4 : 4 + colors] / area).clamp(max=_LEVELS[-2])
    count, brightness, weight = totals[4 + colors : 7 + colors]
    white = _step(bleached / area, *_BLEACHED)
    across = math.sqrt(size[0] * size[1])
    of_color, of_white = (
        [max(fraction * across, px) for fraction, px in zip(fractions, _MIN_PX, strict=True)]
        for fractions in (_COLORED, _WHITE)
    )
    small = 1 - _step(area.sqrt(), *_interpolated(of_color, of_white, white))
    bounds = _interpolated(_COLORED_BESIDE, _WHITE_BESIDE, white)
    apart = 1 - _step(beside / (area * level), *bounds)
    # excess of the rim over the surroundings, as a share of that of white; for a blob without a
    # rim, whose border is a mixture, the two are about equal in all colours
    glow = ((totals[7 + colors :] / weight.clamp(min=_TINY) - ground) / (1 - ground)).clamp(min=0)
    maximum = glow.amax(0)
    rim = (brightness - count * beside / area) / (1 - beside / area).clamp(min=1 - _LEVELS[-2])
    hue, radius = torch.where(maximum > _TINY, glow / maximum, 1.0), blur / area
    within = area.minimum(2 * radius * area / _length(runs, blob))  # only a part of a tube
    return _Lamps(
        fraction=small * apart * _step(radius, sharp, _BLURRED * sharp),
        clipped=area / (area + rim.clamp(min=0)),
        disc=(within / (math.pi * radius**2)).clamp(max=1),
        hue=hue,
        says_hue=_step(maximum, *_SAYS_HUE) * _step(1 - hue.amin(0), *_SATURATED),
    ).select(blob)


def _length(runs: Runs, blob: Tensor) -> Tensor:
    """The longer side of each blob [m], in px."""

    def ends(values: Tensor, which: str) -> Tensor:
        start = values.new_zeros(int(blob.max()) + 1 if len(blob) else 0)
        return start.scatter_reduce(0, blob, values, which, include_self=False)

    down = ends(runs.row, "amax") - ends(runs.row, "amin") + 1
    return down.maximum(ends(runs.end, "amax") - ends(runs.first, "amin"))


def _interpolated(
    colored: Sequence[float], white: Sequence[float], fraction: Tensor
) -> list[Tensor]:
    """Bounds of blobs, interpolated from those of coloured ones (0) to those of white ones (1)."""
    return [a + (b - a) * fraction for a, b in zip(colored, white, strict=True)]


def _count(levels: list[_BlobLevel], threshold: float, width: int) -> int:
    """The number of blobs at the lowest level above the threshold that hold a light."""
    above = [level for level in levels if level.low >= threshold] or levels[-1:]
    base, holding = above[0].runs, []
    for level in above:
        row, first, _ = (part[level.lamps.fraction > _COUNTED] for part in level.runs)
        holding.append(base.holding(row, first, width))
    return len(torch.unique(base.blobs(width)[torch.cat(holding)]))


def _wide(values: Tensor) -> Tensor:
    return values.to(torch.promote_types(values.dtype, torch.float32))


def _step(values: Tensor, low: Tensor | float, high: Tensor | float) -> Tensor:
    """A smooth step from 0 at `low` to 1 at `high`."""
    x = ((values - low) / (high - low)).clamp(0, 1)
    return x * x * (3 - 2 * x)


def _lit(
    image: Tensor, threshold: Scalar, gain: Scalar, colors: int, levels: list[_BlobLevel]
) -> Tensor:
    """The picture with the light of its blobs added."""

    def of_box(box: Box) -> Tensor:
        window = box.crop(image)
        light, rest = _wide(window).tensor_split([colors])
        bright = light.amax(0)
        at = positions_of(bright.detach() > levels[0].low)
        if not len(at):
            return window
        row, column = at.unbind(1)
        colors_there, shining = light[:, row, column], bright[row, column]
        change = torch.zeros_like(colors_there)
        for low, high, runs, lamps in levels:
            above = (shining.detach() > low).nonzero()[:, 0]
            run = runs.holding(row[above] + box.top, column[above] + box.left, image.shape[-1])
            lower, upper = (
                _step(shining[above].clamp(max=bound), threshold, 1) for bound in (low, high)
            )
            upper = upper if high < 1 else _step(shining[above], threshold, 1)
            lamp = _Lamps(*(values.to(change) for values in lamps.select(run)))
            own = colors_there[:, above]
            true = torch.lerp(own, shining[above] * lamp.hue, lamp.says_hue)
            more = (upper - lower) * lamp.fraction * (lamp.gain(gain) * true - own)
            change = change.index_add(1, above, more)
        lit = light.flatten(1).index_add(1, row * light.shape[2] + column, change)
        return torch.cat([lit.view_as(light), rest]).to(image.dtype)

    return in_bands(of_box, (image.shape[-2], image.shape[-1]), image.device)


class Runs(NamedTuple):
    """The runs of a mask, in order of their first pixels."""

    row: Tensor  # [n] row of each run
    first: Tensor  # [n] column of its first pixel
    end: Tensor  # [n] column after its last pixel

    @classmethod
    def from_mask(cls, mask: Tensor, top: int) -> Runs:
        """The runs of rows [h, W] of a mask, of which the first is row `top`."""
        steps = torch.nn.functional.pad(mask.to(torch.int8), (1, 1)).diff(dim=1)
        row, first = torch.nonzero(steps > 0).unbind(1)
        return cls(row + top, first, torch.nonzero(steps < 0)[:, 1])

    @classmethod
    def concatenate(cls, bands: list[Runs]) -> Runs:
        """The runs of bands, joined from the top down."""
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
        """The number of the blob of each run, from 0 on, in a frame of some width."""
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
            # join two trees of runs: the root of one becomes a child of that of the other
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

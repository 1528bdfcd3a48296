"""Clipped lights: white blobs of an 8-bit picture, and estimates of the light that they lost.

White in 8 bits is the end of the scale, not a measured value: a lamp a hundred times as bright as a
wall is stored as hardly brighter, and its blur would be a grey disc. A gain brightens blobs near
the end of the scale. Unlike a white surface, a lamp is small, its surroundings are darker, and it
is either very small or clipped in all channels, so that it has no colour. Blobs in focus are not
blurred to discs and stay as they are.

The hue that a blob has lost is estimated from its rim, where the light of the lamp is not yet
clipped; a blob without a rim keeps its hue. The larger the rim is relative to the blob, the less
light was clipped, and the lower is the gain. The gain is limited smoothly so that the disc of a
blurred blob stays below white, where it would lose its hue again.

Which pixels form a blob depends on the brightness above which they are counted. Blobs are found at
several levels of brightness, each of which adds a share of the gain to its blobs, so that the
result is a continuous function of the threshold.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, pad

from defocus_core.allowed_values import AUTO_LIGHTS
from defocus_core.tensors.validation import Scalar, number, whole

# Pairs of limits: up to the first a blob is a light, above the second a surface; between them the
# decision is gradual. Here they limit the side of a blob (the root of its area) relative to the
# root of the area of the frame, for coloured and for white blobs; then in px, as minima in small
# frames.
_COLORED, _WHITE, _MIN_PX = (0.004, 0.012), (0.025, 0.075), (3.0, 8.0)
# Limits of the least channel, as a share of white, between coloured and white pixels; and of the
# share of white pixels, between coloured and white blobs.
_HUE, _BLEACHED = (0.6, 0.9), (0.05, 0.25)
# Limits of the brightness of the surroundings, as a share of the blob's, between lights and parts
# of surfaces, for coloured and for white blobs. Reach of the surroundings to each side, as a share
# of the longer side of the frame, and its least value in px.
_COLORED_BESIDE, _WHITE_BESIDE = (0.3, 0.6), (0.45, 0.75)
_AROUND, _MIN_AROUND = 0.012, 4
# Radius up to which a blob counts as sharp, as a share of the largest, with its bounds in px; and
# the multiple of it above which a blob gets all of its light.
_SHARP, _SHARP_PX, _BLURRED = 0.2, (1.0, 3.0), 3
# Levels of brightness at which blobs are found, more closely spaced near white.
_LEVELS = (0.0, 0.3, 0.5, 0.65, 0.75, 0.82, 0.88, 0.91, 0.94, 0.97, 1.0)
# Coarse pixels across the surroundings to a side.
_COARSE = 6
# Light that exceeds 1 by more than rounding was measured, and stays as it is.
_MEASURED = 1.001
# A blob is a light if it gets more than this share of the gain.
_COUNTED = 0.05
# Reach of the rim from a blob, as a share of the longer side of the frame, and its least value in
# px. Limits between which the weight of the rim's hue rises from none to full: of the light of the
# rim above the surroundings, as a share of white, and of the difference of its greatest and least
# channel.
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
    """The picture with its clipped lights brightened to their estimated light.

    Args:
        image: [C, H, W], linear light from 0 to 1; a picture with values above 1 is returned
            unchanged.
        threshold: Value of the brightest channel, at least 0 and below 1, at which the gain begins.
        gain: Factor, 1 or more, by which a pixel of value 1 is multiplied in a blob that is clipped
            up to its edge.
        colors: Number of channels that are colours, which come first; None for all.
        signed_radius: [H, W] px; blobs in focus are left unchanged, and the discs of other blobs
            stay below white. None means that all blobs are widely blurred.

    Returns:
        [C, H, W]. Gradients flow to image, and to threshold and gain if these are tensors; which
        pixels form blobs counts as constant.

    Raises:
        ValueError: If an argument is out of its range, or if signed_radius requires a gradient,
            which is not computed.
    """
    return ClippedLights(image, threshold, gain, colors=colors, signed_radius=signed_radius).added


class ClippedLights:
    """The clipped lights of a picture.

    Attributes:
        added: [C, H, W], the picture with its lights brightened.
        count: The number of blobs that were brightened.
        measured: Whether the picture has values above 1; it is then left unchanged.
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
        """Find and brighten the blobs; arguments are those of `with_lights`."""
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
        blur = image.new_full(image.shape[-2:], _WIDEST)
        if signed_radius is not None:
            blur = signed_radius.detach().abs()
        wide = image.to(torch.promote_types(image.dtype, torch.float32))
        light, rest = wide.tensor_split([count])
        lit, self.count = _lit(light, blur, threshold, gain, minimum)
        self.added = torch.cat([lit, rest]).to(image.dtype)


def _lit(
    light: Tensor,  # [C, H, W]
    blur: Tensor,  # [H, W] px
    threshold: Scalar,
    gain: Scalar,
    minimum: float,  # the threshold as a plain number
) -> tuple[Tensor, int]:
    """The light [C, H, W] with the estimated light of lamps added, and the number of lamps."""
    levels = [pair for pair in pairwise(_LEVELS) if pair[1] > minimum]
    sharp = float((_SHARP * blur.amax()).clamp(*_SHARP_PX))
    frame = _LightFrame(light.detach(), light.detach().amax(0), blur, sharp)
    base, holding, places, changes = None, list[Tensor](), list[Tensor](), list[Tensor]()
    for low, high in levels:
        every, is_last = Runs.from_mask(frame.bright > low), high == _LEVELS[-1]
        blobs = frame.blobs_within(every)
        lamps = _Lamps(*(x.to(light) for x in _lamps(frame, blobs, low)))
        if low >= minimum or is_last:
            base = base or every
            shown = lamps.fraction[blobs.blob] > _COUNTED
            holding.append(base.holding(blobs.row[shown], blobs.column[shown]))
        row, column, blob, _ = blobs
        own = light[:, row, column]
        shining = own.amax(0)
        limits = shining.clamp(max=low), shining if is_last else shining.clamp(max=high)
        lower, upper = (_step(x, threshold, 1) for x in limits)
        true = torch.lerp(own, shining * lamps.hue[:, blob], lamps.says_hue[blob])
        more = lamps.gain(gain)[blob] * true - own
        places.append(row * light.shape[2] + column)
        changes.append((upper - lower) * lamps.fraction[blob] * more)
    lit = light.flatten(1).index_add(1, torch.cat(places), torch.cat(changes, 1))
    assert base is not None
    return lit.view_as(light), len(torch.unique(base.blobs()[torch.cat(holding)]))


class _SmallBlobs(NamedTuple):
    """Pixels of blobs that are brighter than a level, and small enough to be lamps."""

    row: Tensor  # [n]
    column: Tensor  # [n]
    blob: Tensor  # [n] the number of the blob of each pixel
    many: int  # number of blobs


class _LightFrame(NamedTuple):
    """A picture in which lamps are searched for."""

    light: Tensor  # [C, H, W]
    bright: Tensor  # [H, W], the brightest channel of the light
    blur: Tensor  # [H, W] px
    sharp: float  # greatest blur in px of a blob in focus

    def blobs_within(self, runs: Runs) -> _SmallBlobs:
        """The blobs that `runs` form, without blobs too large for a lamp."""
        blob, most = runs.blobs(), max(_WHITE[1] * math.sqrt(self.blur.numel()), _MIN_PX[1])
        area = blob.new_zeros(len(blob)).index_add(0, blob, runs.end - runs.first)
        kept = area[blob] < most**2
        row, first, end = (x[kept] for x in runs[:3])
        number, length = torch.unique(blob[kept], return_inverse=True)[1], end - first
        run = torch.arange(len(row), device=row.device).repeat_interleave(length)
        within = torch.arange(len(run), device=row.device) - (length.cumsum(0) - length)[run]
        many = int(number.max()) + 1 if len(number) else 0
        return _SmallBlobs(row[run], first[run] + within, number[run], many)


def _beside(frame: _LightFrame, row: Tensor, column: Tensor, level: float) -> Iterator[Tensor]:
    """Yield means [n] over the dark pixels around n pixels: of brightness, then of each channel.

    Dark pixels are not brighter than `level`, which is the result where there are few of them.
    """
    dark, height, width = frame.bright <= level, *frame.bright.shape
    reach = max(_MIN_AROUND, round(_AROUND * max(height, width)))
    block = max(1, reach // _COARSE)
    around, values = reach // block, torch.empty_like(frame.bright)

    def summed(given: Tensor) -> Tensor:
        """The sum of `given` over the dark pixels around each coarse pixel: [h, w].

        It is divided by the area of a coarse pixel.
        """
        torch.mul(given, dark, out=values)
        sums = avg_pool2d(values[None], block, ceil_mode=True, divisor_override=block**2).double()
        for axis in (0, 1):
            side, margin = [1, 1], [0, 0]
            side[axis], margin[axis] = 2 * around + 1, around
            sums = avg_pool2d(sums, side, 1, margin, divisor_override=1)
        return sums[0]

    share, at = summed(torch.ones_like(values[:1, :1])), (row // block, column // block)
    for channel in (frame.bright, *frame.light):
        mean = summed(channel) / share.clamp(min=0.5)
        yield torch.where(share > 0.5, mean, level)[at]


class _Lamps(NamedTuple):
    """Estimates for the lamps of n blobs."""

    fraction: Tensor  # [n] how far the blob is a lamp, 0 to 1
    clipped: Tensor  # [n] share of the blob that is clipped
    disc: Tensor  # [n] area of the blob as a share of that of its blur disc
    hue: Tensor  # [C, n] colour of the rim, whose brightest channel is 1
    says_hue: Tensor  # [n] how far there is a rim, 0 to 1

    def gain(self, gain: Scalar) -> Tensor:
        """The gain [n] of each lamp; `gain` is the gain of a lamp whose blob is all clipped."""
        own = 1 + (gain - 1) * self.clipped * (1.5 - 0.5 * self.clipped)
        over = ((own * self.disc - _KNEE) / (_BRIGHTEST - _KNEE)).clamp(min=0)
        shown = _KNEE + (_BRIGHTEST - _KNEE) * over.tanh()
        return torch.where(over > 0, shown / self.disc.clamp(min=_TINY), own).clamp(min=1)


def _rim(frame: _LightFrame, blobs: _SmallBlobs, level: float) -> Tensor:
    """Sums over the rims of m blobs: [3 + C, m], pixel count, brightness, weight, weighted light.

    Each is the mean of two sums, over pixels to the left and right of the blob and over pixels
    above and below it, so that a picture turned by 90 degrees has the same sums. Pixels of a rim
    are not brighter than `level`.
    """
    light, bright, (height, width) = frame.light, frame.bright, frame.bright.shape
    total = light.new_zeros(3 + len(light), blobs.many).double()
    for down, across in ((0, -1), (0, 1), (-1, 0), (1, 0)):
        beside = (
            (blobs.row + down).clamp(0, height - 1),
            (blobs.column + across).clamp(0, width - 1),
        )
        last = bright[beside] <= level
        row, column, blob = (each[last] for each in blobs[:3])
        for away in range(1, max(_MIN_RIM, round(_RIM * max(height, width))) + 1):
            y, x = row + down * away, column + across * away
            at = y.clamp(0, height - 1), x.clamp(0, width - 1)
            dark = ((y == at[0]) & (x == at[1]) & (bright[at] <= level)).to(light)
            weight = dark * bright[at] ** 2
            sums = [torch.stack([dark, dark * bright[at], weight]), weight * light[:, *at]]
            total.index_add_(1, blob, torch.cat(sums).double())
    return total / 2


def _lamps(frame: _LightFrame, blobs: _SmallBlobs, low: float) -> _Lamps:
    """The estimated lamp of each of m blobs, whose pixels are brighter than `low`."""
    row, column, blob, many = blobs
    zeros, area = row.new_zeros(many).double(), torch.bincount(blob, minlength=many).double()
    white, blur = _step(frame.light[:, row, column].amin(0), *_HUE), frame.blur[row, column]
    values = white, blur, *_beside(frame, row, column, low)
    bleached, blur, beside, *ground = (zeros.index_add(0, blob, x.double()) for x in values)
    count_of_rim, brightness, weight, *shine = _rim(frame, blobs, low)
    white = _step(bleached / area, *_BLEACHED)
    across = math.sqrt(frame.blur.numel())
    of_color, of_white = (
        [max(fraction * across, px) for fraction, px in zip(fractions, _MIN_PX, strict=True)]
        for fractions in (_COLORED, _WHITE)
    )
    small = 1 - _step(area.sqrt(), *_interpolated(of_color, of_white, white))
    bounds = _interpolated(_COLORED_BESIDE, _WHITE_BESIDE, white)
    apart = 1 - _step(beside / (area * max(low, _LEVELS[1])), *bounds)
    # excess of the rim over the surroundings, as a share of that of white; for a blob without a
    # rim, whose border is a mixture, the two are about equal in all colours
    around = (torch.stack(ground) / area).clamp(max=_LEVELS[-2])
    glow = ((torch.stack(shine) / weight.clamp(min=_TINY) - around) / (1 - around)).clamp(min=0)
    maximum = glow.amax(0)
    rim = brightness - count_of_rim * beside / area
    rim = rim / (1 - beside / area).clamp(min=1 - _LEVELS[-2])
    hue, radius = torch.where(maximum > _TINY, glow / maximum, 1.0), blur / area
    within = area.minimum(2 * radius * area / _length(blobs))  # only a part of a tube
    return _Lamps(
        fraction=small * apart * _step(radius, frame.sharp, _BLURRED * frame.sharp),
        clipped=area / (area + rim.clamp(min=0)),
        disc=(within / (math.pi * radius**2)).clamp(max=1),
        hue=hue,
        says_hue=_step(maximum, *_SAYS_HUE) * _step(1 - hue.amin(0), *_SATURATED),
    )


def _length(blobs: _SmallBlobs) -> Tensor:
    """The longer side [m] of the bounding box of each blob, in px."""
    blank = blobs.blob.new_zeros(2, blobs.many)
    place, blob = torch.stack([blobs.row, blobs.column]), blobs.blob.expand(2, -1)
    first, last = (
        blank.scatter_reduce(1, blob, place, which, include_self=False)
        for which in ("amin", "amax")
    )
    return (last - first + 1).amax(0)


def _interpolated(colored: Sequence[float], white: Sequence[float], share: Tensor) -> list[Tensor]:
    """Limits interpolated between those of coloured blobs (share 0) and white blobs (share 1)."""
    return [a + (b - a) * share for a, b in zip(colored, white, strict=True)]


def _step(values: Tensor, low: Tensor | float, high: Tensor | float) -> Tensor:
    """The smoothstep function: 0 up to `low`, 1 from `high`, cubic between them."""
    x = ((values - low) / (high - low)).clamp(0, 1)
    return x * x * (3 - 2 * x)


class Runs(NamedTuple):
    """The horizontal runs of adjacent True pixels of a mask, row by row from left to right."""

    row: Tensor  # [n] row of each run
    first: Tensor  # [n] column of its first pixel
    end: Tensor  # [n] column after its last pixel
    stride: int  # from a pixel to the one below it, among numbers of pixels

    @classmethod
    def from_mask(cls, mask: Tensor) -> Runs:
        """The runs of a mask [H, W] bool."""
        steps = pad(mask.to(torch.int8), (1, 1)).diff(dim=1)
        row, first = torch.nonzero(steps > 0).unbind(1)
        return cls(row, first, torch.nonzero(steps < 0)[:, 1], mask.shape[1] + 2)

    def holding(self, row: Tensor, column: Tensor) -> Tensor:
        """The index of the run that contains each given pixel; the pixels must lie in the mask."""
        firsts = self.row * self.stride + self.first
        return torch.searchsorted(firsts, row * self.stride + column, right=True) - 1

    def blobs(self) -> Tensor:
        """The number [n] of each run's blob, from 0; runs that touch, also at corners, are one."""
        one, other = self._touching()
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

    def _touching(self) -> tuple[Tensor, Tensor]:
        """All pairs of runs in adjacent rows that share a side or corner, as two index tensors."""
        firsts, limits = self.row * self.stride + self.first, self.row * self.stride + self.end
        low = torch.searchsorted(limits, firsts + self.stride)
        high = torch.searchsorted(firsts, limits + self.stride, right=True)
        count = (high - low).clamp(min=0)
        one = torch.arange(len(low), device=low.device).repeat_interleave(count)
        before = (count.cumsum(0) - count).repeat_interleave(count)
        rank = torch.arange(len(one), device=low.device) - before
        return one, low.repeat_interleave(count) + rank

"""Noise of depth, taken out: a surface in focus would have holes where its radii scatter.

A pixel that seems out of focus among sharp ones spreads its light, and what lies far behind would
show in the gap. What scatters from pixel to pixel all over a frame, by less than the steps between
surfaces, is no shape: sensors and stereo matching leave it. Each pixel gets the mean of those
around it that are as near; they count in pairs from both sides of it, so that slopes stay.
"""

from __future__ import annotations

import math
from itertools import accumulate

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.images.source import spread

# Every how many rows and columns a pixel is compared with those beside it.
_EVERY = 16
# Steps in px between neighbours up to which they may belong together, and the share that must.
_STEP, _TOGETHER = 2.513, 0.5
# By how many px a pixel sticks out from both neighbours at least if it is noisy, and the share of
# the pixels that must: two thirds do where all is noise.
_LEAST, _SHARE = 0.02013, 0.1
# Intervals, evenly spaced in the logarithm, in which these numbers are counted.
_INTERVALS = 48
# Median of by how much they do, from the mean of the two, in standard deviations.
_MEDIAN = 1.1606
# What is off by so many standard deviations, or px, belongs to another surface; unless it stands
# alone and is off by no more than that.
_SURE, _MOST, _ALONE = 4.0, 3.513, 6.0
# The pixels within so many px are looked at, so many times.
_NEAR, _TIMES = 2, 2
# Px around a pixel that decide what it becomes.
AROUND = _NEAR * _TIMES
# Half of them; the others lie opposite.
_HALF = [
    (y, x)
    for y in range(_NEAR + 1)
    for x in range(-_NEAR, _NEAR + 1)
    if (y, x) > (0, 0) and y * y + x * x <= _NEAR * _NEAR
]
# Stands for a radius beyond the frame.
_OUTSIDE = 1e18


def scatter_counts(band: Tensor, first: int, rows: tuple[int, int], height: int) -> Tensor:
    """Counts of pixels by their scatter, of a sample of some rows of a frame: [_INTERVALS + 3].

    Args:
        band: [h, W] px, these rows and at least the ones beside them that are in the frame.
        first: The number of the first row of the band.
        rows: First and last row + 1.
        height: Rows of the frame.
    """
    W = band.shape[1]
    ends = torch.cat([torch.zeros(1), _interval_ends()]).to(band.device)
    within = [i for i in spread(height, _EVERY, *rows) if 0 < i + rows[0] < height - 1]
    columns = torch.tensor([i for i in spread(W, _EVERY) if 0 < i < W - 1], dtype=torch.long)
    off = _scatter(band, torch.tensor(within) + (rows[0] - first), columns)
    return torch.bincount(torch.bucketize(off, ends, right=True), minlength=len(ends) + 1)


def noise_from(counts: Tensor) -> float | None:
    """The standard deviation in px of the noise of a frame; None if there is none.

    What scatters over much of a frame is taken for noise, whatever it is: relief as small as that
    would be blurred alike.

    Args:
        counts: The sum of the `scatter_counts` of its rows.
    """
    apart, alike, *noisy = counts.tolist()
    together = alike + sum(noisy)
    if together <= _TOGETHER * (apart + together) or sum(noisy) <= _SHARE * together:
        return None
    half = sum(1 for count in accumulate(noisy) if 2 * count < sum(noisy))  # where the median is
    ends = _interval_ends()
    return math.sqrt(float(ends[half]) * float(ends[half + 1])) / _MEDIAN


def _interval_ends() -> Tensor:
    return torch.logspace(math.log10(_LEAST), math.log10(_STEP), _INTERVALS + 1)


def _scatter(r: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """By how many px some pixels stick out from the mean of two neighbours; -1 if these are far.

    Both neighbours beside it, and both above and below it. On slopes and on terraces none does.
    """
    rows, columns = rows.to(r.device, torch.long), columns.to(r.device)

    def beside(down: int, across: int) -> Tensor:
        return r.index_select(0, rows + down).index_select(1, columns + across).float()

    here, found = beside(0, 0), []
    for down, across in ((1, 0), (0, 1)):
        before, after = (beside(way * down, way * across) - here for way in (-1, 1))
        near = torch.maximum(before.abs(), after.abs()) <= _STEP
        off = torch.where(before * after > 0, ((before + after) / 2).abs(), 0.0)
        found.append(torch.where(near, off, -1.0).flatten())
    return torch.cat(found)


def without_noise(signed_radius: Tensor, noise: float) -> Tensor:
    """Radii [H, W] px without noise of some standard deviation in px."""
    radii = signed_radius.to(torch.promote_types(signed_radius.dtype, torch.float32))
    most = torch.full_like(radii, min(_SURE * noise, _MOST))
    for _ in range(_TIMES):
        radii, alone = _smoothed(radii, most)
        most = torch.where(alone, min(_ALONE * noise, _MOST), most)
    return radii


def _smoothed(radii: Tensor, most: Tensor) -> tuple[Tensor, Tensor]:
    """Means of the pixels around that differ by no more than so many px; and where none does."""
    H, W = radii.shape
    framed = pad(radii[None, None], (_NEAR,) * 4, value=_OUTSIDE)[0, 0]

    def beside(y: int, x: int) -> Tensor:
        return framed[_NEAR + y : _NEAR + y + H, _NEAR + x : _NEAR + x + W] - radii

    total, count = torch.zeros_like(radii), torch.ones_like(radii)
    for y, x in _HALF:
        pair = beside(y, x), beside(-y, -x)
        near = (torch.maximum(*(each.detach().abs() for each in pair)) <= most).to(radii)
        total = total.addcmul(pair[0] + pair[1], near)
        count.add_(near, alpha=2)
    return radii + total / count, count == 1

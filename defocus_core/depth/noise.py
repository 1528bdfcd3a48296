"""Noise of depth, taken out: a surface in focus would have holes where its radii scatter.

A pixel that seems out of focus among sharp pixels spreads its light, and the far background would
show in the gap. Scatter from pixel to pixel all over a frame, smaller than the steps between
surfaces, is noise of a sensor or of stereo matching, not shape. Each pixel gets the mean of the
pixels around it that are about as near. They count in pairs from both sides of the pixel, so that
slopes stay.
"""

from __future__ import annotations

import math
from itertools import accumulate

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.tensors.source import spread

# Distance of the rows and columns in the sample of pixels that are compared with their neighbours.
_EVERY = 16
# Greatest step in px between neighbours of one surface, and the least share of such neighbours.
_STEP, _TOGETHER = 2.513, 0.5
# Least distance in px of a noisy pixel from the mean of its neighbours, and the least share of such
# pixels in a noisy frame: two thirds stick out where everything is noise.
_LEAST, _SHARE = 0.02013, 0.1
# Number of intervals of the histogram of these distances, evenly spaced in the logarithm.
_INTERVALS = 48
# Median distance from the mean of two neighbours, in standard deviations of the noise.
_MEDIAN = 1.1606
# Difference in standard deviations, and in px, from which on a pixel is of another surface; and the
# greater one, in standard deviations, for a pixel that has no other near pixel.
_SURE, _MOST, _ALONE = 4.0, 3.513, 6.0
# Radius in px of the disc whose pixels are averaged, and the number of rounds.
_NEAR, _TIMES = 2, 2
# Px around a pixel that decide what it becomes.
AROUND = _NEAR * _TIMES
# Half of the disc's offsets; the other half lies opposite.
_HALF = [
    (y, x)
    for y in range(_NEAR + 1)
    for x in range(-_NEAR, _NEAR + 1)
    if (y, x) > (0, 0) and y * y + x * x <= _NEAR * _NEAR
]
# Stands for a radius beyond the frame.
_OUTSIDE = 1e18


def scatter_counts(band: Tensor, first: int, rows: tuple[int, int], height: int) -> Tensor:
    """Histogram of scatter in a sample of pixels of a band of rows: [_INTERVALS + 3].

    Args:
        band: [h, W] px, the counted rows and at least the rows of the frame beside them.
        first: The number of the first row of the band.
        rows: The counted rows, [first, end).
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

    Scatter over much of a frame is taken for noise, whatever it is: relief as fine as noise would
    look the same once it is blurred.

    Args:
        counts: The sum of `scatter_counts` over all rows of the frame.
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
    """Distance in px of pixels from the mean of two neighbours; -1 if a neighbour is far.

    Once for the neighbours above and below a pixel, once for the neighbours to its left and right.
    The distance is 0 where the pixel lies between both neighbours, as on slopes and on terraces.
    """
    rows, columns = rows.to(r.device, torch.long), columns.to(r.device)

    def beside(down: int, across: int) -> Tensor:
        return r.index_select(0, rows + down).index_select(1, columns + across).float()

    middle, distances = beside(0, 0), []
    for down, across in ((1, 0), (0, 1)):
        before, after = (beside(way * down, way * across) - middle for way in (-1, 1))
        near = torch.maximum(before.abs(), after.abs()) <= _STEP
        off = torch.where(before * after > 0, ((before + after) / 2).abs(), 0.0)
        distances.append(torch.where(near, off, -1.0).flatten())
    return torch.cat(distances)


def without_noise(signed_radius: Tensor, noise: float) -> Tensor:
    """Radii [H, W] px without noise of the given standard deviation in px."""
    radii = signed_radius.to(torch.promote_types(signed_radius.dtype, torch.float32))
    most = torch.full_like(radii, min(_SURE * noise, _MOST))
    for _ in range(_TIMES):
        radii, alone = _smoothed(radii, most)
        most = torch.where(alone, min(_ALONE * noise, _MOST), most)
    return radii


def _smoothed(radii: Tensor, most: Tensor) -> tuple[Tensor, Tensor]:
    """Means [H, W] of the near pixels around each pixel, and where no pixel is near.

    Args:
        radii: [H, W] px.
        most: [H, W] px, the greatest difference of a near pixel.
    """
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

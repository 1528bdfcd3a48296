"""Depth made smooth again: noise, and terraces of few levels.

Noise: a surface in focus would have holes where its radii scatter. A pixel that seems out of focus
among sharp pixels spreads its light, and the far background would show in the gap. Scatter from
pixel to pixel all over a frame, smaller than the steps between surfaces, is noise of a sensor or of
stereo matching, not shape. Each pixel gets the mean of the pixels around it that have about the
same radius. These count in pairs, on opposite sides of the pixel, so that slopes stay.

Terraces: an 8-bit depth map shows a slope in steps. No surface ends where the radius steps by up to
a pixel, but a step of nearly a pixel would leave a gap as wide, and the far background would show
through it as a thin line. Each pixel gets the mean of those around it in the same way.
"""

from __future__ import annotations

import math
from itertools import accumulate

from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.neighbourhoods import exceeding, flat_nonzero, masked_values, tally
from defocus_core.tensors.ties import off_round

# Greatest step in px between neighbours of one surface, and the least share of such neighbours.
STEP, TOGETHER = off_round(2.5), 0.5
# Least distance in px of a noisy pixel from the mean of its neighbours, and the least share of such
# pixels in a noisy frame: two thirds stick out where everything is noise.
SCATTER, FRACTION = off_round(0.02), 0.1
# Number of intervals of the histogram of these distances, evenly spaced in the logarithm.
_INTERVALS = 48
# Median distance from the mean of two neighbours, in standard deviations of the noise.
_MEDIAN = 1.1606
# Difference from which on a pixel is of another surface, in standard deviations and in px; and a
# greater one, in standard deviations, for a pixel without any pixel of about its radius around it.
_SURE, _MAXIMUM, _ALONE = 4.0, off_round(3.5), 6.0
# Radius in px of the disc whose pixels are averaged, and the number of rounds.
_NEAR, _ROUNDS = 2, 2
# Distance in px up to which pixels affect the result of `without_noise` and `without_terraces`.
AROUND = _NEAR * _ROUNDS
# Half of the disc's offsets; the other half lies opposite.
_HALF = [
    (y, x)
    for y in range(_NEAR + 1)
    for x in range(-_NEAR, _NEAR + 1)
    if (y, x) > (0, 0) and y * y + x * x <= _NEAR * _NEAR
]
# Stands for a radius beyond the frame.
_OUTSIDE = 1e18


def scatter_counts(steps: list[Tensor], rows: tuple[int, int]) -> Tensor:
    """Histogram [_INTERVALS + 3] of how far radii scatter in rows of a frame.

    The first count is of pixels that differ from a neighbour by more than a step between surfaces.
    The other pixels are counted by their distance from the mean of both neighbours along an axis;
    this is taken as 0 for a pixel with a radius between those of both neighbours, as on slopes and
    terraces.

    `steps`: differences in px from each pixel of a band [h, W] to the next, down and across;
    `rows`: (first, end) of the counted rows in the band, which also has the rows of the frame next
    to them.
    """
    down, across = steps
    first, end = max(rows[0], 1), max(min(rows[1], across.shape[0] - 1), 1)
    inner = (down[first - 1 : end, 1:-1], across[first:end])
    pairs = [
        [step.narrow(dim, at, max(step.shape[dim] - 1, 0)) for at in (0, min(1, step.shape[dim]))]
        for dim, step in enumerate(inner)
    ]
    before, after = (torch.cat(both) for both in zip(*pairs, strict=True))
    limits = _interval_limits().to(before)
    far = exceeding(torch.maximum(before.abs(), after.abs()), STEP)
    apart = torch.count_nonzero(far)
    beyond = torch.mul(before, after).clamp_(max=0).bool() & ~far
    off = ((masked_values(after, beyond) - masked_values(before, beyond)).abs_() / 2).flatten()
    counts = tally(torch.bucketize(off, limits, right=True), len(limits) + 1)
    counts[0] += before.numel() - len(off) - apart
    return torch.cat([apart[None], counts])


def noise_from(counts: list[int]) -> float | None:
    """The standard deviation in px of the noise of a frame; None if there is none.

    `counts`: from `scatter_counts`, summed over the frame. Scatter over much of a frame is taken
    for noise, whatever it is: relief as fine as noise would look the same once it is blurred.
    """
    apart, alike, *noisy = counts
    together = alike + sum(noisy)
    if together <= TOGETHER * (apart + together) or sum(noisy) <= FRACTION * together:
        return None
    half = sum(1 for count in accumulate(noisy) if 2 * count < sum(noisy))  # where the median is
    half = min(half, _INTERVALS - 1)  # a distance of just STEP, and NaN, are beyond the intervals
    limits = _interval_limits()
    return math.sqrt(float(limits[half]) * float(limits[half + 1])) / _MEDIAN


def _interval_limits() -> Tensor:
    return torch.logspace(math.log10(SCATTER), math.log10(STEP), _INTERVALS + 1)


def without_noise(signed_radius: Tensor, noise: float) -> Tensor:
    """Radii [H, W] px without noise of the given standard deviation in px."""
    radii = signed_radius.to(torch.promote_types(signed_radius.dtype, torch.float32))
    maximum = torch.full_like(radii, min(_SURE * noise, _MAXIMUM))
    for _ in range(_ROUNDS):
        radii, alone = _smoothed(radii, maximum)
        maximum = torch.where(alone, min(_ALONE * noise, _MAXIMUM), maximum)
    return radii


def _smoothed(radii: Tensor, maximum: Tensor) -> tuple[Tensor, Tensor]:
    """Means [H, W] px of similar radii around each pixel, and whether no radius is similar [H, W].

    `radii`: [H, W] px; `maximum`: [H, W] px, the greatest difference of a similar radius.
    """
    H, W = radii.shape
    framed = torch.nn.functional.pad(radii[None, None], (_NEAR,) * 4, value=_OUTSIDE)[0, 0]

    def differences(y: int, x: int) -> Tensor:
        return framed[_NEAR + y : _NEAR + y + H, _NEAR + x : _NEAR + x + W] - radii

    total, count = torch.zeros_like(radii), torch.ones_like(radii)
    for y, x in _HALF:
        pair = differences(y, x), differences(-y, -x)
        near = (torch.maximum(*(each.detach().abs() for each in pair)) <= maximum).to(radii)
        total = total.addcmul(pair[0] + pair[1], near)
        count.add_(near, alpha=2)
    return radii + total / count, count == 1


# Diagnosis of quantised depth. Least share of neighbours that are equal; among unequal neighbours,
# least share with a step of at most MOST px, and with one between LEAST and MOST px. Number of
# different radii: more than the first, at most the second.
ALIKE, SMALL, MATTERS = 0.5, 0.5, 0.03
FEW, _MANY = 32, 256
# Least and greatest step in px between terraces.
LEAST, MOST = off_round(0.2), off_round(1.0)


def steps_of(sizes: list[Tensor]) -> Tensor:
    """Counts [2, 4] of the steps down and across: all, zero, at most LEAST px, at most MOST px.

    `sizes`: sizes in px of the steps from each pixel of a band of a frame to the next, down and
    across.
    """
    larger = [
        torch.count_nonzero(exceeding(size, bound))
        for size in sizes
        for bound in (0.0, LEAST, MOST)
    ]
    counts = (
        torch.tensor([size.numel() for size in sizes])[:, None].repeat(1, 4).to(sizes[0].device)
    )
    counts[:, 1:] -= torch.stack(larger).view(2, 3)
    return counts


def are_few(steps: list[list[float]], signed_radius: Tensor) -> bool:
    """Whether the depth of a frame has few levels.

    `steps`: counts from `steps_of`, summed over the frame; `signed_radius`: [H, W] px of the frame.
    """
    for count, same, minimum, small in steps:
        if same <= ALIKE * count:
            return False
        if small - same <= SMALL * (count - same) or small - minimum <= MATTERS * (count - same):
            return False
    dtype = torch.promote_types(signed_radius.dtype, torch.float32)
    return FEW < len(_levels(signed_radius.detach().to(dtype))) <= _MANY


def _levels(rows: Tensor) -> Tensor:
    """The different radii [n] in `rows` [H, W] of pixels that equal those to the right and below.

    These radii are the levels of the map, without averages of levels on edges.
    """
    across, down = rows.diff(dim=1)[:-1].bool(), rows.diff(dim=0)[:, :-1].bool()
    goes_on = ~(across | down)
    begins = goes_on.clone()  # only the first of consecutive equal ones, as sorting takes long
    begins[:, 1:] &= ~goes_on[:, :-1]
    levels: Tensor = torch.unique(rows[:-1, :-1].flatten()[flat_nonzero(begins)])
    return levels


def without_terraces(signed_radius: Tensor) -> Tensor:
    """Radii [H, W] px in which small steps of slopes are smoothed."""
    radii, maximum = signed_radius, torch.full_like(signed_radius, MOST)
    for _ in range(_ROUNDS):
        radii, _ = _smoothed(radii, maximum)
    return radii

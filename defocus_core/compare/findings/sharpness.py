"""Explanations that no single formula makes: another CoC, and noise.

Blurred less or more: the difference B − A goes along with the detail of A, that is A minus its mean
over a window, with a positive or a negative sign. It does so at each place of its own, since depth
varies; noise goes along with nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import Evidence, compressed
from defocus_core.compare.findings.finding import Finding

_FRAME = 768  # px of a picture that are looked at, across and down
_RINGS, _COARSE = 24, 3  # of the spectrum, and how many of them are coarse detail
_FILTER_LEFT = 0.3  # of the difference that a filter for all places may leave
_REACHES = (1, 2, 4, 8)  # px of the windows
_BLOCK = 32  # px
_UNLIKE = 0.35  # greatest correlation of noise with detail
_ALIKE = 0.5  # least correlation of the difference with detail in a block that is blurred
_LEAST_CHANGED = 0.02  # share of pixels that differ, below which a change is local
_IN_COMMON = 0.5  # least correlation of the detail of A with that of B
_SAME_LIGHT = 0.2  # greatest difference of the mean light of a block, by the RMS difference
_OTHER_SPREAD = 0.05  # least relative difference of the variance of its light
_OF_BLOCKS = 0.5  # least share of the difference in blocks that show it
_ONE_WAY = 0.85  # share of blurred blocks that makes a picture blurred more, or less
_UNLIKE_NEIGHBOURS = 0.25  # greatest correlation of noise with itself one pixel on
_WITHOUT_MEAN = 0.3  # greatest mean of noise, by its root mean square


def findings(evidence: Evidence) -> Iterator[Finding]:
    """Another CoC, or noise, or neither."""
    frame = (slice(None), *_frame(evidence))
    light = [planes[frame].mean(axis=0, dtype="f8") for planes in (evidence.a, evidence.b)]
    a, b = (compressed(side) for side in light)
    difference = b - a
    energy = float(np.square(difference).sum())
    if np.count_nonzero(difference) < _LEAST_CHANGED * difference.size:
        return
    neighbours = max(
        _alike(difference[1:], difference[:-1]), _alike(difference[:, 1:], difference[:, :-1])
    )
    root = math.sqrt(energy / difference.size)
    details = [a - _mean(a, reach) for reach in _REACHES]
    against = max((_alike(difference, detail) for detail in details), key=abs)
    if abs(neighbours) < _UNLIKE_NEIGHBOURS and abs(against) < _UNLIKE:
        if abs(float(difference.mean())) < _WITHOUT_MEAN * root:
            level = float(np.sqrt(np.square(evidence.b - evidence.a, dtype="f8").mean()))
            yield Finding("noise", f"noise of about {level:.2g}", {"rms": level})
        return
    filtered = _filtered(a, b)
    if filtered:
        word = "more" if filtered < 1 else "less"
        values = {"detail": round(filtered, 3)}
        yield Finding("another CoC", f"another CoC: blurred {word}", values)
        return
    more, less = _blocks(a, b, details, _spreads(*light))
    if more + less < _OF_BLOCKS:
        return
    share = more / (more + less)
    shares = {"blurred_more": round(more, 3), "blurred_less": round(less, 3)}
    text = "blurred more in places, less in others"
    if share > _ONE_WAY:
        text = "blurred more"
    elif share < 1 - _ONE_WAY:
        text = "blurred less"
    yield Finding("another CoC", f"another CoC: {text}", shares)


def _filtered(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Fine detail of B by that of A if B is A through one filter for all places, else 0.

    The filter is the real part of the transfer function, in rings of the spectrum.
    """
    height, width = a.shape
    window = np.hanning(height + 2)[1:-1, None] * np.hanning(width + 2)[None, 1:-1]
    old, new = (np.fft.rfft2((side - side.mean()) * window) for side in (a, b))
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :])
    ring = np.minimum(frequency / 0.5 * _RINGS, _RINGS - 1).astype(np.intp).ravel()
    power = np.bincount(ring, (np.abs(old) ** 2).ravel(), _RINGS)
    crossed = np.bincount(ring, (np.conj(old) * new).real.ravel(), _RINGS)
    transfer = crossed / np.where(power > 0, power, np.inf)
    # What is left is to be small beside B, too: a filter of 0 leaves any other picture.
    whole = min(float(np.square(np.abs(side)).sum()) for side in (new - old, new))
    rest = float(np.square(np.abs(new - transfer[ring].reshape(old.shape) * old)).sum())
    coarse = float(crossed[:_COARSE].sum()), float(power[:_COARSE].sum())
    fine = float(crossed[_COARSE:].sum()), float(power[_COARSE:].sum())
    if not whole or rest > _FILTER_LEFT**2 * whole or min(*coarse, *fine) <= 0:
        return 0.0
    return (fine[0] / fine[1]) / (coarse[0] / coarse[1])


def _blocks(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    details_a: Sequence[NDArray[np.float64]],
    spreads: NDArray[np.float64],
) -> tuple[float, float]:
    """Shares of the squared difference in blocks that are blurred more, and less.

    In such a block, the difference goes along with detail that A and B have in common, or the same
    light is spread otherwise.
    """
    difference = b - a
    energy = _block_sums(difference * difference)
    strongest = np.zeros_like(energy)
    for reach, detail_a in zip(_REACHES, details_a, strict=True):
        details = detail_a, b - _mean(b, reach)
        old, new = (_block_sums(detail * detail) for detail in details)
        common = _ratio(_block_sums(details[0] * details[1]), old * new) > _IN_COMMON
        for detail, own in zip(details, (old, new), strict=True):
            alike = common * _ratio(_block_sums(difference * detail), energy * own)
            strongest = np.where(np.abs(alike) > np.abs(strongest), alike, strongest)
    strongest = np.where(np.abs(strongest) > _ALIKE, strongest, spreads)
    total = float(energy.sum())
    more = float(energy[strongest < -_ALIKE].sum()) / total
    return more, float(energy[strongest > _ALIKE].sum()) / total


def _spreads(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Blocks in which the same light is spread more (−1) or less (1) in B, else 0.

    Blur keeps the sum of light and lowers its variance. It finds the discs of highlights, whose
    detail is as flat as they are.
    """
    count = _block_sums(np.ones_like(a))
    mean_a, mean_b = (_block_sums(side) / count for side in (a, b))
    variance_a = _block_sums(a * a) / count - mean_a**2
    variance_b = _block_sums(b * b) / count - mean_b**2
    common = _ratio(_block_sums(a * b) / count - mean_a * mean_b, variance_a * variance_b)
    root = np.sqrt(_block_sums((b - a) ** 2) / count)
    same = (common > _IN_COMMON) & (np.abs(mean_b - mean_a) < _SAME_LIGHT * root)
    less = (variance_b > variance_a * (1 + _OTHER_SPREAD)).astype(np.float64)
    more = (variance_b < variance_a * (1 - _OTHER_SPREAD)).astype(np.float64)
    spreads: NDArray[np.float64] = same * (less - more)
    return spreads


def _ratio(products: NDArray[np.float64], squares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Correlations of blocks, 0 where a block is constant."""
    return products / np.sqrt(np.where(squares > 0, squares, np.inf))


def _frame(evidence: Evidence) -> tuple[slice, slice]:
    """Rows and columns that are looked at: around the middle of what differs."""
    cuts = []
    for axis, length in enumerate(evidence.size):
        weights = evidence.pixels.greatest.sum(axis=1 - axis)
        middle = float((weights * np.arange(length)).sum() / weights.sum())
        first = min(max(0, round(middle) - _FRAME // 2), max(0, length - _FRAME))
        cuts.append(slice(first, first + _FRAME))
    return cuts[0], cuts[1]


def _alike(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Correlation of two arrays, 0 if one is constant or empty."""
    if not x.size:
        return 0.0
    x, y = x - x.mean(), y - y.mean()
    # Not np.vdot: its threads wait for each other where several processes compare.
    scale = math.sqrt(float(np.square(x).sum()) * float(np.square(y).sum()))
    return float((x * y).sum()) / scale if scale else 0.0


def _mean(values: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """The mean over a window of 2 reach + 1 px, smaller at the border."""
    for axis, length in enumerate(values.shape):
        first = np.maximum(np.arange(length) - reach, 0)
        end = np.minimum(np.arange(length) + reach + 1, length)
        before = [(0, 0), (0, 0)]
        before[axis] = (1, 0)
        sums = np.pad(np.cumsum(values, axis=axis), before)
        counts = np.expand_dims(end - first, 1 - axis)
        values = (sums.take(end, axis=axis) - sums.take(first, axis=axis)) / counts
    return values


def _block_sums(values: NDArray[np.float64]) -> NDArray[np.float64]:
    height, width = values.shape
    rows = np.add.reduceat(values, np.arange(0, height, _BLOCK), axis=0)
    return np.add.reduceat(rows, np.arange(0, width, _BLOCK), axis=1)

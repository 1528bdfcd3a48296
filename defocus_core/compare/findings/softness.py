"""Causes that make a picture softer or sharper: blur, denoisers, another resolution.

A filter for all places is found by its response to the frequencies of A, in light or, in files with
a curve, in what a screen shows. Where blur depends on depth, each part of a picture has a filter of
its own: a sum of A through gaussians. All are measured in the frame, in the mean light of channels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import (
    Evidence,
    Explanation,
    blocks_in_turn,
    densest,
    summed_up,
    sums_of_parts,
)

_LEAST, _MARGIN = 28, 8  # px of a side that is looked at, and of its border that is left out
_RADII, _SIGMAS = np.geomspace(0.35, 16, 80), np.geomspace(0.2, 8, 80)  # px
_FEW = 24  # each how many-th frequency is looked at
_WIDTHS = (0.6, 1.2, 2.4, 4.8)  # px of the gaussians of parts
_PARTS = (16, 32)  # px of a side of parts
_ALIKE = (0.03, 0.08, 0.2)  # differences of neighbours that a denoiser averages
_OF_LIGHT = 0.3  # least share of the power of a difference that channels share
_ONE_WAY = 0.85  # share of a difference where detail is lost that makes a picture softer
_Kernel = Callable[[Any], Any]  # weights by distances
_Kernels = tuple[_Kernel, _Kernel]  # to a smaller size, and back
_SIZES, _REACH = np.linspace(0.2, 0.985, 64), 40  # shares of a size; px that its kernels reach
_FILTERED, _KERNELS = 0.4, 3  # left by a filter; kernels tried
_OFF, _PROBE = 0.06, 64  # share by which a size is looked for; px of the part that finds it
_KEPT = 6  # sizes of which either side is looked for
# Least unevenness of differences of pixels that half and a quarter of the resolution make.
_ON_GRID = {2: 0.1, 4: 0.4}


@dataclass(frozen=True, eq=False)
class _Frame:
    """The frame of a pair, and its frequencies."""

    evidence: Evidence
    shown: bool = False  # whether filters are applied to what a screen shows, not to light

    @cached_property
    def sides(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Light of A and B, or what a screen shows of it, [h, w]."""
        if not self.shown:
            return self.evidence.framed
        a, b = (self.evidence.scaled_light(v).astype("f8") for v in self.evidence.framed)
        return a, b

    @cached_property
    def chooses(self) -> NDArray[np.bool_]:
        """Pixels [h, w] that choose parameters; the others measure."""
        return blocks_in_turn(self.sides[0].shape, 4)

    def left(self, predicted: NDArray[Any]) -> float:
        """What is left where it is measured if B were as predicted."""
        light = self.evidence.unscaled_light(predicted) if self.shown else predicted
        light = light if self.evidence.gamma == 1.0 else light.clip(0.0, 1.0)
        measures = ~self.chooses
        for rim in (slice(_MARGIN), slice(-_MARGIN, None)):
            measures[rim] = measures[:, rim] = False
        return self.evidence.left_framed(light, measures)

    @cached_property
    def slope(self) -> NDArray[Any]:
        """The slope of the scale of differences, 0 near clipped pixels."""
        light = np.maximum(*map(np.abs, self.sides))
        step = np.maximum(light * 1e-3, 1e-5)
        high, low = (self.evidence.scaled_light(light + s).astype("f8") for s in (step, -step))
        return np.where(self.evidence.clipped_near, 0.0, (high - low) / (2 * step))

    @cached_property
    def frequencies(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Of rows and columns, in cycles a pixel."""
        height, width = self.sides[0].shape
        return np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :]

    @cached_property
    def few(self) -> tuple[NDArray[Any], NDArray[Any], tuple[NDArray[Any], ...]]:
        """Rows and columns of some frequencies, the powers of A and B, and what they share."""
        window = np.sqrt(np.outer(*(np.hanning(n + 2)[1:-1] for n in self.sides[0].shape)))
        a, b = (np.fft.rfft2((side - side.mean()) * window) for side in self.sides)
        places = np.arange(a.size)[1::_FEW]
        rows, columns = np.divmod(places, a.shape[1])
        every = (np.abs(a) ** 2, np.abs(b) ** 2, (np.conj(a) * b).real)
        return rows, columns, tuple(each.ravel()[places] for each in every)

    @cached_property
    def transformed(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """The transforms of A and B."""
        a, b = map(np.fft.rfft2, self.sides)
        return a, b

    def filtered(self, side: int, response: NDArray[Any]) -> NDArray[Any]:
        """A or B through a filter, around at the borders."""
        size = self.sides[side].shape
        return np.asarray(np.fft.irfft2(self.transformed[side] * response, s=size))

    def smooth(self, side: int, sigma: float) -> NDArray[Any]:
        """A or B through a gaussian."""
        return self.filtered(side, _gauss(np.hypot(*self.frequencies), sigma))

    def most_alike(self, side: int, responses: NDArray[Any]) -> int:
        """Which of responses [K, N] to the few frequencies makes the one side of the other."""
        *powers, common = self.few[2]
        return int((np.square(responses) @ powers[side] - 2 * responses @ common).argmin())


def _frames(evidence: Evidence) -> list[_Frame]:
    """The frame in light and, where files have a curve, in what a screen shows; if it has room."""
    a, b = (evidence.scaled(side) for side in evidence.sampled)
    alike_by = np.square((b - a).mean(axis=0)).sum() * len(a)
    if min(evidence.framed[0].shape) < _LEAST or alike_by < _OF_LIGHT * np.square(b - a).sum():
        return []
    return [_Frame(evidence)] + [_Frame(evidence, shown=True)] * (evidence.gamma != 1.0)


def _gauss(f: Any, sigma: float) -> NDArray[Any]:
    return np.asarray(np.exp(-2 * (np.pi * sigma * f) ** 2))


@cache
def _jinc() -> tuple[NDArray[Any], NDArray[Any]]:
    """2 J1(x) / x at places x, by the integral of Bessel (1824)."""
    x, t = np.linspace(0, 80, 4000)[1:], (np.arange(200) + 0.5) * np.pi / 200
    values = 2 * np.cos(t - x[:, None] * np.sin(t)).mean(axis=1) / x
    return np.concatenate([[0.0], x]), np.concatenate([[1.0], values])


def _disc(f: Any, radius: float) -> NDArray[Any]:
    return np.asarray(np.interp(2 * np.pi * radius * f, *_jinc()))


def filtered(evidence: Evidence) -> Iterator[Explanation]:
    """B is A through one filter for all places, or A is B through one; or it has more detail."""
    for frame in evidence.once(_frames):
        (rows, columns, (power, _, common)), far = frame.few, np.hypot(*frame.frequencies)
        for side, (response, sizes, wide) in product(
            (0, 1), ((_disc, _RADII, 1.0), (_gauss, _SIGMAS, 2.0))
        ):
            responses = np.stack([response(far[rows, columns], size) for size in sizes])
            size = float(sizes[frame.most_alike(side, responses)])
            radius = size * wide  # of the disc of the same moments
            if radius > 0.3:
                through = frame.filtered(side, response(far, size))
                left = frame.left(through if side == 0 else sum(frame.sides) - through)
                how = f": everywhere alike, as by a radius of {radius:.2g} px"
                how += " by a gaussian" * (wide != 1)
                yield Explanation(left, ("softer", "sharper")[side], how, {"radius": radius})
        details = 1 - np.stack([_gauss(far[rows, columns], sigma) for sigma in _SIGMAS])
        squares = details**2 @ power
        gains = details @ (common - power) / np.maximum(squares, 1e-300)
        best = int((gains * gains * squares).argmax())
        gain, sigma = float(gains[best]), float(_SIGMAS[best])
        if gain > 0.02:
            a = frame.sides[0]
            how, values = f": detail x {1 + gain:.3g}", {"gain": 1 + gain, "sigma": sigma}
            left = frame.left(a + gain * (a - frame.smooth(0, sigma)))
            yield Explanation(left, "sharper", how, values)
    for frame in evidence.once(_frames)[:1]:
        for predicted in _denoised(frame):
            left = frame.left(predicted)
            yield Explanation(left, "softer", ": smeared as by a denoiser")


def _denoised(frame: _Frame) -> Iterator[NDArray[Any]]:
    """Light of A with medians, or with means of neighbours that are alike."""
    a, b = (frame.evidence.scaled_light(side).astype("f4") for side in frame.sides)
    (height, width), padded = a.shape, np.pad(a, 2, mode="edge")
    beside = np.stack([padded[y : height + y, x : width + x] for y, x in np.ndindex(5, 5)])
    near = [k for k, (y, x) in enumerate(np.ndindex(5, 5)) if 0 < y < 4 and 0 < x < 4]
    details = [np.median(beside[near], axis=0) - a]
    beside -= a
    for alike_by in _ALIKE:
        weights = np.exp(np.square(beside) * (-0.5 / alike_by**2))
        details.append((weights * beside).sum(axis=0) / weights.sum(axis=0))
    for some in (details[:1], details[1:]):
        shares = summed_up(some, b - a, 1.0 * frame.chooses)
        if shares.sum() > 0.2:
            shown = a + sum(s * detail for s, detail in zip(shares, some, strict=True))
            yield frame.evidence.unscaled_light(shown)


def filtered_in_parts(evidence: Evidence) -> Iterator[Explanation]:
    """In each part of the frame B is A blurred, or A is B blurred, by as much as it takes."""
    for frame in evidence.once(_frames)[:1]:
        lefts = []
        for part in _PARTS:
            tried = []
            for one, other in product((0, 1), (0, 1)):
                if one != other:
                    base, aim = frame.sides[one], frame.sides[other]
                    columns = [(frame.smooth(one, s) - base) * frame.slope for s in _WIDTHS]
                    change = _fitted_in_parts(
                        columns, (aim - base) * frame.slope, frame.chooses, part
                    )
                    there = base + change / np.where(frame.slope > 0, frame.slope, 1.0)
                    # Where A is B blurred, what B is predicted to be is wrong by as much as A is.
                    tried.append(there if one == 0 else base + aim - there)
            costs = [
                sums_of_parts(
                    np.square((there - frame.sides[1]) * frame.slope) * frame.chooses, part
                )
                for there in tried
            ]
            better = np.repeat(np.repeat(costs[1] < costs[0], part, axis=0), part, axis=1)
            height, width = tried[0].shape
            lefts.append(frame.left(np.where(better[:height, :width], tried[1], tried[0])))
        details = [np.square(v - frame.smooth(k, 2.0)) for k, v in enumerate(frame.sides)]
        energy = np.square((frame.sides[1] - frame.sides[0]) * frame.slope)
        old, new = (sums_of_parts(detail, 16) for detail in details)
        lost = float(sums_of_parts(energy, 16)[new < old].sum() / max(energy.sum(), 1e-300))
        name, how = ("softer", "") if lost >= 0.5 else ("sharper", "")
        if 1 - _ONE_WAY < lost < _ONE_WAY:
            how = f" in places, {'sharper' if lost >= 0.5 else 'softer'} in others"
        values = {"softer": round(lost, 3), "sharper": round(1 - lost, 3)}
        yield Explanation(min(lefts), name, how, values)


def _fitted_in_parts(
    columns: list[NDArray[Any]], aim: NDArray[Any], chooses: NDArray[np.bool_], side: int
) -> NDArray[Any]:
    """The sum [h, w] of multiples of columns [h, w] that each part of a picture has for itself.

    The multiples are those of least squares at the pixels that choose, with a little of a ridge.
    """
    square = np.stack(
        [[sums_of_parts(one * other * chooses, side) for other in columns] for one in columns]
    )
    sums = np.stack([sums_of_parts(one * aim * chooses, side) for one in columns])
    square, sums = np.moveaxis(square, (0, 1), (-2, -1)), np.moveaxis(sums, 0, -1)
    scale = np.trace(square, axis1=-2, axis2=-1)
    ridge = (1e-3 * scale + 1e-3 * scale.mean() + 1e-30)[..., None, None]
    solved = np.linalg.solve(square + ridge * np.eye(len(columns)), sums[..., None])[..., 0]
    each = np.repeat(np.repeat(solved, side, axis=0), side, axis=1)[: len(aim), : aim.shape[1]]
    return np.asarray(sum(each[..., k] * column for k, column in enumerate(columns)))


def resized(evidence: Evidence) -> Iterator[Explanation]:
    """B is A at another size, enlarged again, by its frequencies or by a grid of its steps."""
    for frame in evidence.once(_frames):
        shown = [evidence.scaled_light(side).astype("f8") for side in evidence.framed]
        sizes: list[tuple[tuple[float, float], _Kernels]] = []
        for factor, least in _ON_GRID.items():
            uneven = [
                [_unevenness(way, factor, n) for n in (1, 3) for way in (side, side.T)]
                for side in shown
            ]
            if max(new - old for old, new in zip(*uneven, strict=True)) >= least:
                high, wide = (side / factor for side in evidence.size)
                sizes += [((high, wide), kernels) for kernels in _RESAMPLED]
        whole = (slice(0, len(shown[0])), slice(0, shown[0].shape[1]))
        for size, kernels in (*sizes, *_sizes(frame)):
            left = frame.left(_through_size(frame, size, kernels, whole))
            share = max(size) / max(evidence.size)
            of = {0.5: "half", 0.25: "a quarter of the"}.get(share, f"{share:.0%} of the")
            how = f": {of} resolution, {_RESAMPLED[kernels]}"
            yield Explanation(left, "lower resolution", how, {"factor": 1 / share})


def _sizes(frame: _Frame) -> list[tuple[tuple[int, int], _Kernels]]:
    """Sizes smaller than that of A, and kernels, by whose response to frequencies it is about B."""
    rows, columns, (power, other, common) = frame.few
    every, whole = float((power + other - 2 * common).sum()), float(other.sum())
    if every <= 0:
        return []
    lags = 2 * np.pi * np.arange(_REACH + 1)
    turns = [2 * np.cos(np.outer(lags, f)) for f in frame.frequencies]

    def best(shares: NDArray[Any], kernels: _Kernels) -> tuple[float, float]:
        """The least that is left of the power of the difference, and the share."""
        weights = np.stack([_weights(float(share), kernels) for share in shares])
        down, across = (weights @ turn for turn in turns)
        through = down[:, rows] * across[:, columns]
        costs = np.square(through) @ power - 2 * through @ common
        return (float(costs.min()) + whole) / every, float(shares[costs.argmin()])

    found = [(*best(_SIZES, kernels), kernels) for kernels in _SMOOTH]
    found.sort(key=lambda each: each[0])
    sizes = []
    for left, share, kernels in found[:_KERNELS]:
        if left < min(_FILTERED, 2 * found[0][0]):
            near = (share + np.linspace(-1, 1, 9) * np.diff(_SIZES)[0]).clip(0.1, 0.995)
            sizes.append((_nearest_size(frame, best(near, kernels)[1], kernels), kernels))
    return sizes


@lru_cache(maxsize=1024)
def _weights(share: float, kernels: _Kernels) -> NDArray[Any]:
    """The mean weights of neighbours at distances of 0, 1, … px, the first halved."""
    at = np.arange(_REACH + 64 + _REACH)
    aim = at[_REACH:-_REACH]
    through = _matrix(at, aim, 1 / share, np.arange(int(len(at) * share)), kernels)
    means = [np.diagonal(through, _REACH + k).mean() for k in range(_REACH + 1)]
    return np.array([means[0] / 2, *means[1:]])


def _nearest_size(frame: _Frame, share: float, kernels: _Kernels) -> tuple[int, int]:
    """The size (rows, columns) near a share of A's at which its pixels are most like B."""
    probe = densest(np.abs(frame.sides[1] - frame.sides[0]), _PROBE)

    def cost(size: tuple[int, int]) -> float:
        made = _through_size(frame, size, kernels, probe)
        return float(np.square(made - frame.sides[1][probe]).sum())

    full = frame.evidence.size
    shares = np.arange(share - _OFF, min(share + _OFF, 1.0), 1 / max(full))
    sizes = [(max(2, round(full[0] * each)), max(2, round(full[1] * each))) for each in shares]
    best = sorted(sizes, key=cost)[:_KEPT]
    # Either side may have been rounded the other way.
    around = product(best, (-1, 0, 1), (-1, 0, 1))
    return min(((high + y, wide + x) for (high, wide), y, x in around), key=cost)


def _through_size(
    frame: _Frame, size: tuple[float, float], kernels: _Kernels, piece: tuple[slice, slice]
) -> NDArray[np.float64]:
    """A piece of A at another size (rows, columns), enlarged again."""
    made = frame.sides[0]
    whole = zip(frame.evidence.frame, frame.evidence.size, size, piece, strict=True)
    for cut, full, small, part in whole:
        ratio = full / small
        reach = math.ceil(4 * ratio) + 4
        used = slice(max(part.start - reach, 0), part.stop + reach)
        at, aim = (np.arange(cut.start, cut.stop)[each] for each in (used, part))
        first, last = int(aim[0] / ratio) - 3, math.ceil(aim[-1] / ratio) + 4
        coarse = np.arange(max(first, 0), min(math.ceil(small), last))
        made = np.moveaxis(_matrix(at, aim, ratio, coarse, kernels) @ made[used], 0, 1)
    return made


def _matrix(
    at: NDArray[Any], aim: NDArray[Any], ratio: float, coarse: NDArray[Any], kernels: _Kernels
) -> NDArray[np.float64]:
    """What pixels ``aim`` are of pixels ``at``, through coarse ones of ``ratio`` px each."""
    down, up = kernels
    wide = down((at - (coarse[:, None] + 0.5) * ratio + 0.5) / ratio)
    back = up((aim[:, None] + 0.5) / ratio - 0.5 - coarse)
    both = [each / np.maximum(each.sum(axis=1, keepdims=True), 1e-9) for each in (back, wide)]
    return np.asarray(both[0] @ both[1])


def _box(t: Any) -> Any:
    return ((t >= -0.5) & (t < 0.5)) * 1.0


def _lanczos(t: Any) -> Any:
    return np.sinc(t) * np.sinc(t / 3) * (np.abs(t) < 3)


def _blackman_harris(t: Any) -> Any:
    """The window of Harris (1978), 3 px wide."""
    terms = (0.35875, 0.48829, 0.14128, 0.01168)
    return sum(v * np.cos(2 * np.pi * k * t / 3) for k, v in enumerate(terms)) * (np.abs(t) < 1.5)


def _point(t: Any) -> Any:
    """Of the lines [n, m] of a grid, the nearest pixel."""
    return (t == np.take_along_axis(t, np.abs(t).argmin(axis=1)[:, None], axis=1)) * 1.0


def _unevenness(values: NDArray[Any], factor: int, order: int) -> float:
    """How much differences of an order of rows [h, w] depend on their place on a grid."""
    squares = np.square(np.diff(values, n=order, axis=0))
    steps = squares.clip(0, np.quantile(squares[::3, ::3], 0.9)).sum(axis=1)
    sums = steps[: len(steps) // factor * factor].reshape(-1, factor).sum(axis=0)
    return float(np.ptp(sums) / max(float(sums.max() + sums.min()), 1e-300))


def keys(t: Any) -> Any:
    """The cubic kernel of Keys (1981), with a = -1/2, at distances in px."""
    t = np.abs(t)
    return np.where(
        t < 1, (1.5 * t - 2.5) * t * t + 1, np.where(t < 2, ((2.5 - t / 2) * t - 4) * t + 2, 0)
    )


def linear(t: Any) -> Any:
    """The kernel of linear interpolation."""
    return np.maximum(1 - np.abs(t), 0)


_RESAMPLED: dict[_Kernels, str] = {
    (_box, _box): "nearest",
    (_point, _box): "nearest",
    (_box, linear): "bilinear",
    (linear, linear): "bilinear",
    (keys, keys): "bicubic",
    (_lanczos, keys): "bicubic",
    (_lanczos, _lanczos): "Lanczos",
    (_blackman_harris, _blackman_harris): "Blackman-Harris",
}
_SMOOTH = [kernels for kernels in _RESAMPLED if kernels[1] is not _box]

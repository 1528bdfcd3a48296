"""Causes that spread light otherwise: another CoC, motion blur, resolution, denoisers, bokeh shape.

All can make a picture softer, so all are rivals, measured at the same pixels in the middle of the
frame. A filter for all places is found by its response to the frequencies of A; in files with a
curve it may have been applied to what a screen shows. Where blur depends on depth, each part of a
picture has a filter of its own: a sum of A through gaussians.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import (
    LOSSY,
    Evidence,
    Explanation,
    blocks_in_turn,
    densest,
    fitted_in_parts,
    steepness,
    summed_up,
    sums_of_parts,
    unexplained,
    unshared,
)
from defocus_core.compare.findings.geometry import keys, linear

_LEAST = 28  # px of a side of a picture whose softness is looked at
_PIECE, _MARGIN = 192, 8  # px of the part that rivals are measured in, and of the border left out
_RADII, _SIGMAS = np.geomspace(0.35, 16, 120), np.geomspace(0.2, 8, 120)  # px
_LENGTHS, _ANGLES = np.geomspace(1.6, 40, 24), np.arange(0, 180, 7.5)  # of a motion: px, degrees
_FEW = 24  # each how many-th frequency is looked at
_WIDTHS = (0.6, 1.2, 2.4, 4.8)  # px of the gaussians of parts
_ALIKE = (0.03, 0.08, 0.2)  # differences of neighbours that a denoiser averages
_SURELY_SPREAD = 0.06  # left where kernels of another size or shape spread the light
_COC_LEFT, _ROUND_LEFT = 0.62, 0.1  # kernels of another shape are explained, too, but not all
# Least unevenness of differences of pixels that half and a quarter of the resolution make.
_ON_GRID = {2: 0.1, 4: 0.4}
_Kernel = Callable[[Any], Any]  # weights by distances
_Kernels = tuple[_Kernel, _Kernel]  # to a smaller size, and back
_SIZES, _REACH = np.linspace(0.2, 0.985, 64), 40  # shares of a size; px that its kernels reach
_FILTERED, _RESIZED_LEFT, _KERNELS = 0.3, 0.3, 3  # left by a filter, by pixels; kernels tried
_OFF, _PROBE = 0.06, 64  # share by which a size is looked for; px of the part that finds it
_KEPT = 6  # sizes of which either side is looked for
_COARSE = 4  # px of the coarse pixels of bloom
_GLOWS = (1, 1.5, 2.2, 3.3, 5, 7, 10)  # coarse px of its gaussians
_SOURCES = 24  # parts of a frame that have a gain of their own
_SPREAD = 12.0  # px of the gaussian within which another bokeh shape keeps the light
_ONE_WAY = 0.85  # share of blurred blocks that makes a picture blurred more, or less
_TIED = 0.35  # least correlation of a difference with the detail of a side that it is of
_COC, _EITHER = "another CoC", "another CoC or bokeh shape"
_OF_LIGHT = 0.3  # least share of the power of a difference that channels share
_UNLIKE_NEIGHBOURS = 0.3  # greatest correlation of noise with itself one pixel on


@dataclass(frozen=True, eq=False)
class Softened:
    """The frame of a pair, what models of softness leave of it, and its frequencies."""

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
    def piece(self) -> tuple[slice, slice]:
        """The rows and columns of the frame that are measured."""
        a, b = self.sides
        cuts = [
            slice(max(cut.start, _MARGIN), min(cut.stop, length - _MARGIN))
            for cut, length in zip(densest(np.abs(b - a), _PIECE), a.shape, strict=True)
        ]
        return cuts[0], cuts[1]

    @cached_property
    def chooses(self) -> NDArray[np.bool_]:
        """Pixels [h, w] that choose parameters; the others measure."""
        return blocks_in_turn(self.sides[0].shape, 4)

    @cached_property
    def slope(self) -> NDArray[Any]:
        """The slope of the scale of differences, 0 near clipped pixels."""
        light = np.maximum(*map(np.abs, self.sides))
        step = np.maximum(light * 1e-3, 1e-5)
        high, low = (self.evidence.scaled_light(light + s).astype("f8") for s in (step, -step))
        return np.where(self.evidence.clipped_near, 0.0, (high - low) / (2 * step))

    def left(self, predicted: NDArray[Any]) -> float:
        """What is left where it is measured if B were as predicted."""
        light = self.evidence.unscaled_light(predicted) if self.shown else predicted
        light = light if self.evidence.gamma == 1.0 else light.clip(0.0, 1.0)
        noise = _softened(self.evidence).noise
        return self.evidence.left_framed(light, self.measures, noise)

    @cached_property
    def measures(self) -> NDArray[np.bool_]:
        """Pixels [h, w] that are measured."""
        where = np.zeros(self.sides[0].shape, bool)
        where[self.piece] = ~self.chooses[self.piece]
        return where

    @cached_property
    def noise(self) -> float:
        """The power of noise that no model explains: what the freest of them leave at least."""
        free = [*self.in_parts, *(predicted for predicted, _, _ in self.denoised)]
        pairs = (self.evidence.framed_pairs(each, self.measures)[2] for each in free)
        return min(LOSSY, *(unshared(*rest) for rest in pairs))

    @cached_property
    def in_parts(self) -> list[NDArray[Any]]:
        """B as A blurred, or as A is B blurred, in each part by as much as it takes."""
        predicted = []
        for side in (0, 1):
            details = [self.smooth(side, sigma) - self.sides[side] for sigma in _WIDTHS]
            predicted += [self.fitted(side, details, part) for part in (16, 32)]
        return predicted

    @cached_property
    def left_in_parts(self) -> float:
        """What is left if B were blurred by as much as each part takes."""
        return min(map(self.left, self.in_parts))

    def fitted(self, side: int, details: list[NDArray[Any]], part: int) -> NDArray[Any]:
        """B as one side, with multiples of details in each part, makes the other."""
        one, other = self.sides[side], self.sides[1 - side]
        columns = [detail * self.slope for detail in details]
        change = fitted_in_parts(columns, (other - one) * self.slope, self.chooses, part)
        there = one + change / np.where(self.slope > 0, self.slope, 1.0)
        # Where A is B blurred, what B is predicted to be is wrong by as much as A is.
        return there if side == 0 else one + other - there

    @cached_property
    def denoised(self) -> list[tuple[NDArray[Any], float, int]]:
        """B as A with medians, or with means of neighbours that are alike: strength, parameters."""
        rows, columns = self.piece
        wide = (slice(rows.start - 2, rows.stop + 2), slice(columns.start - 2, columns.stop + 2))
        a, b = (self.evidence.scaled_light(side[wide]).astype("f4") for side in self.sides)
        (height, width), inner = a.shape, a[2:-2, 2:-2]
        beside = np.stack([a[y : height - 4 + y, x : width - 4 + x] for y, x in np.ndindex(5, 5)])
        apart = np.square(beside - inner)
        near = [k for k, (y, x) in enumerate(np.ndindex(5, 5)) if 0 < y < 4 and 0 < x < 4]
        details = [np.median(beside[near], axis=0) - inner]
        for alike_by in _ALIKE:
            weights = np.exp(apart * (-0.5 / alike_by**2))
            details.append((weights * (beside - inner)).sum(axis=0) / weights.sum(axis=0))
        chooses, aim, found = self.chooses[self.piece], b[2:-2, 2:-2] - inner, []
        for some in (details[:1], details[1:]):
            shares = summed_up(some, aim, 1.0 * chooses)
            shown = inner + sum(s * detail for s, detail in zip(shares, some, strict=True))
            predicted = self.sides[0].copy()
            predicted[self.piece] = self.evidence.unscaled_light(shown)
            found.append((predicted, float(shares.sum()), len(some)))
        return found

    @cached_property
    def spectra(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Powers of A and of B and what they have in common, [h, w / 2 + 1]."""
        window = np.sqrt(np.outer(*(np.hanning(n + 2)[1:-1] for n in self.sides[0].shape)))
        a, b = (np.fft.rfft2((side - side.mean()) * window) for side in self.sides)
        return np.abs(a) ** 2, np.abs(b) ** 2, (np.conj(a) * b).real

    @cached_property
    def frequencies(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Of rows and columns, in cycles a pixel."""
        height, width = self.sides[0].shape
        return np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :]

    @cached_property
    def few(self) -> tuple[NDArray[Any], NDArray[Any], tuple[NDArray[Any], ...]]:
        """Rows and columns of some of the frequencies, and the spectra there."""
        places = np.arange(self.spectra[0].size)[1::_FEW]
        rows, columns = np.divmod(places, self.spectra[0].shape[1])
        return rows, columns, tuple(each.ravel()[places] for each in self.spectra)

    def filtered(self, side: int, response: NDArray[Any]) -> NDArray[Any]:
        """A or B through a filter, around at the borders."""
        size = self.sides[side].shape
        return np.asarray(np.fft.irfft2(self.transformed[side] * response, s=size))

    @cached_property
    def transformed(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """The transforms of A and B."""
        a, b = map(np.fft.rfft2, self.sides)
        return a, b

    def smooth(self, side: int, sigma: float, axes: tuple[int, ...] = (0, 1)) -> NDArray[Any]:
        """A or B through a gaussian along axes."""
        square = sum(np.square(self.frequencies[axis]) for axis in axes)
        return self.filtered(side, _gauss(np.sqrt(square), sigma))

    def most_alike(self, side: int, responses: NDArray[Any]) -> int:
        """Which of responses [K, N] to the few frequencies makes the one side of the other."""
        *powers, common = self.few[2]
        return int((np.square(responses) @ powers[side] - 2 * responses @ common).argmin())


@lru_cache(maxsize=1)
def _softened(evidence: Evidence) -> Softened:
    return Softened(evidence)


def _gauss(f: Any, sigma: float) -> NDArray[Any]:
    return np.asarray(np.exp(-2 * (np.pi * sigma * f) ** 2))


@lru_cache(maxsize=1)
def _jinc() -> tuple[NDArray[Any], NDArray[Any]]:
    """2 J1(x) / x at places x, by the integral of Bessel (1824)."""
    x, t = np.linspace(0, 80, 4000)[1:], (np.arange(200) + 0.5) * np.pi / 200
    values = 2 * np.cos(t - x[:, None] * np.sin(t)).mean(axis=1) / x
    return np.concatenate([[0.0], x]), np.concatenate([[1.0], values])


def _disc(f: Any, radius: float) -> NDArray[Any]:
    return np.asarray(np.interp(2 * np.pi * radius * f, *_jinc()))


def has_room(evidence: Evidence) -> bool:
    """Whether a frame holds light that differs, and not its colour alone, and room for filters."""
    if not evidence.pixels.color or min(evidence.framed[0].shape) < _LEAST:
        return False
    a, b = (evidence.scaled(side) for side in evidence.sampled)
    alike_by = np.square((b - a).mean(axis=0)).sum() * len(a)
    return bool(alike_by >= _OF_LIGHT * np.square(b - a).sum())


def is_large(evidence: Evidence) -> bool:
    """Whether a frame has room for filters, and its difference is no noise beside the light."""
    return has_room(evidence) and white_noise(evidence) in ("", "noise removed")


@lru_cache(maxsize=1)
def white_noise(evidence: Evidence) -> str:
    """What noise of the frame is that has nothing in common with its neighbours; empty if none."""
    a, b = (evidence.scaled_light(side).astype("f8") for side in evidence.framed)
    difference = b - a
    if not noise_like(difference):
        return ""
    of_a, of_b = (alike(difference, side - smooth(side, 1.5)[0]) for side in (a, b))
    if abs(of_a + of_b) < 0.1 < of_b:
        return "noise in another pattern"
    if abs(of_a) <= _TIED:
        return "noise"
    if of_a < 0 and abs(of_b) <= _TIED:
        return "noise removed"
    return ""


@lru_cache(maxsize=1)
def _frames(evidence: Evidence) -> list[Softened]:
    """The frame in light and, where files have a curve, in what a screen shows."""
    shown = [] if evidence.gamma == 1.0 else [Softened(evidence, shown=True)]
    return [_softened(evidence), *shown]


def blurred_alike(evidence: Evidence) -> Iterator[Explanation]:
    """B is A through a disc or a gaussian for all places, or the reverse."""
    for frame, (side, way), (response, sizes, wide) in product(
        _frames(evidence),
        ((0, "more"), (1, "less")),
        ((_disc, _RADII, 1.0), (_gauss, _SIGMAS, 2.0)),
    ):
        (rows, columns, _), far = frame.few, np.hypot(*frame.frequencies)
        responses = np.stack([response(far[rows, columns], size) for size in sizes])
        size = float(sizes[frame.most_alike(side, responses)])
        radius = size * wide  # of the disc of the same moments
        if radius > 0.3:
            how = f": blurred {way}, everywhere alike, as by a radius of {radius:.2g} px"
            how += " by a gaussian" * (wide != 1)
            cost = 0.02 + 0.02 * side
            through = frame.filtered(side, response(far, size))
            left = frame.left(through if side == 0 else sum(frame.sides) - through)
            yield Explanation(left, _COC, how, {"radius": radius}, cost)


def sharpened(evidence: Evidence) -> Iterator[Explanation]:
    """B is A, and a multiple of its detail."""
    for frame in _frames(evidence):
        rows, columns, (power, _, common) = frame.few
        far = np.hypot(*frame.frequencies)[rows, columns]
        details = 1 - np.stack([_gauss(far, sigma) for sigma in _SIGMAS])
        squares = details**2 @ power
        gains = details @ (common - power) / np.maximum(squares, 1e-300)
        best = int((gains * gains * squares).argmax())
        gain, sigma = float(gains[best]), float(_SIGMAS[best])
        if gain > 0.02:
            a = frame.sides[0]
            predicted = a + gain * (a - frame.smooth(0, sigma))
            how, values = f": detail x {1 + gain:.3g}", {"gain": 1 + gain, "sigma": sigma}
            yield Explanation(frame.left(predicted), "sharpened", how, values, 0.02)


def motion_blurred(evidence: Evidence) -> Iterator[Explanation]:
    """B is A through a line for all places."""
    frame = _softened(evidence)
    rows, columns, _ = frame.few
    few = frame.frequencies[0][rows, 0], frame.frequencies[1][0, columns]

    def line(f: tuple[Any, Any], length: float, angle: float) -> NDArray[Any]:
        turned = math.radians(angle)
        return np.asarray(np.sinc(length * (f[1] * math.cos(turned) - f[0] * math.sin(turned))))

    lengths, angles, length, angle = _LENGTHS, _ANGLES, 1.0, 0.0
    for _ in range(2):
        tried = [*product(lengths, angles)]
        length, angle = tried[frame.most_alike(0, np.stack([line(few, *each) for each in tried]))]
        lengths, angles = length * np.linspace(0.9, 1.1, 9), angle + np.arange(-6, 7, 2.0)
    if length > 1.8:
        how = f": {length:.2g} px at {angle % 180:.0f}°"
        values = {"length": float(length), "angle": float(angle % 180)}
        left = frame.left(frame.filtered(0, line(frame.frequencies, length, angle)))
        yield Explanation(left, "motion blur", how, values, 0.03)


def resized(evidence: Evidence) -> Iterator[Explanation]:
    """B is A at another size, enlarged again, by its frequencies or by a grid of its steps."""
    cut = _softened(evidence).piece
    shown = [evidence.scaled_light(side[cut]).astype("f8") for side in evidence.framed]
    on_grid = []
    for factor, least in _ON_GRID.items():
        uneven = [
            [_unevenness(way, factor, n) for n in (1, 3) for way in (side, side.T)]
            for side in shown
        ]
        if max(new - old for old, new in zip(*uneven, strict=True)) >= least:
            high, wide = (side / factor for side in evidence.size)
            on_grid += [((high, wide), kernels, 0.01 * factor - 0.2) for kernels in _RESAMPLED]
    for frame in _frames(evidence):
        for size, kernels, cost in (*on_grid, *((*each, 0.0) for each in _sizes(frame))):
            predicted = frame.sides[0].copy()
            predicted[frame.piece] = _through_size(frame, size, kernels, frame.piece)
            left = frame.left(predicted)
            if cost or left < _RESIZED_LEFT:
                share = max(size) / max(evidence.size)
                of = {0.5: "half", 0.25: "a quarter of the"}.get(share, f"{share:.0%} of the")
                how, values = f": {of} resolution, {_RESAMPLED[kernels]}", {"factor": 1 / share}
                yield Explanation(left, "lower resolution", how, values, cost)


def _sizes(frame: Softened) -> list[tuple[tuple[int, int], _Kernels]]:
    """Sizes smaller than that of A, and kernels, by whose response to frequencies it is about B."""
    rows, columns, (power, other, common) = frame.few
    every, whole = float((power + other - 2 * common).sum()), float(other.sum())
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


def _nearest_size(frame: Softened, share: float, kernels: _Kernels) -> tuple[int, int]:
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
    frame: Softened, size: tuple[float, float], kernels: _Kernels, piece: tuple[slice, slice]
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


def bloom(evidence: Evidence) -> Iterator[Explanation]:
    """B is A, and some of its brightest light once more, spread far.

    It is looked at in coarse pixels, where little rounding is left. What a file with bounds shows
    as white may be any light: there each part of the frame has a gain of its own.
    """
    a, b = evidence.framed
    steady = ~(evidence.at("b", *evidence.frame) > 0.996).any(axis=0) | (evidence.gamma == 1.0)
    slope = steepness(a) * steady
    coarse = partial(sums_of_parts, side=_COARSE)
    added, weights = coarse((b - a) * slope) / _COARSE**2, coarse(slope) / _COARSE**4
    if added.sum() < 0.7 * np.abs(added).sum():
        return
    turn = blocks_in_turn(added.shape, 4)
    plain = weights, coarse(a * slope)  # raised blacks, another exposure
    solved = summed_up(plain, added, turn)
    by_plain = float(np.square((added - np.tensordot(solved, plain, 1))[turn]).sum())
    found: tuple[float, Any, float, float] = (0.5 * by_plain, None, 0.0, 0.0)
    for quantile in (0.0, 0.9, 0.98):
        bright = coarse(np.maximum(a - np.quantile(a, quantile) * (quantile > 0), 0.0))
        for parts in (1, _SOURCES) if evidence.gamma != 1.0 and quantile else (1,):
            glows = [smooth(each, *_GLOWS) for each in _brightest(bright, parts)]
            for sigma, *own in zip(_GLOWS, *glows, strict=True):
                design = [glow * weights for glow in own]
                gains = summed_up(design, added, turn).clip(0)
                glow = np.tensordot(gains, design, 1)
                cost = float(np.square((added - glow)[turn]).sum()) * (1 + 0.02 * len(own))
                found = min(found, (cost, glow, float(gains[0]), sigma), key=lambda each: each[0])
    _, glow, gain, wide = found
    if gain <= 0:
        return
    both = ~turn[:, :-1] & ~turn[:, 1:]
    whole, rest = ((v[:, :-1][both], v[:, 1:][both]) for v in (added, added - glow))
    left = unexplained(whole, rest, evidence.step / _COARSE, evidence.lossy / _COARSE**2)
    how = f": {gain:.2g} of the light spread by {wide * _COARSE:.0f} px"
    values = {"gain": gain, "sigma": wide * _COARSE}
    yield Explanation(left, "bloom", how, values, 0.02)


def _brightest(bright: NDArray[Any], count: int) -> list[NDArray[Any]]:
    """Bright light [h, w], or of each of so many parts of the frame: those that hold most of it."""
    if count == 1:
        return [bright]
    rows, columns = (np.arange(length) // 8 for length in bright.shape)
    part = rows[:, None] * (columns[-1] + 1) + columns
    held = np.bincount(part.ravel(), bright.ravel())
    return [np.where(part == k, bright, 0) for k in np.argsort(-held)[:count]]


def denoised(evidence: Evidence) -> Iterator[Explanation]:
    """B is A with means of neighbours that are alike in the place of each pixel, or medians."""
    frame = _softened(evidence)
    for predicted, strength, count in frame.denoised:
        if strength > 0.2:
            left, how = frame.left(predicted), ": smeared as by a denoiser"
            yield Explanation(left, "noise removed", how, {"strength": strength}, 0.02 * count)


def blurred_in_parts(evidence: Evidence) -> Iterator[Explanation]:
    """B is A blurred, or A is B blurred, in each part by as much as it takes."""
    left = _softened(evidence).left_in_parts
    if left <= _COC_LEFT:
        values, how = _ways(evidence)
        name = _COC if left <= _ROUND_LEFT else _EITHER
        yield Explanation(left, name, f": {how}", values, 0.08)


def motion_in_parts(evidence: Evidence) -> Iterator[Explanation]:
    """B is A through lines, along an axis, in each part by as much as it takes."""
    frame = _softened(evidence)
    for axis, way in ((1, "across"), (0, "down")):
        details = [frame.smooth(0, sigma, (axis,)) - frame.sides[0] for sigma in _WIDTHS[1:]]
        left = frame.left(frame.fitted(0, details, 32))
        if left < frame.left_in_parts - 0.1:
            yield Explanation(left, "motion blur", f": {way}, in parts", cost=0.1)


@lru_cache(maxsize=1)
def _ways(evidence: Evidence) -> tuple[dict[str, float], str]:
    """Where B is blurred more, and where less: where its light has less detail, and where more."""
    frame = _softened(evidence)
    energy = np.square((frame.sides[1] - frame.sides[0]) * frame.slope)
    details = [np.square(v - frame.smooth(k, 2.0)) for k, v in enumerate(frame.sides)]
    old, new = (smooth(detail, 6.0)[0] for detail in details)
    more, less = (float(energy[where].sum()) for where in (new < old, new > old))
    share = more / max(more + less, 1e-300)
    shares = {"blurred_more": round(share, 3), "blurred_less": round(1 - share, 3)}
    text = "blurred more in places, less in others"
    if share > _ONE_WAY:
        text = "blurred more"
    elif share < 1 - _ONE_WAY:
        text = "blurred less"
    return shares, text


def spread(evidence: Evidence) -> Iterator[Explanation]:
    """The same light is spread otherwise within a few pixels, by whatever kernel."""
    frame = _softened(evidence)
    difference = frame.sides[1] - frame.sides[0]
    if not difference.any() or noise_like(difference * frame.slope):
        return
    # Light that only moved cancels within the reach of the gaussian.
    (scale,) = smooth(frame.slope, _SPREAD)
    kept, moved = (smooth(d, _SPREAD)[0] * scale for d in (difference, np.abs(difference)))
    left = math.sqrt(float(np.square(kept).sum()) / max(float(np.square(moved).sum()), 1e-300))
    values, how = _ways(evidence)
    surely = left < _SURELY_SPREAD and "in places" not in how
    name = _EITHER if surely else "spread otherwise"
    yield Explanation(left, name, f": the same light, {how}", values)


def noise_like(difference: NDArray[Any]) -> bool:
    """Whether neighbours of a difference [h, w] have little in common."""
    pairs = (difference[1:], difference[:-1]), (difference[:, 1:], difference[:, :-1])
    return all(abs(alike(*pair)) < _UNLIKE_NEIGHBOURS for pair in pairs)


def alike(x: NDArray[Any], y: NDArray[Any]) -> float:
    """Correlation of two arrays, 0 if one is constant or empty."""
    if not x.size:
        return 0.0
    x, y = x - x.mean(), y - y.mean()
    # Not np.vdot: its threads wait for each other where several processes compare.
    scale = math.sqrt(float(np.square(x).sum()) * float(np.square(y).sum()))
    return float((x * y).sum()) / scale if scale else 0.0


def smooth(values: NDArray[Any], *sigmas: float) -> list[NDArray[Any]]:
    """Values [h, w] through gaussians, mirrored at the borders."""
    height, width = values.shape
    reach = min(math.ceil(3 * max(sigmas)), height - 1, width - 1)
    # Sides of multiples of 32 are transformed much faster.
    padded = np.pad(
        values, [(reach, reach + -(n + 2 * reach) % 32) for n in values.shape], "reflect"
    )
    rows, columns = np.fft.fftfreq(len(padded)), np.fft.rfftfreq(padded.shape[1])
    far, there = np.hypot(rows[:, None], columns), np.fft.rfft2(padded)
    cut = (slice(reach, reach + height), slice(reach, reach + width))
    return [np.fft.irfft2(there * _gauss(far, s), s=padded.shape)[cut] for s in sigmas]

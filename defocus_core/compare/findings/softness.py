"""Causes that make a picture softer or sharper: filters, a smaller size, local blurs.

A filter is found by its frequency response. All filters are applied to, and measured in, the mean
light of the channels in the frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import (
    Evidence,
    Explanation,
    blocks_in_turn,
    steepness,
    summed_up,
    sums_of_parts,
)

_LEAST, _MARGIN = 28, 8  # px on a side of the analysed part, and of its border that is ignored
_FEW = 24  # step of the analysed frequencies
_RADII, _PIXELS = np.geomspace(0.35, 16, 80), np.geomspace(1.015, 6, 80)  # px
_OFF, _PROBE, _KEPT = 0.06, 64, 4  # step of the search for a size; its px; candidates kept
_NEAR = 0.8  # residual at few frequencies, above which a size is not searched
_WIDTHS, _PARTS = (1.2, 2.4, 4.8, 9.6), (16, 32)  # px of gaussians of parts; px on a side of parts
_BLOCKS = (2, 4, 8)  # px on a side of repeated pixels
_ALIKE = (0.03, 0.08, 0.2)  # differences of neighbours that a denoiser averages
_OF_LIGHT = 0.3  # least share of the power of a difference that channels share
_ONE_WAY = 0.85  # share of a difference at lost detail, above which a picture is softer
_SIMPLER = ("softer", "sharper", "lower resolution", "shifted", "scaled")
_Kernel = Callable[[Any], Any]  # weights by distances, in units of its size


def _disc(t: Any) -> Any:
    return np.sqrt(np.maximum(1 - t * t, 0))  # from its side


def _gauss(t: Any) -> Any:
    return np.exp(-2 * t * t)  # with the moments of a disc of radius 1


def _box(t: Any) -> Any:
    return ((t >= -0.5) & (t < 0.5)) * 1.0


def _linear(t: Any) -> Any:
    return np.maximum(1 - np.abs(t), 0)


def keys(t: Any) -> Any:
    """The cubic kernel of Keys (1981), with a = -1/2, at distances in px."""
    t = np.abs(t)
    return np.where(
        t < 1, (1.5 * t - 2.5) * t * t + 1, np.where(t < 2, ((2.5 - t / 2) * t - 4) * t + 2, 0)
    )


def _lanczos(t: Any) -> Any:
    return np.sinc(t) * np.sinc(t / 3) * (np.abs(t) < 3)


def _blackman_harris(t: Any) -> Any:
    terms = (0.35875, 0.48829, 0.14128, 0.01168)  # the window of Harris (1978), 3 px wide
    return sum(v * np.cos(2 * np.pi * k * t / 3) for k, v in enumerate(terms)) * (np.abs(t) < 1.5)


@cache
def _transform(kernel: _Kernel) -> tuple[NDArray[Any], NDArray[Any]]:
    """Frequencies, and the response of a kernel to them."""
    t, f = np.linspace(-4, 4, 801), np.linspace(0, 10, 600)
    values = np.cos(2 * np.pi * f[:, None] * t) @ kernel(t)
    return f, values / values[0]


@dataclass(frozen=True)
class _Filter:
    """A filter of any size: a radial kernel, or separable ones that reduce and enlarge."""

    how: str
    kernels: tuple[_Kernel, ...]

    @property
    def resizes(self) -> bool:
        return len(self.kernels) == 2

    def response(self, rows: NDArray[Any], columns: NDArray[Any], size: float) -> NDArray[Any]:
        """The response at frequencies in cycles per pixel."""
        ways = (np.abs(rows), np.abs(columns)) if self.resizes else (np.hypot(rows, columns),)
        total: Any = 1.0
        for way, kernel in product(ways, self.kernels):
            total = total * np.interp(way * size, *_transform(kernel))
        return np.asarray(total)


_GAUSSIAN = _Filter(" by a gaussian", (_gauss,))
_FILTERS = (
    _Filter("", (_disc,)),
    _GAUSSIAN,
    _Filter("bilinear", (_box, _linear)),
    _Filter("bilinear", (_linear, _linear)),
    _Filter("bicubic", (keys, keys)),
    _Filter("Lanczos", (_lanczos, _lanczos)),
    _Filter("Blackman-Harris", (_blackman_harris, _blackman_harris)),
)


@dataclass(frozen=True, eq=False)
class _Frame:
    """The light of the frame of a pair, and its frequencies."""

    evidence: Evidence

    @cached_property
    def chooses(self) -> NDArray[np.bool_]:
        """Mask [h, w] of pixels that choose parameters; the others measure."""
        return blocks_in_turn(self.evidence.framed[0].shape, 4)

    def left(self, predicted: NDArray[Any]) -> float:
        """The residual of a prediction of B at the measuring pixels."""
        light = predicted if self.evidence.gamma == 1.0 else predicted.clip(0.0, 1.0)
        measures = ~self.chooses
        for rim in (slice(_MARGIN), slice(-_MARGIN, None)):
            measures[rim] = measures[:, rim] = False
        return self.evidence.left_framed(light, measures)

    @cached_property
    def frequencies(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Frequencies of rows and columns, in cycles per pixel."""
        height, width = self.evidence.framed[0].shape
        return np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :]

    @cached_property
    def few(self) -> tuple[tuple[NDArray[Any], NDArray[Any]], tuple[NDArray[Any], ...]]:
        """Some frequencies, with the powers of A and B and their cross power."""
        sides = self.evidence.framed
        window = np.sqrt(np.outer(*(np.hanning(n + 2)[1:-1] for n in sides[0].shape)))
        a, b = (np.fft.rfft2((side - side.mean()) * window) for side in sides)
        every = (np.abs(a) ** 2, np.abs(b) ** 2, (np.conj(a) * b).real)
        places = np.arange(a.size)[1::_FEW]
        at = np.divmod(places, a.shape[1])
        rows, columns = (f.ravel()[k] for f, k in zip(self.frequencies, at, strict=True))
        return (rows, columns), tuple(each.ravel()[places] for each in every)

    @cached_property
    def transformed(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """The transforms of A and B."""
        a, b = map(np.fft.rfft2, self.evidence.framed)
        return a, b

    def filtered(self, side: int, row: _Filter, size: float) -> NDArray[Any]:
        """A or B after a filter, periodic at the borders."""
        response = row.response(*self.frequencies, size)
        shape = self.evidence.framed[0].shape
        return np.asarray(np.fft.irfft2(self.transformed[side] * response, s=shape))


def softened(evidence: Evidence) -> Iterator[Explanation]:
    """B is a filtered A, or A a filtered B, also in parts; or B has more detail."""
    a, b = (evidence.scaled(side) for side in evidence.sampled)
    alike_by = np.square((b - a).mean(axis=0)).sum() * len(a)
    if min(evidence.framed[0].shape) >= _LEAST and alike_by >= _OF_LIGHT * np.square(b - a).sum():
        frame = _Frame(evidence)
        yield from _filtered(frame)
        yield from _resized(frame)
        yield from _denoised(frame)
        yield _filtered_in_parts(frame)


def _fitted(frame: _Frame, row: _Filter, sizes: NDArray[Any], side: int = 0) -> tuple[float, float]:
    """The size of a filter with the best match of the filtered side, and the residual."""
    few, (*powers, common) = frame.few
    every = float((powers[0] + powers[1] - 2 * common).sum())
    for _ in range(2):
        through = np.stack([row.response(*few, size) for size in sizes])
        costs = np.square(through) @ powers[side] - 2 * through @ common
        size = float(sizes[costs.argmin()])
        sizes = size * (sizes[1] / sizes[0]) ** np.linspace(-1, 1, 9)
    left = max(float(costs.min() + powers[1 - side].sum()), 0.0) / max(every, 1e-300)
    return size, math.sqrt(left)


def _filtered(frame: _Frame) -> Iterator[Explanation]:
    """B is A after one filter everywhere, or the reverse."""
    for row, side in product(_FILTERS[:2], (0, 1)):
        size, _ = _fitted(frame, row, _RADII, side)
        through = frame.filtered(side, row, size)
        left = frame.left(through if side == 0 else sum(frame.evidence.framed) - through)
        how = f": everywhere alike, as by a radius of {size:.2g} px{row.how}"
        yield Explanation(left, ("softer", "sharper")[side], how, {"radius": size})


def _resized(frame: _Frame) -> Iterator[Explanation]:
    """B is A reduced and enlarged again, or has blocks with one pixel or the mean of A."""
    (height, width), (a, b) = frame.evidence.size, frame.evidence.framed
    made: list[tuple[float, str, NDArray[Any]]] = []
    found = [(*_fitted(frame, row, _PIXELS), row) for row in _FILTERS if row.resizes]
    near = [each for each in found if each[1] < _NEAR]
    for factor, _, row in sorted(near, key=lambda each: each[1])[:3]:
        probe = tuple(slice(max(n - _PROBE, 0) // 2, (n + _PROBE) // 2) for n in a.shape)

        def cost(size: tuple[int, int], row: _Filter = row, cut: Any = probe) -> float:
            return float(np.square(_through_size(frame, size, row, cut) - b[cut]).sum())

        reach = max(4, round(_OFF * width / factor))
        wide = range(max(2, round(width / factor) - reach), round(width / factor) + reach)
        sizes = sorted(((max(2, round(height * n / width)), n) for n in wide), key=cost)
        size = min(((n + k, m) for n, m in sizes[:_KEPT] for k in (-1, 0, 1)), key=cost)
        whole = tuple(slice(0, n) for n in a.shape)
        made.append((width / size[1], row.how, _through_size(frame, size, row, whole)))
    for side in _BLOCKS:
        high, wide = (n // side for n in a.shape)
        cut, middle = (slice(high * side), slice(wide * side)), side // 2
        blocks = a[cut].reshape(high, side, wide, side)
        for values in (blocks.mean((1, 3)), blocks[:, 0, :, 0], blocks[:, middle, :, middle]):
            there = b.copy()
            there[cut] = np.kron(values, np.ones((side, side)))
            made.append((side, "nearest", there))
    for factor, how, there in made:
        of = {2.0: "half", 4.0: "a quarter of the"}.get(factor, f"{1 / factor:.0%} of the")
        said, values = f": {of} resolution, {how}", {"factor": factor}
        yield Explanation(frame.left(there), "lower resolution", said, values, beyond=("softer",))


def _through_size(
    frame: _Frame, size: tuple[int, int], row: _Filter, part: tuple[slice, ...]
) -> NDArray[Any]:
    """A part of the frame of A, reduced to (rows, columns) and enlarged again."""
    made, (down, up) = frame.evidence.framed[0], row.kernels
    for cut, full, small, each in zip(
        frame.evidence.frame, frame.evidence.size, size, part, strict=True
    ):
        ratio = full / small
        reach = math.ceil(4 * ratio) + 4
        used = slice(max(each.start - reach, 0), each.stop + reach)
        at, aim = (np.arange(cut.start, cut.stop)[k] for k in (used, each))
        coarse = np.arange(max(int(aim[0] / ratio) - 3, 0), min(small, int(aim[-1] / ratio) + 5))
        wide = down((at - (coarse[:, None] + 0.5) * ratio + 0.5) / ratio)
        back = up((aim[:, None] + 0.5) / ratio - 0.5 - coarse)
        back, wide = (v / np.maximum(v.sum(axis=1, keepdims=True), 1e-9) for v in (back, wide))
        made = np.moveaxis(back @ (wide @ made[used]), 0, 1)
    return made


def _denoised(frame: _Frame) -> Iterator[Explanation]:
    """B is A with medians, or with means of similar neighbours."""
    a, b = (frame.evidence.scaled_light(side).astype("f4") for side in frame.evidence.framed)
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
            left = frame.left(frame.evidence.unscaled_light(shown))
            yield Explanation(left, "softer", ": smeared as by a denoiser")


def _filtered_in_parts(frame: _Frame) -> Explanation:
    """B is A blurred, or A is B blurred, by a different amount in each part of the frame.

    Each part has a sum of gaussians, by least squares at the choosing pixels.
    """
    a, b = frame.evidence.framed
    slope = np.where(frame.evidence.clipped_near, 0.0, steepness(np.maximum(*map(np.abs, (a, b)))))
    details = [np.square(v - frame.filtered(k, _GAUSSIAN, 4.0)) for k, v in enumerate((a, b))]
    old, new = (sums_of_parts(detail, _PARTS[0]) for detail in details)
    softer = _spread(new < old, _PARTS[0], a)
    smooth = [[frame.filtered(k, _GAUSSIAN, s) for s in _WIDTHS] for k in (0, 1)]
    columns = [np.where(softer, x - a, b - y) * slope for x, y in zip(*smooth, strict=True)]
    lefts, aim = [], (b - a) * slope
    for part in _PARTS:
        products = [[x * y * frame.chooses for x in columns] for y in (*columns, aim)]
        sums = np.array([[sums_of_parts(x, part) for x in row] for row in products])
        square, sums = np.moveaxis(sums[:-1], (0, 1), (-2, -1)), np.moveaxis(sums[-1], 0, -1)
        scale = np.trace(square, axis1=-2, axis2=-1)
        ridge = (1e-3 * (scale + scale.mean()) + 1e-30)[..., None, None] * np.eye(len(columns))
        solved = np.linalg.solve(square + ridge, sums[..., None])[..., 0]
        change = sum(_spread(solved[..., k], part, a) * x for k, x in enumerate(columns))
        lefts.append(frame.left(a + change / np.where(slope > 0, slope, 1.0)))
    energy = np.square(aim)
    lost = float(energy[softer].sum() / max(energy.sum(), 1e-300))
    name, how = ("softer", "") if lost >= 0.5 else ("sharper", "")
    if 1 - _ONE_WAY < lost < _ONE_WAY:
        how = f" in places, {'sharper' if lost >= 0.5 else 'softer'} in others"
    values = {"softer": round(lost, 3), "sharper": round(1 - lost, 3)}
    return Explanation(min(lefts), name, how, values, beyond=_SIMPLER)


def _spread(values: NDArray[Any], part: int, like: NDArray[Any]) -> NDArray[Any]:
    """Values of parts at all pixels."""
    every = np.repeat(np.repeat(values, part, axis=0), part, axis=1)
    return every[: like.shape[0], : like.shape[1]]

"""Causes that make a picture softer or sharper: filters, a smaller size, local blurs.

All filters are applied to the mean of the channels in the frame, of light or of stored values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache, cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import (
    Evidence,
    Explanation,
    block_sums,
    blocks_in_turn,
    steepness,
)
from defocus_core.compare.selection import widened

_Plane = NDArray[np.float64]  # [h, w]
_Kernel = Callable[[Any], Any]  # weights by distances, in units of its size
_Way = tuple[tuple[int, int], tuple[_Kernel, _Kernel]]  # rows and columns; filters
_LEAST, _MARGIN = 28, 8  # px on a side of the frame, and of its border that is ignored
_SIGMAS, _SIDE = (0.6, 1.2, 2.4, 4.8), 16  # px of gaussians; px on a side of blocks
_RINGS = 48  # frequencies of a response
_SMOOTH = 0.06  # cycles per px down, below which rows show the response across
_FACTORS = np.geomspace(1.03, 6, 200)  # of size
_REACH, _PROBE = 16, 64  # sizes beside an estimate; px on a side of the part that tells most
_TRIED, _NEAR = 4, 0.64  # pairs of filters that are tried; their residual by response
_BLOCKS = (2, 4, 8)  # px on a side of repeated pixels
_OF_LIGHT = 0.3  # least share of the power of a difference that channels share
_ONE_WAY = 0.85  # share of a difference at lost detail, above which a picture is softer
_COHERENT = 0.1  # least correlation of a sharper picture's difference with the detail of A


def keys(t: Any) -> Any:
    """The cubic kernel of Keys (1981), with a = -1/2, at distances in px."""
    t = np.abs(t)
    return np.where(
        t < 1, (1.5 * t - 2.5) * t * t + 1, np.where(t < 2, ((2.5 - t / 2) * t - 4) * t + 2, 0)
    )


def _box(t: Any) -> Any:
    return ((t >= -0.5) & (t < 0.5)) * 1.0


def _linear(t: Any) -> Any:
    return np.maximum(1 - np.abs(t), 0)


def _lanczos(t: Any) -> Any:
    return np.sinc(t) * np.sinc(t / 3) * (np.abs(t) < 3)


def _blackman_harris(t: Any) -> Any:
    terms = (0.35875, 0.48829, 0.14128, 0.01168)  # the window of Harris (1978), 3 px wide
    return sum(v * np.cos(2 * np.pi * k * t / 3) for k, v in enumerate(terms)) * (np.abs(t) < 1.5)


def _first(t: Any) -> Any:
    return (t == np.min(t, axis=-1, keepdims=True, where=t >= -0.5, initial=1)) * 1.0


def _middle(t: Any) -> Any:
    return (t == np.min(t, axis=-1, keepdims=True, where=t >= 0, initial=1)) * 1.0


# Separable filters: one reduces, one enlarges.
_FILTERS: dict[_Kernel, str] = {
    _box: "nearest",
    _linear: "bilinear",
    keys: "bicubic",
    _lanczos: "Lanczos",
    _blackman_harris: "Blackman-Harris",
}


@cache
def _response(kernel: _Kernel) -> tuple[NDArray[Any], NDArray[Any]]:
    """Frequencies in cycles per px, and the response of a kernel to each."""
    t, f = np.linspace(-4, 4, 801), np.linspace(0, 3, 300)
    values = np.cos(2 * np.pi * f[:, None] * t) @ kernel(t)
    return f, values / values[0]


class _Frame:
    """The mean [h, w] of the channels of A and of B in the frame of a pair.

    It is the mean of linear light, or of stored values.

    Attributes:
        sides: A and B.
        shown: the same on the scale of `Evidence.scaled`.
        steady: mask [h, w] of pixels with none nearby that may be clipped by an integer type.
        chooses: mask [h, w] of pixels to which models are fitted; residuals are of the others.
    """

    def __init__(self, evidence: Evidence, *, is_light: bool) -> None:
        self.evidence, self.is_light = evidence, is_light
        stored = [evidence.values_at(side, *evidence.frame) for side in "ab"]
        self.sides = [
            (evidence.light(v) if is_light else v.astype("f8")).mean(axis=0) for v in stored
        ]
        self.shown = [*map(self.scaled, self.sides)]
        clipped = np.logical_or(
            *((v > 0.996).any(axis=0) & (not evidence.is_linear) for v in stored)
        )
        self.steady, self.chooses = ~widened(clipped, _MARGIN), blocks_in_turn(clipped.shape, 4)

    def scaled(self, values: _Plane) -> _Plane:
        """Values of the frame on the scale of `Evidence.scaled`."""
        return self.evidence.scaled_light(values) if self.is_light else values

    @cached_property
    def slope(self) -> _Plane:
        """Slope [h, w] of `scaled` at the values, 0 where light may be clipped."""
        steep = steepness(np.maximum(*map(np.abs, self.sides))) if self.is_light else 1.0
        return np.where(self.steady, steep, 0.0)

    @cached_property
    def spectra(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """The spectra of A and of B, after a Hann window fades out their borders."""
        window = np.sqrt(np.outer(*(np.hanning(n + 2)[1:-1] for n in self.steady.shape)))
        a, b = (np.fft.rfft2((side - side.mean()) * window) for side in self.sides)
        return a, b

    @cached_property
    def squares(self) -> NDArray[Any]:
        """The squared frequencies of a spectrum, in cycles per px."""
        height, width = self.steady.shape
        return np.asarray(np.fft.fftfreq(height)[:, None] ** 2 + np.fft.rfftfreq(width) ** 2)

    @cached_property
    def filtered(self) -> tuple[float, _Plane]:
        """The squared residual as a share of the squared difference, and A after a filter.

        The filter is isotropic, and fitted so that A becomes B.
        """
        old, new = self.spectra
        radii = np.sqrt(self.squares) * 2 * _RINGS
        rings = np.minimum(radii, _RINGS).astype(int).ravel()
        products = np.abs(old) ** 2, (old.conj() * new).real
        power, common = (np.bincount(rings, v.ravel(), _RINGS + 1) for v in products)
        shares = common / np.maximum(power, 1e-300)
        shares /= max(shares[0], 1e-3)  # the mean is kept
        response = np.interp(radii - 0.5, np.arange(_RINGS + 1), shares)
        rest = float((np.abs(new - response * old) ** 2).sum())
        there = np.fft.irfft2(response * np.fft.rfft2(self.sides[0]), s=self.sides[0].shape)
        return rest / max(float((np.abs(new - old) ** 2).sum()), 1e-300), there

    @cached_property
    def smooth(self) -> list[list[_Plane]]:
        """A and B, each blurred by every gaussian of `_SIGMAS`, periodic at the borders."""
        bells = [np.exp(-2 * (np.pi * sigma) ** 2 * self.squares) for sigma in _SIGMAS]
        spectra, size = map(np.fft.rfft2, self.sides), self.steady.shape
        return [[np.fft.irfft2(s * bell, s=size) for bell in bells] for s in spectra]

    @cached_property
    def measures(self) -> NDArray[np.bool_]:
        """Mask [h, w] of the pixels over which residuals are summed."""
        used = ~self.chooses & self.steady
        for rim in (slice(_MARGIN), slice(-_MARGIN, None)):
            used[rim] = used[:, rim] = False
        return used

    @property
    def is_sharper(self) -> bool:
        """Whether B - A correlates with the detail of A, as noise does not."""
        (a, b), used = self.sides, self.measures
        change, detail = (b - a)[used], (a - self.smooth[0][2])[used]
        both = np.square(change).sum() * np.square(detail).sum()
        return bool((change * detail).sum() > _COHERENT * np.sqrt(both))

    def explain(self, there: _Plane, name: str, how: str, **values: float) -> Explanation:
        """The explanation that a prediction of B in the frame gives."""
        there = there if self.evidence.gamma == 1.0 else there.clip(0.0, 1.0)
        (a, b), used = self.shown, self.measures
        left, every = (np.square((v - b)[used]).sum() for v in (self.scaled(there), a))
        return Explanation(math.sqrt(left / every) if every else math.inf, name, how, values)


def softened(evidence: Evidence) -> Iterator[Explanation]:
    """B is a filtered A, A a filtered B, or each in some places; or B has lower resolution."""
    a, b = (evidence.scaled(side) for side in evidence.sampled)
    alike_by = np.square((b - a).mean(axis=0)).sum() * len(a)
    sides = [cut.stop - cut.start for cut in evidence.frame]
    if min(sides) < _LEAST or alike_by < _OF_LIGHT * np.square(b - a).sum():
        return
    frames = [_Frame(evidence, is_light=light) for light in {True, evidence.is_linear}]
    frame = min(frames, key=lambda each: each.filtered[0])  # programs filter light or codes
    yield from _filtered_in_blocks(frame)
    if not all(name.endswith("A") for name in evidence.names):  # soft edges tell no size
        yield _resized(frame)


def _resized(frame: _Frame) -> Explanation:
    """B is A reduced and enlarged again; reduced by a filter or by leaving pixels out."""
    (height, width), (a, b) = frame.evidence.size, frame.shown
    inner = (slice(_MARGIN, -_MARGIN),) * 2
    parts = block_sums((np.square(b - a) * frame.steady)[inner], _PROBE)
    most = np.unravel_index(int(parts.argmax()), parts.shape)  # the part that tells most
    firsts = [int(k) * _PROBE + _MARGIN for k in most]
    ends = zip(firsts, b.shape, strict=True)
    probe = tuple(slice(k, min(k + _PROBE, n - _MARGIN)) for k, n in ends)

    def cost(way: _Way) -> float:
        there = frame.scaled(_through_size(frame, *way, probe))
        return float(np.square(there - b[probe]).sum())

    ways: list[_Way] = [
        ((round(height / side), round(width / side)), (down, up))
        for side, down in product(_BLOCKS, (*_FILTERS, _first, _middle))
        for up in (_FILTERS if side == 2 else [_box])
    ]
    for factor, kernels in _factors(frame):
        near = [round(width / factor) + k for k in range(-_REACH, _REACH)]
        sizes = [(round(height * n / width), n) for n in near if 1 < n <= width / _FACTORS[0]]
        rows, columns = min(sizes, key=lambda size: cost((size, kernels)))
        ways += [((rows + k, columns), kernels) for k in (-1, 0, 1)]
    size, kernels = min(ways, key=cost)
    factor = width / size[1]
    of = {2.0: "half", 4.0: "a quarter of the"}.get(factor, f"{1 / factor:.0%} of the")
    how = f": {of} resolution, {_FILTERS[kernels[1]]}"
    there = _through_size(frame, size, kernels, tuple(slice(0, n) for n in b.shape))
    return frame.explain(there, "lower resolution", how, factor=factor)


def _factors(frame: _Frame) -> list[tuple[float, tuple[_Kernel, _Kernel]]]:
    """Factors of reduction with pairs of filters (down, up) that make about B of A, best first."""
    rows = np.abs(np.fft.fftfreq(len(frame.steady))) < _SMOOTH
    old, new = (spectrum[rows] for spectrum in frame.spectra)
    power, common = (np.abs(old) ** 2).sum(axis=0), (old.conj() * new).real.sum(axis=0)
    every, whole = float((np.abs(old - new) ** 2).sum()), float((np.abs(new) ** 2).sum())
    frequencies = np.fft.rfftfreq(frame.sides[0].shape[1]) * _FACTORS[:, None]
    across = {kernel: np.interp(frequencies, *_response(kernel)) for kernel in _FILTERS}
    found = []
    for kernels in product(_FILTERS, [*_FILTERS][1:]):
        both = across[kernels[0]] * across[kernels[1]]
        costs = np.square(both) @ power - 2 * both @ common
        found.append((float(costs.min()) + whole, float(_FACTORS[costs.argmin()]), kernels))
    near = sorted((each for each in found if each[0] < _NEAR * every), key=lambda each: each[0])
    return [(factor, kernels) for _, factor, kernels in near[:_TRIED]]


def _through_size(
    frame: _Frame, size: tuple[int, int], kernels: Sequence[_Kernel], within: tuple[slice, ...]
) -> _Plane:
    """A rectangle of the frame of A, which is reduced to (rows, columns) and enlarged again."""
    made, (down, up) = frame.sides[0], kernels
    for cut, full, small, each in zip(
        frame.evidence.frame, frame.evidence.size, size, within, strict=True
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
    return np.asarray(made)


def _filtered_in_blocks(frame: _Frame) -> Iterator[Explanation]:
    """B is a blurred A, or A is a blurred B, by a different amount in each block.

    The blur of a block is a sum of gaussians, by least squares at the pixels of `chooses`.
    """
    (a, b), slope, smooth = frame.sides, frame.slope, frame.smooth
    old, new = (
        block_sums(np.square(v - s[2]), _SIDE) for v, s in zip(frame.sides, smooth, strict=True)
    )
    softer = _filled(new < old, a)
    columns = [np.where(softer, x - a, b - y) * slope for x, y in zip(*smooth, strict=True)]
    aim = (b - a) * slope
    energy = np.square(aim)
    lost = float(energy[softer].sum() / max(energy.sum(), 1e-300))
    if lost < 0.5 and not frame.is_sharper:
        return
    products = [[x * y * frame.chooses for x in columns] for y in (*columns, aim)]
    sums = np.array([[block_sums(x, _SIDE) for x in row] for row in products])
    square, sums = np.moveaxis(sums[:-1], (0, 1), (-2, -1)), np.moveaxis(sums[-1], 0, -1)
    scale = np.trace(square, axis1=-2, axis2=-1)
    ridge = (1e-3 * (scale + scale.mean()) + 1e-30)[..., None, None] * np.eye(len(columns))
    solved = np.linalg.solve(square + ridge, sums[..., None])[..., 0]
    change = sum(_filled(solved[..., k], a) * x for k, x in enumerate(columns))
    spread = float((block_sums(energy, _SIDE) * (solved @ np.square(_SIGMAS))).sum())
    radius = 2 * math.sqrt(abs(spread) / max(float(energy.sum()), 1e-300))
    names = ("softer", "sharper") if lost >= 0.5 else ("sharper", "softer")
    two_ways = 1 - _ONE_WAY < lost < _ONE_WAY
    how = f" in places, {names[1]} in others" if two_ways else f" by about {radius:.2g} px"
    values = {"softer": round(lost, 3), "sharper": round(1 - lost, 3), "radius": radius}
    ways = a + change / np.where(slope > 0, slope, 1.0), frame.filtered[1]
    fits = [frame.explain(there, names[0], how, **values) for there in ways]
    yield min(fits, key=lambda fit: fit.left)


def _filled(values: NDArray[Any], like: NDArray[Any]) -> NDArray[Any]:
    """A map of the size of `like`, where all pixels of a block have the value of the block."""
    every = np.repeat(np.repeat(values, _SIDE, axis=0), _SIDE, axis=1)
    return every[: like.shape[0], : like.shape[1]]

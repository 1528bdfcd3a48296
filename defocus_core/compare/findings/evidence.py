"""Sampled pixels of a pair, on which explanations of a difference are tested.

An explanation predicts B from A. Its parameters are chosen in every other block of 16 px, and its
residual is measured in the rest. The scale of differences is sRGB up to 1 and logarithmic beyond,
so that a few highlights do not decide. Rounding errors are subtracted only by `explained`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.table import Finding
from defocus_core.compare.metrics import unclipped
from defocus_core.compare.pixels import Pixels
from defocus_core.io.images.color_space import srgb_to_linear

_SAMPLES = 8_000  # number of sampled pairs of neighbours
_FEW = 2048  # pixels of a picture
_FRAME = 448  # px on a side of the part that is analysed as a whole
_LARGE = 0.5  # difference beyond which the weight of a pixel does not grow
_BLOCK = 16  # px of alternating blocks: one chooses parameters, the next measures
_LARGEST = 1e30  # greatest value: beyond it, arithmetic in float32 overflows
_PART_OF = 0.6  # greatest share of a picture in the rectangle of a patch
_SMOOTH = 0.1  # least share of a difference that neighbours have in common
_LESS = 0.98  # greatest residual of a model beside noise
_SLIGHT = 2.5  # RMS of a difference by that of rounding, below which there is nothing to explain
# RMS rounding error of number types on the scale of `scaled`: absolute, and relative.
_ROUNDING = {"uint8": (0.41 / 255, 0.0), "uint16": (0.41 / 65535, 0.0), "half": (0.0, 4e-4)}
_FLOAT = (0.0, 1e-6)


@dataclass(frozen=True)
class Explanation:
    """A cause with its best parameters."""

    left: float  # residual as a share of the RMS difference
    name: str  # of the finding
    how: str = ""  # words after the name in the finding
    values: Mapping[str, Any] = field(default_factory=dict)  # parameters, for programs
    # residual in what neighbours have in common, which leaves noise out
    but_noise: float = math.inf

    @property
    def finding(self) -> Finding:
        """The finding of this explanation."""
        return Finding(self.name, self.name + self.how, self.values)


class Evidence:
    """The samples of a pair, for explanations.

    Attributes:
        names: the channels that differ.
        types: number types of B.
        others: channels of files beside A of which B may be a copy, by the name of the finding.
        codecs: compression of the files of A and of B.
        is_light: whether a channel that differs is colour.
        is_small: whether there are so few pixels that explaining half of them may be chance.
    """

    def __init__(
        self,
        pixels: Pixels,
        types: Mapping[str, str],
        others: Mapping[str, Mapping[str, NDArray[Any]]],
        codecs: tuple[str, str] = ("", ""),
    ) -> None:
        self.pixels, self.others, self.codecs = pixels, others, codecs
        self.names = tuple(n for n, most in pixels.differences.largest.items() if most)
        self.size, self.gamma = pixels.shape, pixels.gamma
        self.is_small = math.prod(self.size) < _FEW
        self.types = {types[name] for name in self.names}
        self.is_light = any(name in layer for layer in pixels.color for name in self.names)

    @cached_property
    def places(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns [N] of the samples; half of the samples lie where A and B differ.

        In a small picture all pixels are samples. Sample N/2 + k is the neighbour of sample k.
        """
        greatest = self.pixels.greatest.ravel()
        every = np.arange(greatest.size) if greatest.size <= _SAMPLES else None
        if every is None:
            drawn = np.random.default_rng(0).integers(greatest.size, size=(16, _SAMPLES // 2))
            differ = drawn[greatest[drawn] > 0][: _SAMPLES // 2]
            if differ.size < _SAMPLES // 2:  # as few differ
                differ = np.resize(np.flatnonzero(greatest), _SAMPLES // 2)
            every = np.concatenate([differ, drawn[-1]])
        rows, columns = np.unravel_index(every, self.size)
        beside = np.where(columns + 1 < self.size[1], columns + 1, columns - 1).clip(0)
        return np.tile(rows, 2), np.concatenate([columns, beside])

    @cached_property
    def weights(self) -> NDArray[np.float64]:
        """The weight of each sample [N], as pixels that differ are sampled more densely."""
        differs = self.pixels.greatest[self.places] > 0
        share, there = float((self.pixels.greatest > 0).mean()), float(differs.mean())
        weights = np.where(differs, share / max(there, 1e-9), (1 - share) / max(1 - there, 1e-9))
        ok = self.pixels.finite
        return weights if ok is None else weights * ok[self.places]

    @cached_property
    def fits(self) -> NDArray[np.bool_]:
        """Mask [N] of the samples to which models are fitted; the others give residuals."""
        rows, columns = (places // _BLOCK for places in self.places)
        return np.asarray((rows + columns) % 2 == 0)

    @cached_property
    def sampled(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Values of A and of B [C, N] at the samples."""
        return self.values_at("a", *self.places), self.values_at("b", *self.places)

    @cached_property
    def steady(self) -> NDArray[np.bool_]:
        """Mask [C, N] of the samples of A that are not clipped by an integer type."""
        a = self.sampled[0]
        return np.ones(a.shape, bool) if self.is_linear else (a > 0.004) & (a < 0.996)

    def values_at(self, side: str, rows: Any, columns: Any, names: Sequence[str] = ()) -> Any:
        """Values [C, N] of side ``a`` or ``b`` at rows and columns, 0 where not finite."""
        planes = [self.pixels.plane(side, name)[rows, columns] for name in names or self.names]
        values = np.stack(planes).astype(np.float32).clip(-_LARGEST, _LARGEST)
        return values if self.pixels.finite is None else np.nan_to_num(values)

    @property
    def is_linear(self) -> bool:
        """Whether values are linear light, or not light at all."""
        return self.gamma == 1.0 or not self.pixels.color

    def scaled(self, values: NDArray[Any]) -> NDArray[Any]:
        """Stored values on the scale on which differences are measured.

        Colour is sRGB-encoded up to 1 and logarithmic beyond. Other linear numbers have the scale
        arcsinh.
        """
        return self.scaled_light(values) if self.is_linear else values

    def scaled_light(self, light: NDArray[Any]) -> NDArray[Any]:
        """Linear light, or other linear numbers, on the scale of `scaled`."""
        return unclipped(light) if self.pixels.color else np.arcsinh(light)

    def unscaled(self, values: NDArray[Any]) -> NDArray[Any]:
        """Stored values from values on the scale of `scaled`; its inverse."""
        if not self.is_linear:
            return values
        if not self.pixels.color:
            return np.asarray(np.sinh(values))
        size = np.abs(values)
        beyond = np.exp(np.clip(size - 1.0, 0.0, 300.0) * (2.4 / 1.055))
        magnitude = np.where(size > 1.0, beyond, srgb_to_linear(np.minimum(size, 1.0)))
        return np.asarray(np.copysign(magnitude, values))

    def light(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Stored values as linear light."""
        if self.gamma == 1.0:
            return values.astype(np.float64)
        positive = np.maximum(values, 0.0).astype(np.float64)
        return np.asarray(srgb_to_linear(positive) if self.gamma is None else positive**self.gamma)

    def stored(self, light: NDArray[Any]) -> NDArray[np.float32]:
        """Stored values from linear light."""
        if self.gamma == 1.0:
            return light.astype(np.float32)
        shown: NDArray[np.float32] = np.clip(light, 0.0, 1.0).astype(np.float32)
        return unclipped(shown) if self.gamma is None else shown ** np.float32(1 / self.gamma)

    @cached_property
    def rounding(self) -> float:
        """RMS rounding error of the number type of B, on the scale of `scaled`."""
        level = float(np.sqrt(np.square(self._aim[0]).mean()))
        steps = (_ROUNDING.get(kind, _FLOAT) for kind in self.types)
        return max((step + share * level for step, share in steps), default=0.0)

    @cached_property
    def rms(self) -> float:
        """RMS difference of the samples where A and B differ, on the scale of `scaled`."""
        differs = self.pixels.greatest[self.places] > 0
        return float(np.sqrt(np.square(self._aim[1][:, differs]).mean())) if differs.any() else 0.0

    @property
    def is_slight(self) -> bool:
        """Whether the difference is as small as rounding errors, with nothing to explain."""
        return self.rms < _SLIGHT * self.rounding

    def explained(self, left: float) -> float:
        """The share of the RMS difference that is explained, except for rounding.

        `left`: RMS residual as a share of the RMS difference.
        """
        forgiven = (self.rounding / self.rms) ** 2 if self.rms else 0.0
        return 1 - math.sqrt(max(left * left - forgiven, 0.0))

    @cached_property
    def _aim(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """B, and B − A, at the samples [C, N], on the scale of `scaled`."""
        a, b = (self.scaled(side) for side in self.sampled)
        return b, b - a

    def explain(
        self,
        predicted: NDArray[Any],
        name: str,
        how: str = "",
        values: Mapping[str, Any] | None = None,
        *,
        where: NDArray[np.bool_] | None = None,
        follows_rounding: bool = False,
    ) -> Explanation:
        """The explanation that a prediction [C, N] of B at the samples gives.

        `where`: samples [N] or [C, N] at which there is a prediction; None for all.
        `follows_rounding`: whether the model may have learnt how values were rounded.
        """
        used = self.weights * (~self.fits if where is None else ~self.fits & where)
        used = np.broadcast_to(used, predicted.shape)
        left = but_noise = math.inf
        if np.count_nonzero(used) >= max(8, used.size // 20):
            aim, whole = self._aim
            rest = self.scaled(predicted.astype(np.float32)) - aim
            power, rest_power = (float((used * v * v).sum()) for v in (whole, rest))
            rest_power += follows_rounding * float(used.sum()) * self.rounding**2
            left = math.sqrt(rest_power / power) if power else math.inf
            common, rest_common = (_common(used, v) for v in (whole, rest))
            contrast = float((used * np.square(aim - aim.mean())).sum())
            if common > _SMOOTH * power / 2 and left < _LESS and rest_power < contrast / 4:
                but_noise = math.sqrt(abs(rest_common) / common)
        return Explanation(left, name, how, values or {}, but_noise)

    @cached_property
    def difference(self) -> NDArray[Any]:
        """The mean [H, W] of the channels of B − A, on the scale of `scaled`."""
        total = np.zeros(self.size, np.float32)
        for rows in self.pixels.strips():
            for name in self.names:
                a, b = (self.scaled(self.pixels.plane(s, name)[rows]) for s in ("a", "b"))
                total[rows] += (b - a) / np.float32(len(self.names))
        total[self.pixels.greatest == 0] = 0.0
        return total

    @cached_property
    def window(self) -> tuple[int, int, int, int]:
        """First row and column that differ, and the row and column after the last, in px."""
        rows, columns = (np.flatnonzero((self.pixels.greatest > 0).any(axis=k)) for k in (1, 0))
        return int(rows[0]), int(columns[0]), int(rows[-1]) + 1, int(columns[-1]) + 1

    @cached_property
    def is_patch(self) -> bool:
        """Whether the rectangle of all differences is small, and most pixels in it differ."""
        top, left, bottom, right = self.window
        within = (bottom - top) * (right - left)
        differing = np.count_nonzero(self.pixels.greatest)
        return bool(within <= _PART_OF * math.prod(self.size) and differing > within / 2)

    @cached_property
    def frame(self) -> tuple[slice, slice]:
        """Rows and columns of a rectangle in the middle of the difference, analysed pixel by pixel.

        It begins at the corner of a block.
        """
        power, ends = np.minimum(self.pixels.greatest, _LARGE), []
        for axis, length in enumerate(self.size):
            total = power.sum(axis=1 - axis).cumsum()
            middle = int(np.searchsorted(total, total[-1] / 2))
            first = max(min(middle - _FRAME // 2, length - _FRAME), 0) // _BLOCK * _BLOCK
            ends.append(slice(first, min(first + _FRAME, length)))
        return ends[0], ends[1]

    @cached_property
    def framed(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """A and B [C, h, w] in the rectangle `frame`, on the scale of `scaled`."""
        a, b = (self.scaled(self.values_at(side, *self.frame)) for side in "ab")
        return a, b


def _common(weights: NDArray[Any], values: NDArray[Any]) -> float:
    """The weighted sum of products of neighbours: sample k times sample N/2 + k of [C, N]."""
    first, second = np.split(values, 2, axis=1)
    return float((np.sqrt(np.prod(np.split(weights, 2, axis=1), axis=0)) * first * second).sum())


def steepness(light: NDArray[Any]) -> NDArray[Any]:
    """The approximate slope of `Evidence.scaled_light` at values of linear light."""
    magnitude = np.maximum(np.abs(light), 0.003)
    return np.asarray(magnitude ** np.where(magnitude < 1.0, 1 / 2.4 - 1, -1.0))


def blocks_in_turn(size: tuple[int, int], side: int = _BLOCK) -> NDArray[np.bool_]:
    """Mask [H, W] of every other block, as on a chessboard; `side` px is the side of a block."""
    rows, columns = (np.arange(length) // side % 2 == 0 for length in size)
    return np.asarray(rows[:, None] == columns)


def block_sums(values: NDArray[Any], side: int) -> NDArray[Any]:
    """Sums [h, w] of values [H, W] over blocks with sides of ``side`` px."""
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], side), axis=0)
    return np.add.reduceat(rows, np.arange(0, values.shape[1], side), axis=1)


def summed_up(
    columns: Sequence[NDArray[Any]], aim: NDArray[Any], weights: NDArray[Any]
) -> NDArray[Any]:
    """The factor of each column with which their sum fits an aim, by weighted least squares."""
    design = np.stack([(column * weights).ravel() for column in columns])
    square, sums = design @ design.T, design @ (aim * weights).ravel()
    square[np.diag_indices(len(columns))] *= 1 + 1e-12
    return np.asarray(np.linalg.lstsq(square, sums, rcond=None)[0])

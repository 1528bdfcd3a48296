"""Sampled pixels of a pair, on which explanations of a difference are tested.

An explanation predicts B from A, rounded like the file of B. Its residual is measured at pixels
that did not choose its parameters: blocks of 16 px alternate. The scale is sRGB up to 1 and
logarithmic beyond, so that a few highlights do not decide. Rounding is subtracted only in the share
that is explained.
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
from defocus_core.compare.selection import widened
from defocus_core.io.images.color_space import srgb_to_linear

_SAMPLES = 12_000  # number of sampled pixels
_FEW = 2048  # pixels of a picture, below which explaining half of them may be chance
_FRAME = 448  # px on a side of the part that is analysed as a whole
_LARGE = 0.5  # difference beyond which the weight of a pixel does not grow
_GRID = 16  # the corner of the frame is a multiple of these px, so that blocks are whole
_BLOCK = 16  # px of alternating blocks: one chooses parameters, the next measures
_LARGEST = 1e30  # greatest value: beyond it, arithmetic in float32 overflows
_PART_OF = 0.6  # greatest share of a picture in a rectangle
LOSSY_CODECS = frozenset({"DWAA", "DWAB", "B44", "B44A"})
# RMS rounding error of number types on the scale of differences: absolute, and relative.
_ROUNDING = {"uint8": (0.41 / 255, 0.0), "uint16": (0.41 / 65535, 0.0), "half": (0.0, 4e-4)}
_FLOAT = (0.0, 1e-6)


@dataclass(frozen=True)
class Explanation:
    """A cause with its best parameters."""

    left: float  # residual as a share of the RMS difference
    name: str  # of the finding
    how: str = ""  # words after the name in the finding
    values: Mapping[str, Any] = field(default_factory=dict)  # parameters, for programs
    text: str = ""  # the words, if they do not begin with the name
    beyond: tuple[str, ...] = ()  # as of its row in the table of causes, as the largest that
    limit: float = 0.0  # it may leave

    @property
    def finding(self) -> Finding:
        """The finding of this explanation."""
        return Finding(self.name, self.text or self.name + self.how, self.values)


class Evidence:
    """The samples of a pair, for explanations.

    Attributes:
        names: the channels that differ.
        gamma: as of `Pixels`.
        types: number types of B.
        others: channels of files beside that of A, by the finding that B is one of these.
        codecs: compression of the files of A and of B.
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
        self.is_small = pixels.a[0].size < _FEW
        self.names = tuple(n for n, most in pixels.differences.largest.items() if most)
        self.gamma = pixels.gamma
        self.types = {types[name] for name in self.names}

    @property
    def size(self) -> tuple[int, int]:
        """(height, width)."""
        return self.pixels.shape

    @cached_property
    def places(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns of the samples: half of them where A and B differ, if that is enough."""
        finite = self.pixels.finite
        ok = np.ones(self.size, bool) if finite is None else finite
        if np.count_nonzero(ok) <= _SAMPLES:
            every = np.flatnonzero(ok)
        else:
            generator = np.random.default_rng(0)
            chosen = _drawn(generator, (self.pixels.greatest > 0) & ok, _SAMPLES // 2)
            every = np.concatenate([chosen, _drawn(generator, ok, _SAMPLES - len(chosen))])
        rows, columns = np.unravel_index(every, self.size)
        return rows, columns

    @cached_property
    def weights(self) -> NDArray[np.float64]:
        """Pixels per sample [N], since differing ones are sampled more densely."""
        differs = self.pixels.greatest[self.places] > 0
        share, there = float((self.pixels.greatest > 0).mean()), float(differs.mean())
        return np.where(differs, share / max(there, 1e-9), (1 - share) / max(1 - there, 1e-9))

    @cached_property
    def fits(self) -> NDArray[np.bool_]:
        """Mask [N] of the samples that choose parameters; the others measure."""
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
        return np.ones(a.shape, bool) if self._is_linear else (a > 0.004) & (a < 0.996)

    def values_at(self, side: str, rows: Any, columns: Any, names: Sequence[str] = ()) -> Any:
        """Values [C, N] of side ``a`` or ``b`` at some places, 0 where a pixel is not finite."""
        planes = [self.pixels.plane(side, name)[rows, columns] for name in names or self.names]
        values = np.stack(planes).astype(np.float32).clip(-_LARGEST, _LARGEST)
        return values if self.pixels.finite is None else np.nan_to_num(values)

    @property
    def _is_linear(self) -> bool:
        """Whether values are linear light, or not light at all."""
        return self.gamma == 1.0 or not self.pixels.color

    def scaled(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values on the scale of differences."""
        return self.scaled_light(values) if self._is_linear else values

    def scaled_light(self, light: NDArray[Any]) -> NDArray[Any]:
        """Linear light on the scale of differences."""
        return unclipped(light) if self.pixels.color else np.arcsinh(light)

    def unscaled(self, values: NDArray[Any]) -> NDArray[Any]:
        """Stored values from those on the scale of differences."""
        return self.unscaled_light(values) if self._is_linear else values

    def unscaled_light(self, values: NDArray[Any]) -> NDArray[Any]:
        """Linear light from values on the scale of differences."""
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
        if self.gamma is None:
            return srgb_to_linear(np.maximum(values, 0.0))
        return np.asarray(np.maximum(values, 0.0).astype(np.float64) ** self.gamma)

    def stored(self, light: NDArray[Any]) -> NDArray[np.float32]:
        """Stored values from linear light."""
        if self.gamma == 1.0:
            return light.astype(np.float32)
        shown: NDArray[np.float32] = np.clip(light, 0.0, 1.0).astype(np.float32)
        return unclipped(shown) if self.gamma is None else shown ** np.float32(1 / self.gamma)

    def rounded(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Stored values, rounded to the steps of the file of B."""
        if "half" in self.types or "float16" in self.types:
            return values.clip(-65504, 65504).astype(np.float16).astype(np.float32)
        top = {"uint8": 255, "uint16": 65535}.get(min(self.types, default=""), 0)
        if not top or self._is_linear:
            return values.astype(np.float32)
        return np.asarray(np.rint(values.clip(0, 1) * top) / np.float32(top), np.float32)

    @cached_property
    def rounding(self) -> float:
        """RMS rounding error of the number type of B, on the scale of differences."""
        values = self.scaled(self.sampled[1])
        level = math.sqrt(float(np.square(values).mean())) if values.size else 0.0
        steps = (_ROUNDING.get(kind, _FLOAT) for kind in self.types)
        return max((step + share * level for step, share in steps), default=0.0)

    @cached_property
    def rms(self) -> float:
        """RMS difference where A and B differ, on the scale of differences."""
        _, whole = self._aim
        differs = self.pixels.greatest[self.places] > 0
        power = np.square(whole[:, differs]).mean() if differs.any() else 0.0
        return math.sqrt(float(power))

    def explained(self, left: float) -> float:
        """The explained share of a difference for a residual, without rounding errors."""
        forgiven = (self.rounding / self.rms) ** 2 if self.rms else 0.0
        return 1 - math.sqrt(max(left * left - forgiven, 0.0))

    @cached_property
    def _aim(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """B, and B − A, on the scale of differences."""
        a, b = (self.scaled(side) for side in self.sampled)
        return b, b - a

    def left(self, predicted: NDArray[Any], where: NDArray[np.bool_] | None = None) -> float:
        """The residual of a prediction of B at the samples [C, N], as a share of the difference.

        `where`: samples [N] or [C, N] at which there is a prediction; None for all.
        """
        aim, whole = self._aim
        used = ~self.fits if where is None else ~self.fits & where
        weights = self.weights * used
        if np.count_nonzero(weights) < max(8, weights.size // 20):
            return math.inf
        every = float((weights * np.square(whole)).sum())
        rest = self.scaled(self.rounded(predicted)) - aim
        return math.sqrt(float((weights * np.square(rest)).sum()) / every) if every else math.inf

    @cached_property
    def difference(self) -> NDArray[Any]:
        """B − A on the scale of differences, the mean of the channels, of all pixels [H, W]."""
        total = np.zeros(self.size, np.float32)
        for rows in self.pixels.strips():
            for name in self.names:
                a, b = (self.scaled(self.pixels.plane(s, name)[rows]) for s in ("a", "b"))
                total[rows] += (b - a) / np.float32(len(self.names))
        total[self.pixels.greatest == 0] = 0.0
        return total

    @cached_property
    def window(self) -> tuple[int, int, int, int]:
        """The first row and column that differ, and those after the last."""
        rows, columns = (np.flatnonzero((self.pixels.greatest > 0).any(axis=k)) for k in (1, 0))
        return int(rows[0]), int(columns[0]), int(rows[-1]) + 1, int(columns[-1]) + 1

    @cached_property
    def is_rectangle(self) -> bool:
        """Whether the difference is a rectangle within the picture, whose rims differ as well."""
        changed, (top, left, bottom, right) = self.pixels.greatest > 0, self.window
        within, (height, width) = changed[top:bottom, left:right], self.size
        if within.size > _PART_OF * changed.size or min(within.shape) < 4:
            return False
        rims = (within[:4], within[-4:], within[:, :4], within[:, -4:])
        inside = (top > 0, bottom < height, left > 0, right < width)
        least = min(float(rim.mean()) for rim, counts in zip(rims, inside, strict=True) if counts)
        return least > 0.5 * float(within.mean()) > 0.1

    @cached_property
    def frame(self) -> tuple[slice, slice]:
        """Rows and columns of the part that is analysed as a whole, with most of the difference."""
        return densest(self.pixels.greatest, _FRAME)

    @cached_property
    def framed(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The mean light of the channels of A and of B, [h, w], in the frame."""
        a, b = (self.light(self.values_at(side, *self.frame)).mean(axis=0) for side in ("a", "b"))
        return a, b

    @cached_property
    def clipped_near(self) -> NDArray[np.bool_]:
        """Mask [h, w] of the frame around pixels that may be clipped by an integer type."""
        near = np.zeros(self.framed[0].shape, bool)
        if self._is_linear:
            return near
        for side in ("a", "b"):
            near |= (self.values_at(side, *self.frame) > 0.996).any(axis=0)
        return widened(near, _BLOCK // 2)

    def left_framed(self, predicted: NDArray[Any], where: NDArray[np.bool_]) -> float:
        """The residual of predicted light [h, w] of the frame, as a share of the difference."""
        used = where & ~self.clipped_near
        a, b, shown = (self.scaled_light(v[used]) for v in (*self.framed, predicted))
        every, rest = (float(np.square(v - b, dtype="f8").sum()) for v in (a, shown))
        return math.sqrt(rest / every) if every else math.inf


def _drawn(generator: np.random.Generator, mask: NDArray[np.bool_], count: int) -> NDArray[Any]:
    """Places of at most `count` random true pixels of a mask."""
    tried = generator.integers(0, mask.size, 8 * count)
    found = tried[mask.ravel()[tried]][:count]
    if len(found) == count:
        return found
    true = np.flatnonzero(mask)
    return true[generator.integers(0, max(true.size, 1), min(count, true.size))]


def densest(differences: NDArray[Any], side: int) -> tuple[slice, slice]:
    """Rows and columns of the part [side, side] with most of the differences [H, W]."""
    sums = sums_of_parts(np.minimum(np.nan_to_num(differences), _LARGE), _GRID)
    total = np.pad(sums.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    high, wide = (min(side // _GRID, n) for n in sums.shape)
    held = total[high:, wide:] - total[:-high, wide:] - total[high:, :-wide] + total[:-high, :-wide]
    first = np.unravel_index(int(held.argmax()), held.shape)
    rows, columns = (
        slice(_GRID * int(k), min(_GRID * int(k) + side, n))
        for k, n in zip(first, differences.shape, strict=True)
    )
    return rows, columns


def steepness(light: NDArray[Any]) -> NDArray[Any]:
    """The approximate slope of the scale of differences at some light."""
    magnitude = np.maximum(np.abs(light), 0.003)
    return np.asarray(magnitude ** np.where(magnitude < 1.0, 1 / 2.4 - 1, -1.0))


def blocks_in_turn(size: tuple[int, int], side: int = _BLOCK) -> NDArray[np.bool_]:
    """Mask [H, W] of the blocks that choose parameters; the others measure."""
    rows, columns = (np.arange(length) // side % 2 == 0 for length in size)
    return np.asarray(rows[:, None] == columns)


def sums_of_parts(values: NDArray[Any], side: int) -> NDArray[Any]:
    """Sums [h, w] over the parts of values [H, W]."""
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], side), axis=0)
    return np.add.reduceat(rows, np.arange(0, values.shape[1], side), axis=1)


def summed_up(
    columns: Sequence[NDArray[Any]], aim: NDArray[Any], weights: NDArray[Any]
) -> NDArray[Any]:
    """The factors of columns whose sum fits an aim, by weighted least squares."""
    design = np.stack([(column * weights).ravel() for column in columns])
    square, sums = design @ design.T, design @ (aim * weights).ravel()
    square[np.diag_indices(len(columns))] *= 1 + 1e-12
    return np.asarray(np.linalg.lstsq(square, sums, rcond=None)[0])


def alike(x: NDArray[Any], y: NDArray[Any]) -> float:
    """The correlation of two arrays, 0 if one is constant or empty."""
    if not x.size:
        return 0.0
    x, y = x - x.mean(), y - y.mean()
    # Not np.vdot: its threads wait for each other where several processes compare.
    scale = math.sqrt(float(np.square(x).sum()) * float(np.square(y).sum()))
    return float((x * y).sum()) / scale if scale else 0.0

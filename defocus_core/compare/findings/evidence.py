"""Sampled pixels of a pair, against which explanations of a difference are tried.

An explanation predicts B from A. What it leaves of the difference is measured at pixels that did
not choose its parameters: blocks of 16 px take turns. It is measured on a scale that is sRGB up to
1 and logarithmic beyond, so that a few highlights do not decide. White noise of lossy codecs, which
no explanation predicts, counts neither for nor against one.
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

_SAMPLES = 5_000  # pixels that are looked at, each with its neighbour on the right
_FEW = 2048  # pixels of a picture below which what explains half of them may be chance
_FRAME = 448  # px of a side of the part that is looked at as a whole
_LARGE = 0.5  # difference beyond which a pixel does not count more
_GRID = 16  # px that its corner is a multiple of, so that tiles, blocks and coarse pixels are whole
_BLOCK = 16  # px of the blocks that take turns: one chooses parameters, the next measures
_LARGEST = 1e30  # value that is looked at: beyond it, arithmetic in float32 overflows
LOSSY = (3.5 / 255) ** 2  # power of the strongest noise of a codec
_SIGNAL = 1.3  # least power of a difference, by that of the noise in it
_FORGIVEN = 0.15  # share of the power of a difference that may be noise, where no codec loses
_PART_OF = 0.6  # greatest share of a picture that a rectangle of it has
_GOES_ON = 0.2  # least density of detail outside of it, by that inside
_NAMED = 0.8  # share left beyond which no explanation is named
_LEVELS = 32  # of a curve
_STILL = 0.1  # greatest share of a predicted change that lies where the pictures are equal
LOSSY_CODECS = frozenset({"DWAA", "DWAB", "B44", "B44A"})
# RMS of what number types round off, on the scale of differences: absolute, and of the level.
_STEPS = {"uint8": (0.35 / 255, 0.0), "uint16": (0.35 / 65535, 0.0), "half": (0.0, 4e-4)}
_FLOAT = (0.0, 1e-6)
PART = 32  # px of a side of a part


@dataclass(frozen=True)
class Explanation:
    """A cause whose parameters are those that explain most of a difference."""

    left: float  # share of the RMS difference that it leaves
    name: str  # of the finding
    how: str = ""  # what the words of the finding say after its name
    # Its parameters, for programs
    values: Mapping[str, Any] = field(default_factory=dict)
    cost: float = 0.0  # what is added to ``left`` where causes compete: more for more parameters
    text: str = ""  # the words, where they do not begin with the name
    rivals: str = ""  # as of its row in the table of causes

    @property
    def rank(self) -> float:
        """What counts where explanations compete; the least wins."""
        return round(self.left, 2) + self.cost

    @property
    def finding(self) -> Finding:
        """The finding that it makes."""
        return Finding(self.name, self.text or self.name + self.how, self.values)


class Evidence:
    """A pair as explanations see it.

    Attributes:
        names: of the channels that differ.
        gamma: as of `Pixels`.
        types: number types of B.
        others: channels of files beside that of A, by the finding that B is one of these.
        codecs: compression of the files of A and of B.
        is_small: whether there are so few pixels that what explains half of them may be chance.
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
        """Rows and columns of the samples; the second half are the neighbours of the first."""
        width = self.size[1]
        finite, right = self.pixels.finite, min(1, width - 1)
        ok = np.ones(self.size, bool) if finite is None else finite.copy()
        ok[:, : width - right] &= ok[:, right:]
        ok[:, width - right :] = False
        if np.count_nonzero(ok) <= _SAMPLES:
            every = np.flatnonzero(ok)
        else:
            generator = np.random.default_rng(0)
            chosen = _drawn(generator, (self.pixels.greatest > 0) & ok, _SAMPLES // 2)
            every = np.concatenate([chosen, _drawn(generator, ok, _SAMPLES - len(chosen))])
        rows, columns = np.unravel_index(every, self.size)
        return np.concatenate([rows, rows]), np.concatenate([columns, columns + right])

    @cached_property
    def fits(self) -> NDArray[np.bool_]:
        """Samples that choose parameters; the others measure."""
        rows, columns = (places // _BLOCK for places in self.places)
        half = len(rows) // 2
        first = (rows[:half] + columns[:half]) % 2 == 0
        return np.concatenate([first, first])

    @cached_property
    def sampled(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Values of A and of B [C, N] at the sampled pixels."""
        return self.at("a", *self.places), self.at("b", *self.places)

    @cached_property
    def steady(self) -> NDArray[np.bool_]:
        """Samples [C, N] that neither side may have clipped: all, where values have no bounds."""
        a, b = self.sampled
        if self.gamma == 1.0:
            return np.ones(a.shape, bool)
        return (np.minimum(a, b) > 0.004) & (np.maximum(a, b) < 0.996)

    def at(self, side: str, rows: Any, columns: Any, names: Sequence[str] = ()) -> Any:
        """Values [C, N] of side ``a`` or ``b`` at some places, 0 where a pixel is not finite."""
        planes = [self.pixels.plane(side, name)[rows, columns] for name in names or self.names]
        values = np.stack(planes).astype(np.float32).clip(-_LARGEST, _LARGEST)
        return values if self.pixels.finite is None else np.nan_to_num(values)

    @property
    def _is_linear(self) -> bool:
        """Whether values are linear light, or none at all."""
        return self.gamma == 1.0 or not self.pixels.color

    def scaled(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values on the scale that differences are measured on."""
        return self.scaled_light(values) if self._is_linear else values

    def light(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Stored values as linear light."""
        if self.gamma == 1.0:
            return values.astype(np.float64)
        if self.gamma is None:
            return srgb_to_linear(np.maximum(values, 0.0))
        return np.asarray(np.maximum(values, 0.0).astype(np.float64) ** self.gamma)

    def stored(self, light: NDArray[Any]) -> NDArray[np.float32]:
        """Linear light as the files store it."""
        if self.gamma == 1.0:
            return light.astype(np.float32)
        shown: NDArray[np.float32] = np.clip(light, 0.0, 1.0).astype(np.float32)
        return unclipped(shown) if self.gamma is None else shown ** np.float32(1 / self.gamma)

    def unscaled(self, values: NDArray[Any]) -> NDArray[Any]:
        """Stored values of those on the scale of differences."""
        return self.unscaled_light(values) if self._is_linear else values

    def unscaled_light(self, values: NDArray[Any]) -> NDArray[Any]:
        """Linear light of values on the scale of differences."""
        if not self.pixels.color:
            return np.asarray(np.sinh(values))
        size = np.abs(values)
        beyond = np.exp(np.clip(size - 1.0, 0.0, 300.0) * (2.4 / 1.055))
        magnitude = np.where(size > 1.0, beyond, srgb_to_linear(np.minimum(size, 1.0)))
        return np.asarray(np.copysign(magnitude, values))

    @cached_property
    def step(self) -> float:
        """What the number type of B may round off, on the scale of differences."""
        values = self.scaled(self.sampled[1])
        level = math.sqrt(float(np.square(values).mean())) if values.size else 0.0
        steps = (_STEPS.get(kind, _FLOAT) for kind in self.types)
        return max((step + share * level for step, share in steps), default=0.0)

    @cached_property
    def is_slight(self) -> bool:
        """Whether rounding makes about as much of a difference as there is."""
        half = self.sampled[0].shape[1] // 2
        whole = self._aim[1]
        return _is_slight(_power(whole[:, :half], whole[:, half:]), self.step)

    @cached_property
    def _aim(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """B, and B − A, on the scale of differences."""
        a, b = (self.scaled(side) for side in self.sampled)
        return b, b - a

    @cached_property
    def lossy(self) -> float:
        """The power of noise that a codec may have left; all is possible in 8 bits."""
        return LOSSY if "uint8" in self.types or set(self.codecs) & LOSSY_CODECS else 0.0

    @cached_property
    def noise(self) -> float:
        """The greatest power of noise that a model of the samples may leave.

        A curve of each channel is the freest model of values in place: what it leaves, and
        neighbours do not share, is noise to all of these.
        """
        aim, whole = self._aim
        rest = np.zeros((len(whole), len(self.places[0])))
        for k, (level, change) in enumerate(zip(aim - whole, whole, strict=True)):
            ends = np.quantile(level, np.linspace(0, 1, _LEVELS + 1)[1:-1])
            place = np.searchsorted(ends, level)
            counts = np.bincount(place, minlength=_LEVELS)
            means = np.bincount(place, change, _LEVELS) / np.maximum(counts, 1)
            rest[k] = change - means[place]
        half = len(self.places[0]) // 2
        pair = rest[:, :half], rest[:, half:]
        every = _power(whole[:, :half], whole[:, half:])
        white = unshared(*pair)
        # Detail that is no multiple of that of the other side is noise of both.
        sides = (side[:, half:] - side[:, :half] for side in (aim - whole, aim))
        detail = np.stack([side.ravel() for side in sides]).astype("f8")
        alone = float(np.linalg.eigvalsh(detail @ detail.T / max(detail.shape[1], 1))[0])
        return min(white, max(self.lossy, _FORGIVEN * every, alone))

    @cached_property
    def _still(self) -> NDArray[np.bool_]:
        """Samples [N] that are equal in A and B, and not at a bound of the file."""
        return np.asarray((self.pixels.greatest[self.places] == 0) & self.steady.all(axis=0))

    @cached_property
    def window(self) -> tuple[int, int, int, int]:
        """The first row and column that differ, and those after the last."""
        rows, columns = (np.flatnonzero((self.pixels.greatest > 0).any(axis=k)) for k in (1, 0))
        return int(rows[0]), int(columns[0]), int(rows[-1]) + 1, int(columns[-1]) + 1

    @cached_property
    def is_rectangle(self) -> bool:
        """Whether what differs is a rectangle: its rims differ as all of it, and A goes on outside.

        Only detail counts: what is flat may stay as it is.
        """
        changed, (top, left, bottom, right) = self.pixels.greatest > 0, self.window
        inside = (slice(top, bottom), slice(left, right))
        if changed[inside].size > _PART_OF * changed.size or min(changed[inside].shape) < 4:
            return False
        plane = np.nan_to_num(self.scaled(self.pixels.plane("a", self.names[0])))
        steps = (np.diff(plane, axis=k, append=plane.take([-1], axis=k)) for k in (0, 1))
        steep = sum(map(np.abs, steps))
        detail = steep >= 0.5 * np.median(steep[changed])
        within, there = changed[inside], detail[inside]
        apart = np.count_nonzero(detail) - np.count_nonzero(there)
        if apart * there.size < _GOES_ON * np.count_nonzero(there) * (detail.size - there.size):
            return False
        rims = [
            (slice(4),),
            (slice(-4, None),),
            (slice(None), slice(4)),
            (slice(None), slice(-4, None)),
        ]
        shares = [float(within[rim][there[rim]].mean()) for rim in rims if there[rim].any()]
        return min(shares, default=0.0) > 0.5 * float(within[there].mean()) > 0.1

    def _changes_still(
        self, shown: NDArray[Any], a: NDArray[Any], still: NDArray[np.bool_], equal: float = 1.0
    ) -> bool:
        """Whether a prediction changes pixels that are equal, each of which counts ``equal``."""
        change = shown - a
        share = max(_STEPS.get(kind, _FLOAT)[1] for kind in self.types)
        change[np.abs(change) <= 2 * self.step + 5 * share * np.abs(a)] = 0.0
        power = np.square(change, dtype="f8")
        there = equal * float(power[..., still].sum())
        return there > _STILL * (there + float(power[..., ~still].sum())) > 0.0

    def left(
        self,
        predicted: NDArray[Any],  # [C, N] at the sampled pixels
        where: NDArray[np.bool_] | None = None,
        *,
        exact: bool = False,
    ) -> float:
        """Share of the difference that is left if B were as predicted.

        `where`: samples [N] or [C, N] at which there is a prediction; None for all.
        """
        aim, whole = self._aim
        tested = ~self.fits
        used = tested if where is None else tested & where
        if np.count_nonzero(used) < max(8, used.size // 16):
            return math.inf
        if (
            where is not None
            and not exact
            and np.square(whole * used).sum() < 0.3 * np.square(whole[:, tested]).sum()
        ):
            return math.inf
        shown = self.scaled(predicted)
        before, after = (_pairs(side, used) for side in (whole, shown - aim))
        left = unexplained(before, after, self.step, 0.0 if exact else self.noise)
        tried = used if used.ndim == 1 else used.all(axis=0)
        if left > _NAMED or not (tried & self._still).any():
            return left
        # Pixels that differ are sampled more often.
        p, differ = float((self.pixels.greatest != 0).mean()), float((~self._still).mean())
        weight = (1 - p) * differ / max(p * (1 - differ), 1e-9)
        cut = (aim - whole)[:, tried]
        return (
            math.inf
            if self._changes_still(shown[:, tried], cut, self._still[tried], weight)
            else left
        )

    @cached_property
    def frame(self) -> tuple[slice, slice]:
        """Rows and columns that are looked at as a whole: where most differs."""
        return densest(self.pixels.greatest, _FRAME)

    @cached_property
    def framed(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The mean light of the channels of A and of B, [h, w], in the frame."""
        rows, columns = self.frame
        a, b = (self.light(self.at(side, rows, columns)).mean(axis=0) for side in ("a", "b"))
        return a, b

    @cached_property
    def clipped_near(self) -> NDArray[np.bool_]:
        """Pixels [h, w] of the frame near to one that may be clipped, in files with bounds."""
        near = np.zeros(self.framed[0].shape, bool)
        if self.gamma == 1.0:
            return near
        for side in ("a", "b"):
            near |= (self.at(side, *self.frame) > 0.996).any(axis=0)
        return widened(near, _BLOCK // 2)

    def scaled_light(self, light: NDArray[Any]) -> NDArray[Any]:
        """Linear light on the scale of differences."""
        return unclipped(light) if self.pixels.color else np.arcsinh(light)

    def left_framed(
        self,
        predicted: NDArray[Any],
        where: NDArray[np.bool_] | None = None,
        noise: float | None = None,
    ) -> float:
        """Share of the difference of the frame that is left if its light were as predicted."""
        used, whole, rest = self.framed_pairs(predicted, where)
        most = max(self.lossy, _FORGIVEN * _power(*whole)) if noise is None else noise
        left = unexplained(whole, rest, self.step, most) if used.any() else math.inf
        still = (self.pixels.greatest[self.frame] == 0) & ~self.clipped_near
        if left > _NAMED or not still.any():
            return left
        shown = self.scaled_light(predicted)
        return math.inf if self._changes_still(shown, self._framed_shown[0], still) else left

    @cached_property
    def _framed_shown(self) -> tuple[NDArray[Any], NDArray[Any]]:
        a, b = (self.scaled_light(side) for side in self.framed)
        return a, b

    def framed_pairs(
        self, predicted: NDArray[Any], where: NDArray[np.bool_] | None
    ) -> tuple[NDArray[np.bool_], tuple[Any, Any], tuple[Any, Any]]:
        """Where a prediction is looked at, and the difference and what is left of it there."""
        used = ~self.clipped_near if where is None else where & ~self.clipped_near
        rows, columns = (np.flatnonzero(used.any(axis=axis)) for axis in (1, 0))
        cut = tuple(slice(v[0], v[-1] + 1) if v.size else slice(0) for v in (rows, columns))
        used = used[cut]
        a, b = (side[cut] for side in self._framed_shown)
        both = used[:, :-1] & used[:, 1:]
        sides = (a - b, self.scaled_light(predicted[cut]) - b)
        whole, rest = ((side[:, :-1][both], side[:, 1:][both]) for side in sides)
        return used, whole, rest


def _drawn(generator: np.random.Generator, mask: NDArray[np.bool_], count: int) -> NDArray[Any]:
    """Places of so many true pixels of a mask, by chance; fewer where it has fewer."""
    tried = generator.integers(0, mask.size, 8 * count)
    found = tried[mask.ravel()[tried]][:count]
    if len(found) == count:
        return found
    true = np.flatnonzero(mask)
    return true[generator.integers(0, max(true.size, 1), min(count, true.size))]


def densest(differences: NDArray[Any], side: int) -> tuple[slice, slice]:
    """Rows and columns of the part [side, side] of differences [H, W] that holds most of them."""
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
    """About the slope of the scale of differences at some light."""
    magnitude = np.maximum(np.abs(light), 0.003)
    return np.asarray(magnitude ** np.where(magnitude < 1.0, 1 / 2.4 - 1, -1.0))


def blocks_in_turn(size: tuple[int, int], side: int = _BLOCK) -> NDArray[np.bool_]:
    """Pixels [H, W] of blocks that choose parameters; the others measure."""
    rows, columns = (np.arange(length) // side % 2 == 0 for length in size)
    return np.asarray(rows[:, None] == columns)


def _pairs(values: NDArray[Any], used: NDArray[np.bool_]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Values [C, N] at samples [N] or [C, N] that are used, and at their used neighbours."""
    half = values.shape[1] // 2
    here, beside = values[:, :half], values[:, half:]
    if used.ndim == 1:
        both = np.flatnonzero(used[:half] & used[half:])
        return here[:, both], beside[:, both]
    each = used[:, :half] & used[:, half:]
    return here[each], beside[each]


def unexplained(
    whole: tuple[Any, Any], rest: tuple[Any, Any], step: float, noise: float = 0.0
) -> float:
    """Share of a difference that is left."""
    left, every = _power(*rest), _power(*whole)
    if _is_slight(every, step) or not every:  # rounding alone would explain much of it
        return 0.0 if left == 0.0 < every else math.inf
    # What neighbours do not share is noise.
    allowed = step * step + min(unshared(*rest), noise)
    if every < _SIGNAL * allowed:
        return math.inf
    return math.sqrt(max(left - allowed, 0.0) / (every - allowed))


def _is_slight(power: float, step: float) -> bool:
    return power < 6.25 * step * step


def _power(here: NDArray[Any], beside: NDArray[Any]) -> float:
    values = float(np.square(here, dtype="f8").sum() + np.square(beside, dtype="f8").sum())
    return values / (2 * here.size) if here.size else 0.0


def unshared(here: NDArray[Any], beside: NDArray[Any]) -> float:
    """The power of values that they do not share with their neighbours."""
    shared = float(np.multiply(here, beside, dtype="f8").sum()) / here.size if here.size else 0.0
    return max(_power(here, beside) - max(shared, 0.0), 0.0)


def sums_of_parts(values: NDArray[Any], side: int = PART) -> NDArray[Any]:
    """Sums [h, w] over the parts of values [H, W]."""
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], side), axis=0)
    return np.add.reduceat(rows, np.arange(0, values.shape[1], side), axis=1)


def summed_up(
    columns: Sequence[NDArray[Any]], aim: NDArray[Any], weights: NDArray[Any]
) -> NDArray[Any]:
    """The multiples of columns that sum up to an aim, by weighted least squares."""
    design = np.stack([(column * weights).ravel() for column in columns])
    square, sums = design @ design.T, design @ (aim * weights).ravel()
    square[np.diag_indices(len(columns))] *= 1 + 1e-12
    return np.asarray(np.linalg.lstsq(square, sums, rcond=None)[0])


def fitted_in_parts(
    columns: Sequence[NDArray[Any]],
    aim: NDArray[Any],
    chooses: NDArray[np.bool_],
    side: int = PART,
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
    total = np.zeros_like(aim)
    height, width = aim.shape
    for k, column in enumerate(columns):
        each = np.repeat(np.repeat(solved[..., k], side, axis=0), side, axis=1)
        total += each[:height, :width] * column
    return total

"""Samples of a deep OpenEXR part, decoded some rows at a time, nearest first in each pixel.

A sample with a ZBack beyond its Z fills a volume: its depth is the middle of both in 1 / distance,
whose blur is the mean of theirs.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.exr.deep_chunks import Samples, decoded, max_count
from defocus_core.io.exr.header import Header
from defocus_core.io.exr.windows import Window

HELD_BYTES = 1 << 27
_held: dict[object, list[Strip]] = {}
ALPHA, DEPTH, BACK = _OF_LAYERS = "A", "Z", "ZBack"
FRONT = "ZFront"  # where a sample begins, beside its depth
_ROUNDING = 2e-3  # alpha beyond 1 by less is rounding of half


class Strip(NamedTuple):
    """The samples of some rows, sorted by pixel and in each pixel by depth."""

    window: Window
    pixel: NDArray[Any]  # [N] number of the pixel of each sample in the window
    rank: NDArray[Any]  # [N] number of the sample in its pixel, 0 is the nearest
    # [N] by channel; coverage and depth of a view by their plain names, too
    values: dict[str, NDArray[Any]]

    @property
    def nbytes(self) -> int:
        """Size of its arrays."""
        arrays = (self.pixel, self.rank, *self.values.values())
        return sum(array.nbytes for array in arrays)

    @property
    def maximum(self) -> int:
        """The number of samples of the pixel with most of them."""
        return int(self.rank.max(initial=-1)) + 1

    def dense(self, chosen: Any, values: NDArray[Any]) -> NDArray[Any]:
        """The values [N] of the chosen samples, one a pixel, as rows [h, w]; 0 elsewhere."""
        rows = np.zeros(self.window.height * self.window.width, values.dtype)
        rows[self.pixel[chosen]] = values[chosen]
        return rows.reshape(self.window.height, self.window.width)


class DeepSummary(NamedTuple):
    """Samples of a deep part."""

    maximum: int  # of the pixel that has most
    total: int
    pixels: int  # number of pixels that have some
    # Least and greatest finite depth, as it stands in the file; None if there is none
    ends: tuple[float, float] | None


def max_samples(path: Path, header: Header) -> int:
    """The number of samples of the pixel with most of them."""
    return _max_samples(path, header, _version(path))


@lru_cache(maxsize=64)
def _max_samples(path: Path, header: Header, version: object) -> int:
    return max_count(path, header)


def summary(path: Path, header: Header) -> DeepSummary:
    """The samples of a deep part, in figures."""
    maximum = total = pixels = 0
    ends: list[float] = []
    for strip in strips(path, header):
        maximum, total = max(maximum, strip.maximum), total + len(strip.rank)
        pixels += int(np.count_nonzero(strip.rank == 0))
        depth = strip.values.get(DEPTH, np.zeros(0))
        finite = depth[np.isfinite(depth)]
        ends += [float(finite.min()), float(finite.max())] if len(finite) else []
    return DeepSummary(maximum, total, pixels, (min(ends), max(ends)) if ends else None)


def strips(path: Path, header: Header, *, last: bool = False) -> Iterator[Strip]:
    """The samples of a deep part, some rows at a time.

    Those of one part are held, if they are not too many, until they are read for the last time.
    """
    key = path, header, _version(path)
    held = _held.pop(key, None)
    if held is None:
        held, size = [], 0
        for samples in decoded(path, header):
            strip = _strip(path, samples, header)
            size += strip.nbytes
            if not last and size <= HELD_BYTES:
                held.append(strip)
            yield strip
        if last or size > HELD_BYTES:
            return
    else:
        yield from held
    if not last:
        _held.clear()
        _held[key] = held


def _version(path: Path) -> tuple[int, int]:
    """What changes with a file: the time of its last change, and its size."""
    state = path.stat()
    return state.st_mtime_ns, state.st_size


def _strip(path: Path, samples: Samples, header: Header) -> Strip:
    """Some decoded rows: their samples, sorted; of another view's channels nothing."""
    (x0, _, x1, _), pixel = header.data, samples.pixel.astype(np.int32)
    window, values = Window(x0, samples.rows[0], x1, samples.rows[1]), {}
    channels = {channel.name: channel for channel in header.channels}
    for name, channel in channels.items():
        numbers, plain = samples.values[name], channel.plain
        is_whole = channel.type == "uint"
        values[plain if plain in _OF_LAYERS else name] = numbers.astype("u4" if is_whole else "f4")
    _check_alpha(path, values)
    if BACK in values and DEPTH in values:
        values[FRONT] = values[DEPTH]
        values[DEPTH] = middle(values[DEPTH], values[BACK])
    depth = np.nan_to_num(values.get(DEPTH, pixel[:0]), nan=np.inf, posinf=np.inf)
    order = np.lexsort((depth, pixel)) if DEPTH in values else np.argsort(pixel, kind="stable")
    pixel, values = pixel[order], {name: each[order] for name, each in values.items()}
    index, is_first = np.arange(len(pixel)), np.diff(pixel, prepend=-1) > 0
    rank = index - np.maximum.accumulate(np.where(is_first, index, 0))
    for name, channel in channels.items():  # of a view
        values[name] = values[channel.plain if channel.plain in _OF_LAYERS else name]
    return Strip(window, pixel, rank.astype(np.int32), values)


def _check_alpha(path: Path, values: dict[str, NDArray[Any]]) -> None:
    """Add an alpha of 1 if there is none, and make 1 what rounding has made more."""
    some = next(iter(values.values()))
    alpha = values.get(ALPHA, np.ones(len(some), np.float32))
    wrong = int(np.count_nonzero(~((alpha >= 0) & (alpha <= 1 + _ROUNDING))))
    if wrong:
        problem = f"has an alpha that is not between 0 and 1 in {wrong} samples"
        raise InputError("out-of-range", problem, "render or save it again", path=path)
    values[ALPHA] = np.minimum(alpha, 1)


def middle(front: NDArray[Any], back: NDArray[Any]) -> NDArray[Any]:
    """The middle of volumes in 1 / distance; of surfaces, their distance."""
    with np.errstate(divide="ignore", invalid="ignore"):
        between = 2 / (1 / front + 1 / back)
    return np.where((back > front) & (front > 0), between, front).astype(np.float32)

"""Pixels that are compared: a region, a mask, and those that differ by anti-aliasing alone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.picture import DecodedPicture, read_picture
from defocus_core.errors import InputError, UsageProblem
from defocus_core.request.quantities import QuantityError

_EDGE = 1.0  # px
_REGION = re.compile(r"\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(\d+)\s*,\s*(\d+)\s*")


@dataclass(frozen=True)
class CropRegion:
    """A rectangle of the picture shown: its first column and row, width and height in px."""

    x: int
    y: int
    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.x},{self.y},{self.width},{self.height}"

    def cut(self, size: tuple[int, int], field: str = "region") -> tuple[slice, slice]:
        """Rows and columns of a picture of (height, width).

        `size`: (height, width) of the picture.
        """
        height, width = size
        within = self.x >= 0 and self.y >= 0
        if not within or self.x + self.width > width or self.y + self.height > height:
            problem = f"{self} is not within a picture of {width}x{height}"
            raise UsageProblem(
                "out-of-range", problem, "write X,Y,WIDTH,HEIGHT within it", field=field
            )
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)


def region(text: str) -> CropRegion:
    """The region that ``X,Y,W,H`` means."""
    match = _REGION.fullmatch(text)
    if match is None:
        raise QuantityError(
            f"'{text}' is not a region", "write X,Y,WIDTH,HEIGHT in px, like 0,0,64,64"
        )
    found = CropRegion(*(int(number) for number in match.groups()))
    if found.width < 1 or found.height < 1:
        raise QuantityError(f"'{text}' holds no pixel", "write X,Y,WIDTH,HEIGHT in px")
    return found


def read_mask(path: Path, size: tuple[int, int], *, empty: bool = False) -> NDArray[np.bool_]:
    """Where a mask is not 0 in any channel, [H, W].

    `size`: (height, width) of the picture.
    """
    mask = _of_size(path, size, "give a mask of the size of the picture")
    planes = [plane for plane in mask.planes.values() if plane.shape == size]
    if any(np.isnan(plane).any() for plane in planes):
        raise InputError(
            "not-finite",
            "holds NaN",
            "save it with numbers: 0 where nothing is compared",
            path=path,
        )
    selected: NDArray[np.bool_] = np.logical_or.reduce([plane != 0 for plane in planes])
    if not selected.any() and not empty:
        raise InputError(
            "empty", "is 0 everywhere", "make it 1 where pixels are to be compared", path=path
        )
    return selected


def _of_size(path: Path, size: tuple[int, int], remedy: str) -> DecodedPicture:
    """A picture, which must have this (height, width)."""
    picture = read_picture(path)
    if (picture.height, picture.width) != size:
        problem = f"is {picture.width}x{picture.height}, but the picture is {size[1]}x{size[0]}"
        raise InputError("wrong-size", problem, remedy, path=path)
    return picture


def within_neighbours(a: Sequence[NDArray[Any]], b: Sequence[NDArray[Any]]) -> NDArray[np.bool_]:
    """Pixels [H, W] that differ as anti-aliasing may.

    The value of one side lies between those of the pixel and its eight neighbours on the other, in
    all channels, and at least three of these nine pixels are equal, as beside a line or an edge.
    """
    ok = np.ones(a[0].shape, bool)
    equal = np.ones(a[0].shape, bool)
    for one, other in zip(a, b, strict=True):
        equal &= np.abs(np.subtract(one, other, dtype=np.float32)) <= 1 / 255
        for near, value in ((one, other), (other, one)):
            low, high = (_of_nine(near, choose) for choose in (np.minimum, np.maximum))
            ok &= (value >= low) & (value <= high)
    count = _of_nine(equal.astype(np.int8), np.add)
    return np.asarray(ok & ~equal & (count >= 3))


def _of_nine(values: NDArray[Any], combine: Any) -> NDArray[Any]:
    """Each pixel combined with its neighbours; the border is repeated."""
    for axis in (0, 1):
        padded = np.pad(values, [(1, 1) if axis == k else (0, 0) for k in (0, 1)], mode="edge")
        parts = [padded.take(range(k, k + values.shape[axis]), axis=axis) for k in range(3)]
        values = combine(combine(parts[0], parts[1]), parts[2])
    return values


def read_radius(path: Path, size: tuple[int, int]) -> NDArray[np.float32]:
    """The signed radius [H, W] in px of a CoC map, 0 where it is not finite."""
    picture = _of_size(path, size, "give the CoC maps of these pictures")
    plane = picture.planes.get("coc")
    if plane is None and len(picture.planes) == 1:
        (plane,) = picture.planes.values()
    if plane is None:
        problem = f"has no channel coc, only {', '.join(picture.planes)}"
        raise InputError(
            "no-such-channel", problem, "give what 'defocus render ‹outputs› coc' wrote", path=path
        )
    radius = np.asarray(plane, np.float32)
    return np.where(np.isfinite(radius), radius, np.float32(0.0))


def beside_jumps(values: NDArray[Any], least: float = _EDGE) -> NDArray[np.bool_]:
    """Pixels [H, W] with a neighbour whose value differs by more than ``least``."""
    edges = np.zeros(values.shape, bool)
    across = np.abs(np.diff(values, axis=1)) > least
    down = np.abs(np.diff(values, axis=0)) > least
    for beside, step in ((edges[:, 1:], across), (edges[:, :-1], across)):
        beside |= step
    for beside, step in ((edges[1:], down), (edges[:-1], down)):
        beside |= step
    return edges


def widened(mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Pixels with a true one within ``reach`` rows and columns."""
    for axis in (0, 1):
        length = mask.shape[axis]
        counts = np.cumsum(mask, axis=axis, dtype=np.int32)
        first = np.clip(np.arange(length) - reach - 1, -1, length - 1)
        last = np.minimum(np.arange(length) + reach, length - 1)
        below: Any = np.take(counts, np.maximum(first, 0), axis=axis)
        outside = np.expand_dims(first < 0, 1 - axis)
        mask = np.take(counts, last, axis=axis) - np.where(outside, 0, below) > 0
    return mask

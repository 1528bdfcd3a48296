"""Selection of compared pixels: regions, masks, anti-aliased pixels."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.picture import read_picture
from defocus_core.errors import InputError, UsageProblem
from defocus_core.request.quantities import QuantityError

_EDGE = 1.0  # px
_EQUAL = 0.5 / 255  # greatest difference of equal values beside anti-aliased pixels
_REGION = re.compile(r"\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(\d+)\s*,\s*(\d+)\s*")


@dataclass(frozen=True)
class CropRegion:
    """A rectangle of the display window: first column and row, width and height in px."""

    x: int
    y: int
    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.x},{self.y},{self.width},{self.height}"

    def cut(self, size: tuple[int, int], field: str = "region") -> tuple[slice, slice]:
        """The rows and columns of the region.

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
    """The region of a text ``X,Y,W,H``."""
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
    """Pixels [H, W] at which any channel of a mask is not 0.

    `size`: (height, width) of the picture. `empty`: whether the mask may be 0 everywhere.
    """
    mask = read_picture(path)
    if (mask.height, mask.width) != size:
        problem = f"is {mask.width}x{mask.height}, but the picture is {size[1]}x{size[0]}"
        remedy = "give a mask of the size of the picture"
        raise InputError("wrong-size", problem, remedy, path=path)
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


def anti_aliased(a: Sequence[NDArray[Any]], b: Sequence[NDArray[Any]]) -> NDArray[np.bool_]:
    """Pixels [H, W] that are anti-aliased in A or in B, by the rule of Vyšniauskas (2009).

    Such a pixel has a darker and a brighter pixel among its eight neighbours, and at most two equal
    ones. Its darkest or brightest neighbour lies in a flat area of both A and B.
    """
    flat = np.logical_and(*(_is_flat([np.asarray(v, np.float32) for v in side]) for side in (a, b)))
    return np.asarray(_is_between(a, flat) | _is_between(b, flat))


def _is_flat(planes: Sequence[NDArray[Any]]) -> NDArray[np.bool_]:
    """Pixels [H, W] that have the same values as at least three of their eight neighbours."""
    count = np.zeros(planes[0].shape, np.int8)
    for beside in zip(*map(_neighbours, planes), strict=True):
        near = zip(beside, planes, strict=True)
        count += np.logical_and.reduce([np.abs(v - plane) <= _EQUAL for v, plane in near])
    return np.asarray(count >= 3)


def _is_between(planes: Sequence[NDArray[Any]], flat: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels [H, W] between a darker and a brighter neighbour, at least one of which is `flat`."""
    grey = np.mean([np.asarray(plane, np.float32) for plane in planes], axis=0)
    low, high, equal = np.zeros_like(grey), np.zeros_like(grey), np.zeros(grey.shape, np.int8)
    beside_low, beside_high = np.zeros((2, *grey.shape), bool)
    for beside, is_flat in zip(_neighbours(grey), _neighbours(flat), strict=True):
        change = beside - grey
        equal += np.abs(change) <= _EQUAL
        beside_low, beside_high = (
            np.where(further, is_flat, known)
            for further, known in ((change < low, beside_low), (change > high, beside_high))
        )
        low, high = np.minimum(low, change), np.maximum(high, change)
    is_inside = (low < -_EQUAL) & (high > _EQUAL) & (equal <= 2)
    return np.asarray(is_inside & (beside_low | beside_high))


def _neighbours(values: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Values [H, W] of each of the eight neighbours; the border is repeated."""
    height, width = values.shape
    padded = np.pad(values, 1, mode="edge")
    for row, column in np.ndindex(3, 3):
        if (row, column) != (1, 1):
            yield padded[row : row + height, column : column + width]


def beside_jumps(values: NDArray[Any], least: float = _EDGE) -> NDArray[np.bool_]:
    """Pixels [H, W] with a neighbour whose value differs by more than ``least``."""
    edges = np.zeros(values.shape, bool)
    for one, other in ((edges, values), (edges.T, values.T)):
        jumps = np.abs(np.diff(other, axis=0)) > least
        one[1:] |= jumps
        one[:-1] |= jumps
    return edges


def widened(mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Pixels [H, W] with a true pixel of the mask within ``reach`` rows and columns."""
    for axis in (0, 1):
        pad = [(reach + 1, reach) if axis == other else (0, 0) for other in (0, 1)]
        counts = np.pad(mask.astype(np.int32), pad).cumsum(axis=axis)
        counts = counts if axis == 0 else counts.T
        mask = counts[2 * reach + 1 :] > counts[: -2 * reach - 1]
        mask = mask if axis == 0 else mask.T
    return mask

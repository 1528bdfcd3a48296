"""Values packed as half floats, which a browser unpacks and shows at any exposure.

The bits of a half are a number of 16 bits. Stored is its difference, modulo 2^16, to the left
neighbour, or to the same pixel of another layer: channel after channel, the low bytes of all before
the high bytes, deflated (zlib).
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.reports.html.item import StoredHalves

_LARGEST = 65504.0  # of half
_LEVEL = 4  # of zlib: 6 takes twice the time for 3 % less
_INTEGERS = {"uint8": 1 / 255}  # steps of integers that half holds exactly
_ROUNDING = 1e-3  # of a step, of single precision
_STEPS = frozenset(_INTEGERS.values())


def common_scale(planes: Sequence[NDArray[Any]], kind: str) -> float:
    """The factor from halves to the values of planes: it makes small integers whole numbers."""
    step = _INTEGERS.get(kind)
    if step is not None and all(_is_whole(plane / step) for plane in planes):
        return step
    maximum = _largest(planes)
    return 2.0 ** math.ceil(math.log2(maximum / _LARGEST)) if maximum > _LARGEST else 1.0


def _is_whole(plane: NDArray[Any]) -> bool:
    return bool((np.abs(plane - np.rint(plane)) < _ROUNDING).all())


def unit_scale(planes: Sequence[NDArray[Any]]) -> float:
    """The factor that brings the greatest value of planes to between ½ and 1."""
    maximum = _largest(planes)
    return 2.0 ** math.ceil(math.log2(maximum)) if maximum else 1.0


def _largest(planes: Sequence[NDArray[Any]]) -> float:
    """The largest finite magnitude."""
    maximum = 0.0
    for plane in planes:
        size = np.abs(plane)
        maximum = max(maximum, float(np.max(size, where=np.isfinite(size), initial=0.0)))
    return maximum


def is_exact(planes: Sequence[NDArray[Any]], scale: float) -> bool:
    """Whether halves hold the values of planes."""
    with np.errstate(all="ignore"):
        for plane in planes:
            scaled = plane if scale == 1 else _scaled(plane, scale)
            if not np.array_equal(scaled, scaled.astype(np.float16), equal_nan=True):
                return False
    return True


def bits(planes: Sequence[NDArray[Any]], scale: float) -> NDArray[np.uint16]:
    """The bits of planes [H, W] as halves, [C, H, W]."""
    with np.errstate(all="ignore"):
        return np.stack([_scaled(plane, scale).astype(np.float16) for plane in planes]).view(
            np.uint16
        )


def _scaled(plane: NDArray[Any], scale: float) -> NDArray[Any]:
    """The numbers that are stored as halves; of integers, whole ones."""
    scaled = plane if scale == 1 else np.asarray(plane, np.float64) / scale
    return np.rint(scaled) if scale in _STEPS else scaled


def pack(
    values: NDArray[np.uint16],
    corner: tuple[int, int],
    scale: float,
    base: tuple[str, NDArray[np.uint16]] | None = None,
) -> StoredHalves:
    """Pack bits [C, H, W], in the shorter way if there is a base."""
    _, height, width = values.shape
    first = values.copy()
    first[:, :, 1:] -= values[:, :, :-1]
    packed = StoredHalves(_deflated(first), corner, (width, height), scale)
    if base is None or base[1].shape != values.shape:
        return packed
    other = _deflated(values - base[1])
    return replace(packed, data=other, base=base[0]) if len(other) < len(packed.data) else packed


def _deflated(values: NDArray[np.uint16]) -> bytes:
    low, high = values.astype(np.uint8), (values >> 8).astype(np.uint8)
    return zlib.compress(low.tobytes() + high.tobytes(), _LEVEL)

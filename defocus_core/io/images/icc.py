"""ICC profiles of three curves and a matrix, as cameras, phones and displays have them.

ICC.1:2022, 8.3.4, "three-component matrix-based": R, G and B become light by curves, and light X, Y
and Z relative to the white D50 by a matrix; 8.3.5, "monochrome", has the curve alone. Profiles of
tables are not read. A blur is linear in light, so that the curves are all it needs: pictures keep
the profile that they came with.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.images.primaries import REC_709, Chromaticities, adaptation, chromaticities_of

_D50 = (0.9642, 1.0, 0.8249)  # of all profiles
_HEAD = 128  # bytes
_MAX_TAGS = 200
_PARAMETERS = (1, 3, 4, 5, 7)  # numbers of each type of parametric curve
_LEAST_RISE = 0.1  # of a curve, from black to white
_SAMPLES = 4096  # of a curve: floats between them are interpolated
_ROOTS = 1 << 16  # steps of the square root of light, near which samples of all curves are even


@dataclass(frozen=True)
class Profile:
    """How R, G and B of a file, or its grey, become light."""

    # Light of each channel of 0…1 at even steps, `_SAMPLES` numbers each
    curves: tuple[tuple[float, ...], ...]
    primaries: Chromaticities

    def light(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Linear light of samples [H, W, 3]: integers by a table, floats 0…1 by interpolation."""
        if values.dtype.kind == "u":
            tables = _tables(self, values.dtype.itemsize * 8)
            light = [table[values[..., c]] for c, table in enumerate(tables)]
        else:
            steps = np.linspace(0, 1, _SAMPLES)
            light = [
                np.interp(values[..., c], steps, curve).astype(np.float32)
                for c, curve in enumerate(self.curves)
            ]
        return np.stack(light, axis=-1)

    def samples(self, light: NDArray[np.float32]) -> NDArray[np.float32]:
        """The samples 0…1 of linear light [H, W, 3], whose curves never fall; NaN is black."""
        place = np.fmin(np.fmax(light, np.float32(0)), np.float32(1))
        place = np.sqrt(place, dtype=np.float32) * np.float32(_ROOTS)
        index = place.astype(np.int32)
        place -= index
        samples = np.empty_like(place)
        for c, table in enumerate(_inverses(self)):
            below, above = (table.take(index[..., c] + step) for step in (0, 1))
            samples[..., c] = below + place[..., c] * (above - below)
        return samples


class Embedded(NamedTuple):
    """The profile of a file, for others made of it to have: its bytes, and its curves if known."""

    data: bytes
    profile: Profile | None


@cache
def _tables(profile: Profile, bits: int) -> list[NDArray[np.float32]]:
    values, steps = np.linspace(0, 1, 2**bits), np.linspace(0, 1, _SAMPLES)
    return [np.interp(values, steps, curve).astype(np.float32) for curve in profile.curves]


@cache
def _inverses(profile: Profile) -> list[NDArray[np.float32]]:
    """Samples of each channel at even steps of the square root of light, with one more."""
    steps = np.linspace(0, 1, _SAMPLES)
    light = np.minimum(np.arange(_ROOTS + 2) / _ROOTS, 1) ** 2
    return [np.interp(light, curve, steps).astype(np.float32) for curve in profile.curves]


def read_profile(data: bytes) -> Profile | None:
    """The profile in the bytes of a file; None where it is none of curves and a matrix."""
    try:
        return _profile(data)
    except (struct.error, ValueError, KeyError, IndexError, ArithmeticError):
        return None


def _profile(data: bytes) -> Profile | None:
    if data[36:40] != b"acsp":
        return None
    tags = _tags(data)
    if data[16:20] == b"GRAY":
        return _rising((_curve(tags["kTRC"]),), REC_709)
    if data[16:24] != b"RGB XYZ ":
        return None
    curves = tuple(_curve(tags[f"{c}TRC"]) for c in "rgb")
    relative = np.array([_fixed(tags[f"{c}XYZ"][8:20]) for c in "rgb"]).T
    if "chad" in tags:
        adapted = np.array(_fixed(tags["chad"][8:44])).reshape(3, 3)
    else:
        white = np.array(_fixed(tags["wtpt"][8:20])) if "wtpt" in tags else np.array(_D50)
        adapted = adaptation(white, np.array(_D50))
    return _rising(curves, chromaticities_of(np.linalg.inv(adapted) @ relative))


def _rising(curves: tuple[tuple[float, ...], ...], primaries: Chromaticities) -> Profile | None:
    """A profile of finite numbers whose curves rise from black to white, so that none is flat."""
    if not np.isfinite([*primaries, *np.ravel(curves)]).all() or (np.diff(curves) < 0).any():
        return None
    rises = all(curve[-1] - curve[0] > _LEAST_RISE for curve in curves)
    return Profile(curves, primaries) if rises else None


def _tags(data: bytes) -> dict[str, bytes]:
    (count,) = struct.unpack_from(">I", data, _HEAD)
    entries = struct.iter_unpack(">4sII", data[_HEAD + 4 : _HEAD + 4 + 12 * min(count, _MAX_TAGS)])
    return {
        name.decode("latin-1"): data[start : start + size]
        for name, start, size in entries
        if start + size <= len(data)
    }


def _fixed(data: bytes) -> tuple[float, ...]:
    """Numbers of 16 bits before and 16 behind the point."""
    return tuple(value / 65536 for (value,) in struct.iter_unpack(">i", data))


def _curve(data: bytes) -> tuple[float, ...]:
    steps = np.linspace(0, 1, _SAMPLES)
    if data[:4] == b"para":
        parameters = _PARAMETERS[struct.unpack_from(">H", data, 8)[0]]
        return tuple(_parametric(steps, _fixed(data[12 : 12 + 4 * parameters])).tolist())
    if data[:4] != b"curv":
        raise ValueError("a curve of no known type")
    count: int = struct.unpack_from(">I", data, 8)[0]
    if count == 0:
        return tuple(steps.tolist())
    numbers = np.frombuffer(data, ">u2", count, 12)
    if count == 1:
        return tuple((steps ** (float(numbers[0]) / 256)).tolist())
    return tuple(np.interp(steps, np.linspace(0, 1, count), numbers / 65535).tolist())


def _parametric(x: NDArray[np.float64], numbers: tuple[float, ...]) -> NDArray[np.float64]:
    """A curve of 1, 3, 4, 5 or 7 numbers, as ICC.1:2022, table 68, has them."""
    g, a, b = numbers[:3] if len(numbers) > 1 else (numbers[0], 1.0, 0.0)
    inner = a * x + b
    curved = np.maximum(inner, 0.0) ** g
    if len(numbers) < 5:
        return curved + (numbers[3] if len(numbers) == 4 else 0.0)
    slope, start = numbers[3:5]
    above, below = numbers[5:7] if len(numbers) == 7 else (0.0, 0.0)
    return np.where(x >= start, curved + above, slope * x + below)

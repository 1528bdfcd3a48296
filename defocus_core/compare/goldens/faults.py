"""Faults planted into a golden, to see whether its thresholds notice them.

Each is planted at full strength, which every threshold must notice, and then at half of that, a
quarter, and so on: the weakest that is still noticed says how sharp a threshold is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.comparison import compare_pictures
from defocus_core.compare.findings.geometry import view_partner
from defocus_core.compare.picture import DecodedPicture, color_layers, is_map, read_picture
from defocus_core.compare.record import CompareSettings
from defocus_core.compare.thresholds import Rules
from defocus_core.io.images.color_space import linear_to_srgb, srgb_to_linear

_WEAKEST = 12  # halvings that are tried
_BLOCK = 8  # px of the side of a block of NaN, or of a highlight that is lost


@dataclass(frozen=True)
class Fault:
    """A fault.

    Attributes:
        name: in words, at full strength.
        plant: makes a plane [H, W] of a plane and a strength of at most 1.
        unit: the strength of 1 in words of the fault, as a number and a unit.
        scales: whether weaker ones make sense.
    """

    name: str
    plant: Callable[[NDArray[Any], float], NDArray[Any]]
    unit: tuple[float, str] = (1.0, "")
    scales: bool = True


@dataclass(frozen=True)
class Planted:
    """How the thresholds of a golden met a fault.

    Attributes:
        fault: its name.
        noticed: whether full strength fails.
        weakest: the weakest that fails, in words; empty if none does, or there is one strength.
    """

    fault: str
    noticed: bool
    weakest: str = ""


def plant_all(
    picture: DecodedPicture, name: str, rules: Rules, settings: CompareSettings
) -> list[Planted]:
    """Plant each fault into a golden, and judge it by its rules.

    Faults that change nothing, as a lost highlight in a black picture, are left out.

    Raises:
        InputError: a mask or CoC map cannot be read.
        UsageProblem: the region is not within the picture.
    """
    settings = replace(settings, diagnose=False)
    other_view = _other_view(picture)
    names = [n for layer in color_layers(list(picture.planes)) for n in layer]
    if is_map(list(picture.planes)) or not names:
        names = list(picture.planes)

    def noticed(fault: Fault, strength: float) -> bool | None:
        """Whether it fails; None if it changes no value."""
        if fault is SWAPPED and other_view is not None:
            spoiled = other_view
        else:
            spoiled = _spoiled(picture, names, fault, strength)
        if _is_equal(picture, spoiled):
            return None
        record, _ = compare_pictures(name, picture, spoiled, rules, settings)
        return not record.passes

    results = []
    for fault in FAULTS:
        full = noticed(fault, 1.0)
        if full is None:
            continue
        weakest = ""
        if full and fault.scales:
            minimum = 1.0
            for strength in (0.5**k for k in range(1, _WEAKEST + 1)):
                if not noticed(fault, strength):
                    break
                minimum = strength
            amount, unit = fault.unit
            weakest = f"{amount * minimum:.2g}{unit}"
        results.append(Planted(fault.name, full, weakest))
    return results


def _other_view(picture: DecodedPicture) -> DecodedPicture | None:
    """The golden that is the other of the left and right view, if there is one."""
    partner = view_partner(picture.path)
    return None if partner is None else read_picture(partner)


def _spoiled(
    picture: DecodedPicture, names: list[str], fault: Fault, strength: float
) -> DecodedPicture:
    planes = dict(picture.planes)
    for name in names:
        plane = np.asarray(planes[name], np.float32)
        planes[name] = np.asarray(fault.plant(plane, strength), np.float32)
    return replace(picture, planes=planes)


def _is_equal(a: DecodedPicture, b: DecodedPicture) -> bool:
    return a.planes.keys() == b.planes.keys() and all(
        np.array_equal(plane, b.planes[name], equal_nan=plane.dtype.kind == "f")
        for name, plane in a.planes.items()
    )


def _nan_block(plane: NDArray[Any], strength: float) -> NDArray[Any]:
    spoiled = plane.copy()
    spoiled[_middle(plane)] = np.nan
    return spoiled


def _shifted(plane: NDArray[Any], strength: float) -> NDArray[Any]:
    """To the right, by linear interpolation; the first column stays."""
    spoiled = plane.copy()
    spoiled[:, 1:] += strength * (plane[:, :-1] - plane[:, 1:])
    return spoiled


def _gamma(plane: NDArray[Any], strength: float) -> NDArray[Any]:
    encoded = linear_to_srgb(np.abs(plane)) ** np.float32(1 + 0.02 * strength)
    changed: NDArray[Any] = np.sign(plane) * srgb_to_linear(encoded)
    return changed


def _mirrored(plane: NDArray[Any], strength: float) -> NDArray[Any]:
    return plane[:, ::-1]


def _lost_highlight(plane: NDArray[Any], strength: float) -> NDArray[Any]:
    """The brightest place and its neighbours become as dark as the mean."""
    spoiled = plane.copy()
    row, column = np.unravel_index(int(np.nan_to_num(plane).argmax()), plane.shape)
    top, left = (max(0, int(place) - _BLOCK // 2) for place in (row, column))
    block = (slice(top, top + _BLOCK), slice(left, left + _BLOCK))
    level = np.float32(np.nan_to_num(plane).mean())
    spoiled[block] += np.float32(strength) * (np.minimum(plane[block], level) - plane[block])
    return spoiled


def _noise(plane: NDArray[Any], strength: float) -> NDArray[Any]:
    """Of 1 % of the mean, with a spread that all planes share."""
    level = float(np.abs(np.nan_to_num(plane)).mean())
    noise = np.random.default_rng(0).standard_normal(plane.shape)
    return plane + 0.01 * strength * level * noise


def _middle(plane: NDArray[np.float32]) -> tuple[slice, slice]:
    height, width = plane.shape
    top, left = max(0, (height - _BLOCK) // 2), max(0, (width - _BLOCK) // 2)
    return slice(top, top + _BLOCK), slice(left, left + _BLOCK)


def _half_resolution(plane: NDArray[Any], strength: float) -> NDArray[Any]:
    """Towards the mean of each 2 x 2 pixels."""
    height, width = (n // 2 * 2 for n in plane.shape)
    spoiled = plane.copy()
    inner = plane[:height, :width]
    means = inner.reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3))
    coarse = np.repeat(np.repeat(means, 2, axis=0), 2, axis=1)
    spoiled[:height, :width] += strength * (coarse - inner)
    return spoiled


def _seams(plane: NDArray[Any], strength: float) -> NDArray[Any]:
    """A line of 3 % less at multiples of 16 px, or in the middle of a smaller picture."""
    spoiled = plane.copy()
    for axis, length in enumerate(plane.shape):
        lines = range(min(16, length // 2), length, 16)
        index = (list(lines),) if axis == 0 else (slice(None), list(lines))
        spoiled[index] *= 1 - 0.03 * strength
    return spoiled


def _times(amount: float) -> Callable[[NDArray[Any], float], NDArray[Any]]:
    return lambda plane, strength: plane * (1 + amount * strength)


def _clipped(plane: NDArray[Any], strength: float) -> NDArray[Any]:
    clipped: NDArray[Any] = np.minimum(plane, 1.0)
    return clipped


def _raised(plane: NDArray[Any], strength: float) -> NDArray[Any]:
    return plane + 0.01 * strength


def _quantised(plane: NDArray[Any], strength: float) -> NDArray[Any]:
    rounded: NDArray[Any] = np.round(plane * 63) / 63
    return rounded


def _vignette(plane: NDArray[Any], strength: float) -> NDArray[Any]:
    y, x = (np.linspace(-1, 1, n) for n in plane.shape)
    return plane * (1 - 0.05 * strength * (y[:, None] ** 2 + x * x))


def _firefly(plane: NDArray[Any], strength: float) -> NDArray[Any]:
    spoiled = plane.copy()
    spoiled[plane.shape[0] // 3, plane.shape[1] // 3] += 5.0 * strength
    return spoiled


def _fields(plane: NDArray[Any], strength: float) -> NDArray[Any]:
    rows = np.arange(len(plane)) ^ 1
    swapped: NDArray[Any] = plane[rows.clip(0, len(plane) - 1)]
    return swapped


# The other view where there is one, else the picture mirrored.
SWAPPED = Fault("left and right swapped", _mirrored, scales=False)
FAULTS = (
    Fault("a block of NaN", _nan_block, scales=False),
    Fault("shifted by 1 px", _shifted, (1.0, " px")),
    Fault("gamma 2 %", _gamma, (2.0, " %")),
    SWAPPED,
    Fault("a lost highlight", _lost_highlight, (100.0, " % of it")),
    Fault("noise of 1 %", _noise, (1.0, " %")),
    Fault("clipped at 1", _clipped, scales=False),
    Fault("exposure of 2 %", _times(0.02), (2.0, " %")),
    Fault("raised blacks", _raised, (0.01, "")),
    Fault("vignette of 10 %", _vignette, (10.0, " %")),
    Fault("half resolution", _half_resolution, (100.0, " % of it")),
    Fault("seams of 3 %", _seams, (3.0, " %")),
    Fault("fields exchanged", _fields, scales=False),
    Fault("quantised to 6 bits", _quantised, scales=False),
    Fault("a firefly", _firefly, (5.0, "")),
)

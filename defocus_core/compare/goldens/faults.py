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
from defocus_core.compare.pairing import view_partner
from defocus_core.compare.picture import DecodedPicture, color_layers, is_map, read_picture
from defocus_core.compare.record import PASSING, WARNING, CompareSettings
from defocus_core.compare.thresholds import Rules
from defocus_core.io.images.color_space import linear_to_srgb, srgb_to_linear

_WEAKEST = 12  # halvings that are tried
_BLOCK = 8  # px of the side of a block of NaN, or of a highlight that is lost


@dataclass(frozen=True)
class Fault:
    """A fault."""

    name: str  # in words, at full strength
    # Makes planes [C, H, W] of planes and a strength of at most 1
    plant: Callable[[NDArray[Any], float], NDArray[Any]]
    # The strength of 1 in words of the fault, as a number and a unit
    unit: tuple[float, str] = (1.0, "")
    scales: bool = True  # whether weaker ones make sense


@dataclass(frozen=True)
class Planted:
    """How the thresholds of a golden met a fault."""

    fault: str
    noticed: bool  # whether full strength fails
    # The weakest that fails, in words; empty if none does, or there is one strength
    weakest: str = ""
    warned: bool = False  # whether full strength passes with a warning

    @property
    def is_silent(self) -> bool:
        """Whether it passes without a word."""
        return not (self.noticed or self.warned)


def plant_all(
    picture: DecodedPicture, name: str, rules: Rules, settings: CompareSettings
) -> list[Planted]:
    """Plant each fault into a golden, and judge it by its rules.

    Faults that change nothing, as a lost highlight in a black picture, are left out.
    """
    settings = replace(settings, diagnose=False)
    other_view = _other_view(picture)
    names = [n for layer in color_layers(list(picture.planes)) for n in layer]
    if is_map(list(picture.planes)) or not names:
        names = list(picture.planes)

    def status(fault: Fault, strength: float) -> str | None:
        """What the rules say of it; None if it changes no value."""
        if fault is SWAPPED and other_view is not None:
            spoiled = other_view
        else:
            spoiled = _spoiled(picture, names, fault, strength)
        if _is_equal(picture, spoiled):
            return None
        record, _ = compare_pictures(name, picture, spoiled, rules, settings)
        return record.status

    results = []
    for fault in FAULTS:
        full = status(fault, 1.0)
        if full is None:
            continue
        weakest = ""
        noticed = full not in PASSING
        if noticed and fault.scales:
            minimum = 1.0
            for strength in (0.5**k for k in range(1, _WEAKEST + 1)):
                if status(fault, strength) in (*PASSING, None):
                    break
                minimum = strength
            amount, unit = fault.unit
            weakest = f"{float(f'{amount * minimum:.2g}'):g}{unit}"
        results.append(Planted(fault.name, noticed, weakest, full == WARNING))
    return results


def _other_view(picture: DecodedPicture) -> DecodedPicture | None:
    """The golden that is the other of the left and right view, if there is one."""
    partner = view_partner(picture.path)
    return None if partner is None else read_picture(partner)


def _spoiled(
    picture: DecodedPicture, names: list[str], fault: Fault, strength: float
) -> DecodedPicture:
    shape = picture.planes[names[0]].shape
    chosen = [name for name in names if picture.planes[name].shape == shape]
    planes = np.stack([np.asarray(picture.planes[name], np.float32) for name in chosen])
    spoiled = np.asarray(fault.plant(planes, strength), np.float32)
    return replace(picture, planes={**picture.planes, **dict(zip(chosen, spoiled, strict=True))})


def _is_equal(a: DecodedPicture, b: DecodedPicture) -> bool:
    return a.planes.keys() == b.planes.keys() and all(
        np.array_equal(plane, b.planes[name], equal_nan=plane.dtype.kind == "f")
        for name, plane in a.planes.items()
    )


def _nan_block(planes: NDArray[Any], strength: float) -> NDArray[Any]:
    spoiled = planes.copy()
    height, width = planes.shape[1:]
    top, left = max(0, (height - _BLOCK) // 2), max(0, (width - _BLOCK) // 2)
    spoiled[:, top : top + _BLOCK, left : left + _BLOCK] = np.nan
    return spoiled


def _shifted(planes: NDArray[Any], strength: float) -> NDArray[Any]:
    """To the right, by linear interpolation; the first column stays."""
    spoiled = planes.copy()
    spoiled[..., 1:] += strength * (planes[..., :-1] - planes[..., 1:])
    return spoiled


def _blurred(planes: NDArray[Any], strength: float) -> NDArray[Any]:
    """Towards the mean of 3 x 3 pixels."""
    padded = np.pad(planes, ((0, 0), (1, 1), (1, 1)), mode="edge")
    height, width = planes.shape[1:]
    mean = sum(padded[:, y : y + height, x : x + width] for y, x in np.ndindex(3, 3)) / 9
    blurred: NDArray[Any] = planes + strength * (mean - planes)
    return blurred


def _gamma(planes: NDArray[Any], strength: float) -> NDArray[Any]:
    """A power of 1.02 of sRGB-encoded values, the mirror image below 0; light beyond 1, too."""
    shown = linear_to_srgb(np.abs(planes)) ** (1 + 0.02 * strength)
    signed: NDArray[Any] = np.copysign(srgb_to_linear(shown), planes)
    return signed


def _mirrored(planes: NDArray[Any], strength: float) -> NDArray[Any]:
    return planes[..., ::-1]


def _lost_highlight(planes: NDArray[Any], strength: float) -> NDArray[Any]:
    """The brightest place of each plane and its neighbours become as dark as the mean."""
    spoiled = planes.copy()
    for plane, changed in zip(planes, spoiled, strict=True):
        row, column = np.unravel_index(int(np.nan_to_num(plane).argmax()), plane.shape)
        top, left = (max(0, int(place) - _BLOCK // 2) for place in (row, column))
        block = (slice(top, top + _BLOCK), slice(left, left + _BLOCK))
        level = np.float32(np.nan_to_num(plane).mean())
        changed[block] += np.float32(strength) * (np.minimum(plane[block], level) - plane[block])
    return spoiled


def _noise(planes: NDArray[Any], strength: float) -> NDArray[Any]:
    """Of 1 % of the mean of each plane, with a spread that all planes share."""
    level = np.abs(np.nan_to_num(planes)).mean(axis=(1, 2), keepdims=True)
    noise = np.random.default_rng(0).standard_normal(planes.shape[1:])
    noisy: NDArray[Any] = planes + 0.01 * strength * level * noise
    return noisy


def _seams(planes: NDArray[Any], strength: float) -> NDArray[Any]:
    """A line of 3 % less at multiples of 16 px, or in the middle of a smaller picture."""
    spoiled = planes.copy()
    rows, columns = (slice(min(16, n // 2), n, 16) for n in planes.shape[1:])
    spoiled[:, rows] *= 1 - 0.03 * strength
    spoiled[:, :, columns] *= 1 - 0.03 * strength
    return spoiled


def _tinted(planes: NDArray[Any], strength: float) -> NDArray[Any]:
    """The first channel brighter, and the last darker; one channel stays."""
    gains = np.linspace(0.01, -0.01, len(planes)) if len(planes) > 1 else np.zeros(1)
    return planes * (1 + strength * gains[:, None, None])


def _firefly(planes: NDArray[Any], strength: float) -> NDArray[Any]:
    spoiled = planes.copy()
    spoiled[:, planes.shape[1] // 3, planes.shape[2] // 3] += 5.0 * strength
    return spoiled


# The other view where there is one, else the picture mirrored.
SWAPPED = Fault("left and right swapped", _mirrored, scales=False)
FAULTS = (
    Fault("a block of NaN", _nan_block, scales=False),
    Fault("shifted by 1 px", _shifted, (1.0, " px")),
    Fault("blurred by 1 px", _blurred, (100.0, " % of it")),
    Fault("gamma 2 %", _gamma, (2.0, " %")),
    SWAPPED,
    Fault("a lost highlight", _lost_highlight, (100.0, " % of it")),
    Fault("noise of 1 %", _noise, (1.0, " %")),
    Fault("clipped at 1", lambda planes, _: np.minimum(planes, 1.0), scales=False),
    Fault("exposure of 2 %", lambda planes, strength: planes * (1 + 0.02 * strength), (2.0, " %")),
    Fault("a tint of 1 %", _tinted, (1.0, " %")),
    Fault("raised blacks", lambda planes, strength: planes + 0.01 * strength, (0.01, "")),
    Fault("seams of 3 %", _seams, (3.0, " %")),
    Fault("quantised to 6 bits", lambda planes, _: np.round(planes * 63) / 63, scales=False),
    Fault("a firefly", _firefly, (5.0, "")),
)

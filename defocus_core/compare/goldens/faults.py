"""Faults planted into a golden, to see whether its thresholds notice them.

Each is planted at full strength, which every threshold must notice, and then mixed with the golden
by a half, a quarter, and so on: the weakest that is still noticed says how sharp a threshold is.
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
    plant: Callable[[NDArray[Any]], NDArray[Any]]  # makes planes [C, H, W] of planes
    # Full strength in words, as a number and a unit; None if weaker ones make no sense
    unit: tuple[float, str] | None = None


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
    partner = view_partner(picture.path)  # the other of the left and right view
    names = [n for layer in color_layers(list(picture.planes)) for n in layer]
    if is_map(list(picture.planes)) or not names:
        names = list(picture.planes)

    def status(spoiled: DecodedPicture) -> str | None:
        """What the rules say of it; None if it changes no value."""
        if _is_equal(picture, spoiled):
            return None
        return compare_pictures(name, picture, spoiled, rules, settings)[0].status

    results = []
    for fault in FAULTS:
        spoiled = _spoiled(picture, names, fault, 1.0)
        if fault is SWAPPED and partner is not None:
            spoiled = read_picture(partner)
        full = status(spoiled)
        if full is None:
            continue
        weakest, noticed = "", full not in PASSING
        if noticed and fault.unit is not None:
            minimum, (amount, unit) = 1.0, fault.unit
            for strength in (0.5**k for k in range(1, _WEAKEST + 1)):
                if status(_spoiled(picture, names, fault, strength)) in (*PASSING, None):
                    break
                minimum = strength
            weakest = f"{float(f'{amount * minimum:.2g}'):g}{unit}"
        results.append(Planted(fault.name, noticed, weakest, full == WARNING))
    return results


def _spoiled(
    picture: DecodedPicture, names: list[str], fault: Fault, strength: float
) -> DecodedPicture:
    shape = picture.planes[names[0]].shape
    chosen = [name for name in names if picture.planes[name].shape == shape]
    planes = np.stack([np.asarray(picture.planes[name], np.float32) for name in chosen])
    spoiled = np.asarray(fault.plant(planes), np.float32)
    if strength < 1.0:
        mixed = planes + np.float32(strength) * (spoiled - planes)
        spoiled = np.where(spoiled == planes, planes, mixed)  # infinity stays
    return replace(picture, planes={**picture.planes, **dict(zip(chosen, spoiled, strict=True))})


def _is_equal(a: DecodedPicture, b: DecodedPicture) -> bool:
    return a.planes.keys() == b.planes.keys() and all(
        np.array_equal(plane, b.planes[name], equal_nan=plane.dtype.kind == "f")
        for name, plane in a.planes.items()
    )


def _nan_block(planes: NDArray[Any]) -> NDArray[Any]:
    spoiled = planes.copy()
    top, left = (max(0, (length - _BLOCK) // 2) for length in planes.shape[1:])
    spoiled[:, top : top + _BLOCK, left : left + _BLOCK] = np.nan
    return spoiled


def _shifted(planes: NDArray[Any]) -> NDArray[Any]:
    """To the right; the first column stays."""
    return np.concatenate([planes[..., :1], planes[..., :-1]], axis=-1)


def _blurred(planes: NDArray[Any]) -> NDArray[Any]:
    """The mean of 3 x 3 pixels."""
    padded = np.pad(planes, ((0, 0), (1, 1), (1, 1)), mode="edge")
    height, width = planes.shape[1:]
    parts = [padded[:, y : y + height, x : x + width] for y, x in np.ndindex(3, 3)]
    return np.asarray(sum(parts) / 9)


def _gamma(planes: NDArray[Any]) -> NDArray[Any]:
    """A power of 1.02 of sRGB-encoded values, the mirror image below 0; light beyond 1, too."""
    shown = linear_to_srgb(np.abs(planes)) ** 1.02
    return np.asarray(np.copysign(srgb_to_linear(shown), planes))


def _lost_highlight(planes: NDArray[Any]) -> NDArray[Any]:
    """The brightest place of each plane and its neighbours become as dark as the mean."""
    spoiled = planes.copy()
    for plane, changed in zip(np.nan_to_num(planes), spoiled, strict=True):
        row, column = np.unravel_index(int(plane.argmax()), plane.shape)
        top, left = (max(0, int(place) - _BLOCK // 2) for place in (row, column))
        block = changed[top : top + _BLOCK, left : left + _BLOCK]
        np.minimum(block, plane.mean(), out=block)
    return spoiled


def _noise(planes: NDArray[Any]) -> NDArray[Any]:
    """Of 1 % of the mean of each plane, with a spread that all planes share."""
    level = np.abs(np.nan_to_num(planes)).mean(axis=(1, 2), keepdims=True)
    noise = np.random.default_rng(0).standard_normal(planes.shape[1:])
    return np.asarray(planes + 0.01 * level * noise)


def _seams(planes: NDArray[Any]) -> NDArray[Any]:
    """A line of 3 % less at multiples of 16 px, or in the middle of a smaller picture."""
    spoiled = planes.copy()
    rows, columns = (slice(min(16, n // 2), n, 16) for n in planes.shape[1:])
    spoiled[:, rows] *= 0.97
    spoiled[:, :, columns] *= 0.97
    return spoiled


def _tinted(planes: NDArray[Any]) -> NDArray[Any]:
    """The first channel brighter, and the last darker; one channel stays."""
    gains = np.linspace(0.01, -0.01, len(planes)) if len(planes) > 1 else np.zeros(1)
    return planes * (1 + gains[:, None, None])


def _firefly(planes: NDArray[Any]) -> NDArray[Any]:
    spoiled = planes.copy()
    spoiled[:, planes.shape[1] // 3, planes.shape[2] // 3] += 5.0
    return spoiled


# The other view where there is one, else the picture mirrored.
SWAPPED = Fault("left and right swapped", lambda planes: planes[..., ::-1])
FAULTS = (
    Fault("a block of NaN", _nan_block),
    Fault("shifted by 1 px", _shifted, (1.0, " px")),
    Fault("blurred by 1 px", _blurred, (100.0, " % of it")),
    Fault("gamma 2 %", _gamma, (2.0, " %")),
    SWAPPED,
    Fault("a lost highlight", _lost_highlight, (100.0, " % of it")),
    Fault("noise of 1 %", _noise, (1.0, " %")),
    Fault("clipped at 1", lambda planes: np.minimum(planes, 1.0)),
    Fault("exposure of 2 %", lambda planes: planes * 1.02, (2.0, " %")),
    Fault("a tint of 1 %", _tinted, (1.0, " %")),
    Fault("raised blacks", lambda planes: planes + 0.01, (0.01, "")),
    Fault("seams of 3 %", _seams, (3.0, " %")),
    Fault("quantised to 6 bits", lambda planes: np.round(planes * 63) / 63),
    Fault("a firefly", _firefly, (5.0, "")),
)

"""Lens options in a picture's metadata: OpenEXR's attributes, V-Ray's, or Exif.

OpenEXR's standard attributes (openexr.com, "Standard Attributes") are ``focus`` in metres, infinity
allowed; ``aperture``, the f-number, or else ``tStop``; focal lengths in mm; the pitch of the
photosites in micrometres and the rectangle of them that was read. V-Ray's ``camera…`` are in mm,
but the target distance is in the unit of the scene and of its depth.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from defocus_core.io.exr.header import Raw, is_exr, read_headers
from defocus_core.io.exr.windows import Window
from defocus_core.io.images.raster import read_pages
from defocus_core.io.read_files import read_head

_FORMATS = {"float": "<f", "double": "<d", "int": "<i"}
_NO_TARGET = 1e9  # V-Ray's target distance if there is no target
_FILM_DIAGONAL = math.hypot(36, 24)  # mm; CIPA DCG-001 defines equivalent focal lengths by it
_INFINITE = 4e9  # m; Exif writes infinity as 2³² − 1, which floats round


class OptionFromMetadata(NamedTuple):
    """The value of a lens option as text, and the attribute from which it was read."""

    text: str
    attribute: str


Numbers = Mapping[str, float]
# Makes an option's value from the number of an attribute and all numbers of the file; NaN for none
Rule = Callable[[float, Numbers], float]


def _same(value: float, _: Numbers) -> float:
    return value


def _equivalent(value: float, numbers: Numbers) -> float:
    """The width in mm of a sensor, given the equivalent focal length on 35 mm film, `value`."""
    foclen, width, height = (numbers.get(n, 0.0) for n in ("Exif:FocalLength", "width", "height"))
    if not (foclen > 0 and value > 0 and width > 0):
        return math.nan
    return float(f"{_FILM_DIAGONAL * foclen / value * width / math.hypot(width, height):.6g}")


_FOCAL_LENGTHS = [f"{of}FocalLength" for of in ("pinhole", "effective", "nominal", "camera")]
_FNUMBERS = ("aperture", "tStop", "cameraFNumber")
# The unit of each option, and the rules of its attributes in order of preference.
_RULES: dict[str, tuple[str, dict[str, Rule]]] = {
    "focal-length": ("mm", dict.fromkeys((*_FOCAL_LENGTHS, "Exif:FocalLength"), _same)),
    "fnumber": ("", dict.fromkeys((*_FNUMBERS, "Exif:FNumber", "FNumber"), _same)),
    "sensor-width": (
        "mm",
        {
            "sensorPhotositePitch": lambda pitch, of: pitch * of.get("columns", 0.0) / 1000,
            "cameraAperture": _same,
            "Exif:FocalLengthIn35mmFilm": _equivalent,
        },
    ),
    "focus": (
        "m",
        {
            "focus": _same,
            # V-Ray's, in the unit of the scene
            "cameraTargetDistance": lambda z, of: z * of["metres"] if z < _NO_TARGET else math.nan,
            "Exif:SubjectDistance": lambda z, _: math.inf if z > _INFINITE else z,
        },
    ),
}


def lens_of(path: Path, metres: float = 1.0) -> dict[str, OptionFromMetadata]:
    """The lens options that the metadata of a colour file gives, by name of the option.

    `metres`: metres per unit of the scene.
    """
    numbers = {**_numbers(path), "metres": metres}
    taken: dict[str, OptionFromMetadata] = {}
    for option, (unit, rules) in _RULES.items():
        for name in (name for name in rules if name in numbers and option not in taken):
            value = rules[name](numbers[name], numbers)
            if 0 < value < math.inf or (value == math.inf and option == "focus"):
                text = f"{value:.7g}{unit}" if value < math.inf else "inf"
                taken[option] = OptionFromMetadata(text, name)
    return taken


def _numbers(path: Path) -> dict[str, float]:
    """The numeric metadata of a file by name.

    For EXR, ``columns`` counts the photosites in a row; other files have ``width`` and ``height``.
    """
    if not is_exr(read_head(path)):
        page = read_pages(path)[0]
        said = {n: tag.value for n, tag in page.tags.items() if isinstance(tag.value, int | float)}
        return {**said, "width": page.width, "height": page.height}
    numbers: dict[str, float] = {}
    for header in read_headers(path):
        for name, raw in header.attributes.items():
            if name == "sensorAcquisitionRectangle" and len(raw.value) == 16:
                numbers.setdefault("columns", Window(*struct.unpack("<4i", raw.value)).width)
            elif (value := _number(raw)) is not None:
                numbers.setdefault(name, value)
    return numbers


def _number(raw: Raw) -> float | None:
    """The number that an attribute holds, as a number or as text; None if it holds none."""
    try:
        if raw.kind == "string":
            return float(raw.value.decode())
        if raw.kind == "rational":
            above, below = struct.unpack("<iI", raw.value)
            return float(above / below)
        (value,) = struct.unpack(_FORMATS[raw.kind], raw.value)
        return float(value)
    except (KeyError, ValueError, ArithmeticError, struct.error):
        return None

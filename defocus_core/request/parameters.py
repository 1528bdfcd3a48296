"""The table of lens options, with a row for each.

Everything that shows or reads a lens option is made from its row: options of commands, keys of TOML
files, columns of lists, sweeps, keyframes, records, file headers, and commands in reports.
`LensValues` holds the values. The options take effect in `picture.opening` (the pupil),
`picture.radii` (the blur radii), or an optional step of `picture`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from defocus_core.allowed_values import DUAL_PIXEL_MODELS, DUAL_PIXEL_SENSORS
from defocus_core.request import quantities
from defocus_core.request.quantities import Percentile, SideShare, Unitless, length_text

METADATA = "lens-from-metadata"  # option and key: metadata of a picture give its lens
# Scales of sweeps and of interpolation between keys: conversion to each, and back.
SCALES: dict[str, tuple[Callable[[float], float], Callable[[float], float]]] = {
    "depth": (float, float),
    "steps": (float, float),
    "log": (math.log, math.exp),
    "disparity": (lambda z: 1 / z, lambda x: math.inf if x == 0 else 1 / x),
}


@dataclass(frozen=True, kw_only=True)
class Param:
    """An option: its names, the parser of its value, its units and its help text."""

    name: str  # name of the option, and of the key of a TOML file
    key: str = ""  # key of a TOML file, if different
    only: str = ""  # ``files`` or ``commands``, if only these have it
    help: str = ""  # help; other options are in angle quotes
    parse: Callable[[str], Any] = str  # parser of its text; raises QuantityError
    metavar: str = ""  # placeholder of the value, in help
    stored_as: str = ""  # the field of its value, if not its name with underscores
    unit: str = ""  # unit of each number, which a text must have
    optional_unit: str = ""  # optional unit, which is written for people
    # separator of the numbers or words of its value, if several
    separator: str = ""
    instead_of: str = ""  # an alternative option of the same meaning
    choices: Sequence[str] = ()  # the words to choose from, if any
    heading: str = "Options"  # heading in help
    is_common: bool = False  # whether short help shows it
    flag: bool = False  # whether it has no value: if given, the field is set to its name
    toggle: bool = False  # whether it is a switch without a text: on, off, or not given
    words: int = 1  # number of texts on a command line
    multiple: bool = False  # whether a command line may repeat it
    is_path: bool = False  # whether it names a file, or files

    def __post_init__(self) -> None:
        """Accept exactly the words in `choices`, if there are any and no parser is given."""
        if self.choices and self.parse is str:
            object.__setattr__(self, "parse", quantities.one_of(self.choices, "unknown-name"))

    @property
    def field(self) -> str:
        """The name of the field that holds the value."""
        return self.stored_as or self.name.replace("-", "_")

    def text(self, value: object, digits: int | None = None) -> str:
        """A value as text that `parse` reads back, with `digits` significant digits or all."""

        def write(number: float) -> str:
            text = f"{number:.{digits}g}" if digits else f"{number}".removesuffix(".0")
            return text + self.unit

        return self._join(value, write)

    def shown(self, value: object, digits: int = 6) -> str:
        """A value as text for people, with lengths of 1 m or more in metres."""
        if self.unit == "mm":
            return self._join(value, lambda number: length_text(number, digits))
        return self.text(value, digits)

    def _join(self, value: object, write: Callable[[float], str]) -> str:
        if isinstance(value, Unitless):
            return self.separator.join(f"{number:.9g}" for number in value)
        if isinstance(value, tuple | list):
            return self.separator.join(self._join(each, write) for each in value)
        if value is None or isinstance(value, bool):
            return "on" if value else "off"
        if isinstance(value, int | float):
            return write(value) if math.isfinite(value) else str(value)
        return str(value)  # words, paths and percentiles


@dataclass(frozen=True, kw_only=True)
class LensParam(Param):
    """An option of a lens."""

    heading: str = "Lens"
    tag: str  # tag in file names of a sweep
    example: str  # a value as a text
    # required, unless its alternative is given
    required: bool = False
    needs: str = ""  # the option without which it has no effect
    idle: str = ""  # the problem without that option
    is_optics: bool = False  # whether it decides radii: no effect beside a file of radii
    # the scale of its interpolation between keys of frames, as one number or several; empty for a
    # value that holds until the next key and is drawn by choice only
    even_in: str = "steps"
    bare_unit: str = ""  # unit of plain numbers at keys of frames, if different
    # its key in records of any lens; empty if its field is recorded only when on
    recorded_as: str = ""
    file_field: str = ""  # the field of the path, if the value may be a file
    never_off: bool = False  # whether every lens has it, so that it is not an effect

    def recorded(self, value: object) -> object:
        """A value for records: name of a path, text of a tuple or share, "inf", or None for NaN."""
        if isinstance(value, Path):
            return value.name
        if isinstance(value, tuple | SideShare):
            return self.shown(value)
        if isinstance(value, float) and not math.isfinite(value):
            return None if math.isnan(value) else "inf"
        return value

    def with_unit(self, text: str) -> str:
        """The text of a value at a keyframe, with the default unit added to a plain number."""
        try:
            is_bare = math.isfinite(float(text))
        except ValueError:
            is_bare = False
        unit = self.bare_unit or ("" if self.separator else self.unit)
        return f"{text.strip()}{unit}" if is_bare else text

    def file_tag(self, value: object) -> str:
        """The part of a file name that tells a value: ``focus2m``, ``f1.4``, ``at240x135``."""
        if isinstance(value, Path):
            text = value.stem
        elif isinstance(value, Percentile):
            text = f"p{value.percent:.6g}"
        elif isinstance(value, Unitless) and self.separator == "..":
            text = "-".join(f"{end:.6g}" for end in value)
        elif isinstance(value, tuple) and self.separator == "..":
            text = "-".join(map(self.shown, value))
        elif isinstance(value, tuple):
            text = "x".join(map(str, value))
        else:
            text = self.shown(value)
        return self.tag + text


_ROWS = (
    LensParam(
        name="focal-length",
        is_common=True,
        parse=quantities.length,
        metavar="LENGTH",
        help="Focal length of the lens, like 50mm. A lens needs focal length, f-number and focus.",
        tag="fl",
        example="50mm",
        stored_as="foclen",
        recorded_as="focal_length_mm",
        unit="mm",
        even_in="log",
        required=True,
        is_optics=True,
    ),
    LensParam(
        name="fnumber",
        is_common=True,
        parse=quantities.fnumber,
        metavar="N",
        help="F-number of the lens, like 1.4; smaller numbers blur more.",
        tag="f",
        example="1.4",
        stored_as="fnum",
        recorded_as="fnumber",
        even_in="log",
        required=True,
        is_optics=True,
    ),
    LensParam(
        name="sensor-width",
        is_common=True,
        parse=quantities.length,
        metavar="LENGTH",
        help="Width of the sensor that took the picture, like 23.5mm; the picture spans it from "
        "left to right.  [default: 36mm]",
        tag="sensor",
        example="36mm",
        recorded_as="sensor_width_mm",
        unit="mm",
        even_in="log",
        is_optics=True,
    ),
    LensParam(
        name="focus",
        is_common=True,
        parse=quantities.focus,
        metavar="DISTANCE",
        help="Distance in focus, like 2m or inf; or a percentile of all depths in the picture: "
        "percentile(50) is the median.",
        tag="focus",
        example="2m",
        stored_as="foc_dist",
        recorded_as="focus_mm",
        unit="mm",
        bare_unit="m",
        even_in="disparity",
        required=True,
        is_optics=True,
    ),
    LensParam(
        name="focus-at",
        is_common=True,
        parse=quantities.pixel,
        metavar="X,Y",
        help="Focus on the depth of this pixel, like 640,360: its column and row, counted from 0 "
        "at the top left. Instead of ‹focus›.",
        tag="at",
        example="240,135",
        recorded_as="focus_at_px",
        separator=",",
        instead_of="focus",
        is_optics=True,
    ),
    LensParam(
        name="sharp-range",
        parse=quantities.sharp_range,
        metavar="A..B",
        help="Keep a range of distances sharp, too, like 1.8m..2.4m. With ‹blur› it is a range "
        "of numbers in the depth file, like 100..200.  [default: off]",
        tag="sharp",
        example="1.8m..2.4m",
        unit="mm",
        separator="..",
        even_in="disparity",
        is_optics=True,
    ),
    LensParam(
        name="blur",
        is_common=True,
        never_off=True,
        parse=quantities.blur,
        metavar="PX",
        help="Blur the most blurred pixel with this radius in px, like 40px, or with this share "
        "of the longer side of the picture, like 2%. It replaces the lens where depth has "
        "no unit: the numbers are then relative disparity, white near. Set the focus by "
        "‹focus-at› or ‹focus-value›.",
        tag="blur",
        example="40px",
        unit="px",
        even_in="log",
    ),
    LensParam(
        name="focus-value",
        is_common=True,
        never_off=True,
        parse=quantities.number,
        metavar="NUMBER",
        help="Focus on pixels with this number in the depth file, like 128. Only with ‹blur›.",
        tag="value",
        example="128",
        needs="blur",
        idle="has an effect only with a blur in pixels",
        instead_of="focus-at",
    ),
    LensParam(
        name="clamp-blur",
        parse=quantities.pixel_count,
        metavar="PX",
        help="Limit the radius of the blur to this number of px, like 60px; a message counts the "
        "pixels that it changes.  [default: no limit]",
        tag="clamp",
        example="60px",
        unit="px",
        even_in="log",
    ),
    LensParam(
        name="cat-eye",
        parse=quantities.rim,
        metavar="SIZE:DISTANCE",
        help="Clip discs away from the centre of the picture to cat's eyes, as the rim of a lens "
        "barrel does, like 1.05:1.5. SIZE is the radius of the rim, DISTANCE its distance "
        "from the aperture, both in radii of the aperture.  [default: off]",
        tag="rim",
        example="1.05:1.5",
        separator=":",
        is_optics=True,
    ),
    LensParam(
        name="axial-color",
        parse=quantities.shifts,
        metavar="RED:BLUE",
        help="Axial chromatic aberration, like 0.1mm:0.1mm: how much farther behind the lens red "
        "and blue come into focus than green. Positive values give green rims beyond the "
        "focus and magenta rims in front of it. With ‹blur›, give shares of the blur "
        "radius, like 0.05:0.05.  [default: off]",
        tag="axial",
        example="0.1mm:0.1mm",
        unit="mm",
        separator=":",
        is_optics=True,
    ),
    LensParam(
        name="vignetting",
        parse=quantities.switch,
        metavar="on|off",
        help="Darken each pixel by the light that the rim of ‹cat-eye› blocks.  [default: off]",
        even_in="",
        tag="vignetting",
        example="on",
        needs="cat-eye",
        idle="has no effect without a rim",
        is_optics=True,
    ),
    LensParam(
        name="blades",
        parse=quantities.blades,
        metavar="N",
        help="Number of aperture blades: 0 for a round aperture, 3 or more for a polygon "
        "inscribed in it.  [default: 0]",
        even_in="",
        tag="blades",
        example="6",
        recorded_as="blades",
    ),
    LensParam(
        name="blade-rotation",
        parse=quantities.angle,
        metavar="DEG",
        help="Turn the polygon of ‹blades› by this angle in degrees, counter-clockwise in the "
        "picture, for discs beyond the focus. At 0 a corner points to the right.  [default: "
        "0]",
        tag="turn",
        example="15",
        recorded_as="blade_rotation_deg",
        optional_unit="deg",
        needs="blades",
        idle="turns blades; this aperture has none",
    ),
    LensParam(
        name="blade-curvature",
        parse=quantities.quantity("a curvature", "like 0.5", least=0, most=1),
        metavar="0…1",
        help="Curvature of the ‹blades›, from 0 (straight) to 1 (round).  [default: 0]",
        tag="curve",
        example="0.5",
        needs="blades",
        idle="bends blades; this aperture has none",
    ),
    LensParam(
        name="obstruction",
        parse=quantities.quantity("a share of the radius", "like 0.4", least=0, most=0.95),
        metavar="0…0.95",
        help="Radius of the dark centre of a mirror lens, as a share of the radius of the "
        "aperture, like 0.4; discs become rings.  [default: 0]",
        tag="mirror",
        example="0.4",
    ),
    LensParam(
        name="spherical",
        parse=quantities.quantity("a spherical aberration", "like 0.5", least=-1, most=1),
        metavar="-1…1",
        help="Spherical aberration. Positive values give discs beyond the focus a bright rim and "
        "discs nearer than the focus a soft one; negative values do the reverse.  [default: "
        "0]",
        tag="ring",
        example="0.5",
    ),
    LensParam(
        name="squeeze",
        parse=quantities.quantity("a squeeze", "like 2", least=1, most=4),
        metavar="1…4",
        help="Squeeze factor of an anamorphic lens, like 2: discs are this many times as tall as "
        "wide.  [default: 1]",
        tag="squeeze",
        example="2",
        even_in="log",
    ),
    LensParam(
        name="aperture-image",
        parse=quantities.file,
        metavar="FILE",
        help="Picture of the aperture, instead of ‹blades›: EXR, PNG, TIFF, JPEG or NPY, in grey "
        "or RGB, where white is open. It shows the shape of discs beyond the focus; discs "
        "nearer than the focus are upside down.",
        even_in="",
        tag="pupil",
        example="pupil.png",
        file_field="aperture_image",
        instead_of="blades",
    ),
    LensParam(
        name="highlights",
        parse=quantities.highlights,
        metavar="auto|T:GAIN",
        help="Brighten the highlights that an 8- or 16-bit picture has clipped to white, so that "
        "their discs are bright: auto, or THRESHOLD:GAIN, like 0.93:8. Pixels above "
        "THRESHOLD, in linear light where white is 1, become brighter, white ones by up to "
        "GAIN times. Pictures with values above 1 do not change.  [default: off]",
        tag="lights",
        example="auto",
        separator=":",
    ),
    LensParam(
        name="dp-model",
        never_off=True,
        parse=quantities.dual_pixel((*DUAL_PIXEL_MODELS, *DUAL_PIXEL_SENSORS)),
        metavar="MODEL",
        help="What the two photodiodes of a dual pixel see, for left and right. split: one half "
        "of the aperture each, as an ideal sensor; smooth: the whole aperture, less and "
        "less towards the other side; @pixel4 or @canon-dpp: as measured on that sensor; or "
        "a file of measured kernels, like pair.npy.  [default: split]",
        even_in="",
        tag="dp",
        example="smooth",
        file_field="dp_kernels",
    ),
    LensParam(
        name="dp-crosstalk",
        parse=quantities.quantity("a share of the light", "like 0.15", least=0, most=0.49),
        metavar="0…0.49",
        help="Share of the light of each photodiode that the other one gets, like 0.15, in "
        "addition to the crosstalk of ‹dp-model›.  [default: 0]",
        tag="crosstalk",
        example="0.15",
    ),
    LensParam(
        name="noise",
        parse=quantities.noise,
        metavar="match|ELECTRONS:READ",
        help="Add sensor noise, like 4000:3: ELECTRONS is the number of electrons for a linear "
        "light of 1, which sets the shot noise, and READ the read noise in electrons. match "
        "adds the noise of the sharp parts to the blurred parts.  [default: off]",
        tag="noise",
        example="4000:3",
        separator=":",
    ),
    LensParam(
        name="noise-seed",
        never_off=True,
        parse=quantities.whole,
        metavar="N",
        help="Seed of the random numbers of ‹noise›, 0 or a positive whole number; the same seed "
        "gives the same noise.  [default: 0]",
        even_in="",
        tag="seed",
        example="7",
        needs="noise",
        idle="has no effect without noise",
    ),
)
LENS_OPTIONS: Mapping[str, LensParam] = {row.name: row for row in _ROWS}
SHAPES = tuple(row.name for row in _ROWS if not row.is_optics)
_POINT_OPTIONS = ("blade", "obstruction", "spherical", "squeeze", "aperture-image", "dp-")
# Options that decide the radii of one kind of light.
BLURRING = tuple(LENS_OPTIONS)[: [*LENS_OPTIONS].index("clamp-blur") + 1]
# Options that the opening and the blur of a point show.
OPENING = tuple(name for name in SHAPES if name.startswith(_POINT_OPTIONS))
BESIDE_BLUR = frozenset(
    {*SHAPES, "focus-at", "sharp-range", "cat-eye", "vignetting", "axial-color"}
)  # options with an effect beside a blur in pixels
# The options by their keys in records: those of any lens, then those of effects.
RECORDED = {row.recorded_as: row for row in _ROWS if row.recorded_as and not row.instead_of}
EFFECT_OPTIONS = {
    field: row
    for row in _ROWS
    for field in (row.field, row.file_field)
    if field and not row.recorded_as
}
LENS_FILES = tuple(row.file_field for row in _ROWS if row.file_field)

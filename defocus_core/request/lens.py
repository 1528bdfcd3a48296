"""The values of a lens, and their form in records and messages."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from defocus_core.errors import CALLER, Place
from defocus_core.request.parameters import EFFECT_OPTIONS, LENS_FILES, RECORDED
from defocus_core.request.quantities import Percentile, SideShare, Unitless, length_text


@dataclass(frozen=True, slots=True)
class Draw:
    """Identification of a randomly drawn lens, which determines its random numbers."""

    seed: int  # the seed of the jobs file
    picture: str  # name of the picture and suffix of the lens of the sweep
    index: int  # number of the draw


@dataclass(frozen=True, init=False)
class LensValues:
    """A thin lens. All lengths are in mm.

    The focus is given in one of three ways: the distance ``foc_dist``, the pixel ``focus_at``, or
    the percentile ``focus_percentile`` of depth; for the latter two, `picture.focus` finds the
    distance.

    ``foclen`` and ``fnum`` are NaN in two cases, where only the shape of the aperture matters: if
    the input files hold blur radii instead of depth, and if ``blur`` is set, where radii are linear
    in the numbers of the depth file. Only values that differ from the default are stored in an
    instance, to save memory in large batches.
    """

    foclen: float
    fnum: float
    foc_dist: float | None
    focus_at: tuple[int, int] | None = None
    sensor_width: float = 36.0
    blades: int = 0
    blade_rotation: float = 0.0
    focus_percentile: float | None = None  # 0 is the nearest pixel, 100 the farthest but the sky
    # radius of the most blurred pixel, in px or as a share of the picture, in place of optics
    blur: float | SideShare | None = None
    focus_value: float | None = None  # number of the depth file in focus, with ``blur``
    blur_reach: float | None = None  # distance in numbers from the focus to the radius ``blur``
    clamp_blur: float | None = None  # greatest radius in px
    sharp_range: tuple[float, float] | None = None  # mm that stay sharp, too; numbers with `blur`
    cat_eye: tuple[float, float] | None = None  # radius and distance of the rim, in pupil radii
    vignetting: bool = False
    axial_color: tuple[float, float] | None = None  # mm by which red and blue focus farther behind
    blade_curvature: float = 0.0
    obstruction: float = 0.0
    spherical: float = 0.0
    squeeze: float = 1.0
    aperture_image: Path | None = None
    highlights: tuple[float, float] | None = None  # threshold in linear light, and gain
    dp_model: str = "split"
    dp_kernels: Path | None = None  # measured kernels of the photodiodes, instead of a model
    dp_crosstalk: float = 0.0
    # electrons of a light of 1, and of read noise; or ``match`` for the noise of the photograph
    noise: tuple[float, float] | str | None = None
    noise_seed: int = 0
    draw: Draw | None = None  # of a random lens
    # place of the option of the focus, for errors
    focus_source: Place = field(default=CALLER, compare=False)

    def __init__(self, foclen: float, fnum: float, foc_dist: float | None, **others: Any) -> None:
        """Set the fields. With ``blur``, the sharp range is in numbers of the depth file."""
        if others.get("blur") is not None and others.get("sharp_range") is not None:
            others["sharp_range"] = Unitless(others["sharp_range"])
        for name, value in {"foclen": foclen, "fnum": fnum, "foc_dist": foc_dist, **others}.items():
            if value is not DEFAULTS[name]:
                object.__setattr__(self, name, value)

    @property
    def effects(self) -> dict[str, Any]:
        """The values of the optional effects that are on, as they are recorded, by field name."""
        values = {name: getattr(self, name) for name in EFFECTS}
        return {
            name: EFFECT_OPTIONS[name].recorded(value)
            for name, value in values.items()
            if value != EFFECTS[name]
        }

    @property
    def files(self) -> dict[str, Path]:
        """The files that define the aperture or the dual pixels, by field name."""
        paths = {name: getattr(self, name) for name in LENS_FILES}
        return {name: path for name, path in paths.items() if path is not None}

    @property
    def is_shape(self) -> bool:
        """Whether only the shape of the aperture is known, without focal length and f-number."""
        return math.isnan(self.foclen)


# Default values of its fields.
DEFAULTS: Mapping[str, Any] = {field.name: field.default for field in fields(LensValues)}
# Fields of effects that most lenses lack, and their values if off.
EFFECTS = {name: value for name, value in DEFAULTS.items() if name in EFFECT_OPTIONS}


def lens_record(lens: LensValues) -> dict[str, Any]:
    """The record of a lens as a dictionary that JSON can hold. Infinity becomes ``"inf"``.

    Optical values, such as the focal length, are None if only the shape of the aperture is known.
    """
    values = {
        key: None if row.is_optics and lens.is_shape else row.recorded(getattr(lens, row.field))
        for key, row in RECORDED.items()
    }
    values |= lens.effects
    if lens.focus_at is not None:
        values["focus_at_px"] = list(lens.focus_at)
    if lens.focus_percentile is not None:
        values["focus_percentile"] = lens.focus_percentile
    if (draw := lens.draw) is not None:
        values["draw"] = {"seed": draw.seed, "index": draw.index}
    return values


def lens_words(lens: LensValues) -> str:
    """A lens as text, like ``50mm f/1.4, focus 2m, sensor 36mm``."""
    return lens_record_words(lens_record(lens))


def lens_record_words(lens: Mapping[str, Any]) -> str:
    """A record made by `lens_record` as text, in the form of `lens_words`."""
    shown = [name for name in EFFECTS if name not in ("blur", "focus_value")]
    shape = f", {lens['blades']} blades" if lens["blades"] else ""
    values = {name: EFFECT_OPTIONS[name].shown(lens[name]) for name in shown if name in lens}
    shape += "".join(f", {name.replace('_', ' ')} {value}" for name, value in values.items())
    if "blur" in lens:
        at = "{},{}".format(*lens["focus_at_px"]) if "focus_at_px" in lens else ""
        where = f"at {at}" if at else f"on the number {lens.get('focus_value', 0):g}"
        blur = EFFECT_OPTIONS["blur"].shown(lens["blur"])
        return f"blur of {blur}, focus {where}{shape}"
    if lens["focal_length_mm"] is None:
        return f"radii of the file{shape}"
    focus = "at {},{}".format(*lens["focus_at_px"]) if "focus_at_px" in lens else ""
    if "focus_percentile" in lens:
        focus = f"at {Percentile(lens['focus_percentile'])}"
    if lens["focus_mm"] is not None:
        focus = f"{length_text(float(lens['focus_mm']))} {focus}".strip()
    foclen, sensor = (length_text(lens[f"{key}_mm"]) for key in ("focal_length", "sensor_width"))
    return f"{foclen} f/{lens['fnumber']:g}, focus {focus}, sensor {sensor}{shape}"

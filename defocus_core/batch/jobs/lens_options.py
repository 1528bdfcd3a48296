"""Lens options: their names, how each is read and written, and the lens that they describe.

Files hold options as texts, ``{"focus": "2m"}``, with the units they have on the command line. A
lens file holds them, and reading options if it likes::

    focal-length = "50mm"
    fnumber = 1.4
    focus = "2m"
    blades = 6

The ``source`` of options is how errors about one of them begin: `CALLER` where the caller gave
them himself, else the file or table, with a colon and a blank.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from defocus_core.batch.jobs.reading_options import NAMES_OF_OPTIONS
from defocus_core.batch.jobs.toml_file import read_toml, refuse_unknown
from defocus_core.batch.lenses import quantities
from defocus_core.batch.lenses.lens import DUAL_PIXEL_MODELS, Lens
from defocus_core.batch.lenses.quantities import length_text, read_at, text_of
from defocus_core.errors import UsageProblem

# How each option is read, and what a file name calls it.
_ROWS: dict[str, tuple[Callable[[str], Any], str]] = {
    "focal-length": (quantities.length, "fl"),
    "fnumber": (quantities.fnumber, "f"),
    "aperture-diameter": (quantities.length, "d"),
    "sensor-width": (quantities.length, "sensor"),
    "focus": (quantities.focus, "focus"),
    "focus-at": (quantities.pixel, "at"),
    "sharp-range": (quantities.distances, "sharp"),
    "cat-eye": (quantities.rim, "rim"),
    "axial-color": (quantities.shifts, "axial"),
    "vignetting": (quantities.switch, "vignetting"),
    "blades": (quantities.blades, "blades"),
    "blade-rotation": (quantities.angle, "turn"),
    "blade-curvature": (quantities.within(0, 1, "a curvature", "like 0.5"), "curve"),
    "obstruction": (quantities.within(0, 0.95, "a share of the radius", "like 0.4"), "mirror"),
    "spherical": (quantities.within(-1, 1, "a spherical aberration", "like 0.5"), "ring"),
    "squeeze": (quantities.within(1, 4, "a squeeze", "like 2"), "squeeze"),
    "aperture-image": (quantities.file, "pupil"),
    "highlights": (quantities.highlights, "lights"),
    "dp-model": (quantities.dual_pixel(DUAL_PIXEL_MODELS), "dp"),
    "dp-crosstalk": (quantities.within(0, 0.49, "a share of the light", "like 0.15"), "crosstalk"),
    "noise": (quantities.noise, "noise"),
    "noise-seed": (quantities.seed, "seed"),
}
PARSERS = {name: parser for name, (parser, _) in _ROWS.items()}
LENGTHS = frozenset({"focal-length", "aperture-diameter", "sensor-width", "focus"})
ALTERNATIVES = (
    ("fnumber", "aperture-diameter"),
    ("focus", "focus-at"),
    ("blades", "aperture-image"),
)
# Options that change nothing of an opening without blades.
OF_BLADES = {"blade-rotation": "turns", "blade-curvature": "bends"}
CALLER = "‹"
_REQUIRED = {"focal-length": "50mm", "fnumber": "1.4", "focus": "2m"}  # with an example of each
# What decides the radii: nothing where a file holds them. The others are the shape of the opening.
_OPTICS = (
    *("focal-length", "fnumber", "aperture-diameter", "sensor-width"),
    *("focus", "focus-at", "sharp-range", "cat-eye", "vignetting"),
    "axial-color",
)
SHAPES = tuple(name for name in _ROWS if name not in _OPTICS)


@lru_cache(maxsize=65536)
def parsed(name: str, text: str) -> Any:
    """The value of an option, in mm, degrees or plain numbers.

    Raises:
        QuantityError: the text makes no sense.
    """
    return PARSERS[name](text)


def checked(name: str, value: object, where: str) -> str:
    """The text of an option, once it is known to make sense.

    Raises:
        UsageProblem: it makes no sense; the error begins with ``where``.
    """
    text = text_of(value)
    read_at(where, parsed, name, text)
    return text


def at(source: str, name: str) -> str:
    """How an error about an option begins."""
    return f"‹{name}›" if source == CALLER else f"{source}{name}"


def tag(name: str, value: Any) -> str:
    """The part of a file name for an option, like ``focus2m``, ``f1.4`` or ``at240x135``."""
    if isinstance(value, Path):
        text = value.stem
    elif isinstance(value, bool):
        text = "on" if value else "off"
    elif value is None:
        text = "off"
    elif isinstance(value, str):
        text = value
    elif isinstance(value, quantities.Percentile):
        text = f"p{value.percent:.6g}"
    elif name == "sharp-range":
        text = "-".join(map(length_text, value))
    elif isinstance(value, tuple):
        text = "x".join(map(str, value))
    else:
        text = length_text(value) if name in LENGTHS else f"{value:.6g}"
    return _ROWS[name][1] + text


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Options of both, of which ``over`` win, also over the alternatives to them.

    If ``over`` makes the aperture one without blades, what shapes the blades is dropped.
    """
    lost = {name for pair in ALTERNATIVES for name in pair if over.keys() & set(pair)}
    if str(over.get("blades")) == "0" or "aperture-image" in over:
        lost.update(OF_BLADES)
    return {name: value for name, value in base.items() if name not in lost} | dict(over)


def make_lens(
    flags: Mapping[str, Any],
    file: Path | None,
    *,
    radii: bool = False,
    lacking: Path | None = None,
) -> Lens:
    """The lens that flags and a lens file describe together; flags win.

    Args:
        flags: option name (``focal-length``, …) to parsed value; absent or None where not given.
        file: a lens file, if there is one.
        radii: the depth files hold radii, so that the lens is the shape of its opening alone.
        lacking: the picture whose metadata do not hold what is missing, for errors.

    Raises:
        InputError: the file cannot be read as TOML.
        UsageProblem: an option is missing or has no effect, contradicts another or makes no sense.
    """
    options = {name: value for name, value in flags.items() if value is not None}
    refuse_contradiction(options, CALLER)
    stored = {} if file is None else read_lens_file(file)
    if radii:
        refuse_optics(options, CALLER)
        stored = shape_of(stored)
    values = merged({name: parsed(name, text) for name, text in stored.items()}, options)
    if not radii:
        refuse_missing(values, CALLER, lacking)
    if options.get("vignetting") and "cat-eye" not in values:
        problem, remedy = "darkens nothing without a rim", "add ‹cat-eye› 1.05:1.5, or leave it out"
        raise UsageProblem("idle-option", problem, remedy, field="vignetting")
    if options.get("noise-seed") and "noise" not in values:
        problem, remedy = "changes nothing without noise", "add ‹noise› 4000:3, or leave it out"
        raise UsageProblem("idle-option", problem, remedy, field="noise-seed")
    for name in OF_BLADES:
        source = CALLER if name in options else f"{file}: "
        refuse_idle(name, values.get(name), values.get("blades"), source)
    lens = lens_of(values, CALLER if {"focus", "focus-at"} & options.keys() else f"{file}: ")
    if lens.foc_dist is not None:
        refuse_near_focus(lens.foc_dist, lens.foclen, at(lens.focus_source, "focus"))
    return lens


def lens_of(values: Mapping[str, Any], source: str = "") -> Lens:
    """The lens of parsed options, of which none is missing and none contradicts another.

    Args:
        values: the options; of a lens whose shape alone is known, blades and their rotation.
        source: how errors about the focus begin.
    """
    foclen, focus = values.get("focal-length", math.nan), values.get("focus")
    if "fnumber" in values:
        fnum = values["fnumber"]
    else:
        fnum = foclen / values.get("aperture-diameter", math.nan)
    percentile = focus.percent if isinstance(focus, quantities.Percentile) else None
    return Lens(
        foclen=foclen,
        fnum=fnum,
        foc_dist=focus if percentile is None else None,
        focus_at=values.get("focus-at"),
        sensor_width=values.get("sensor-width", Lens.sensor_width),
        sharp_range=values.get("sharp-range"),
        cat_eye=values.get("cat-eye"),
        axial_color=values.get("axial-color"),
        vignetting=values.get("vignetting", Lens.vignetting),
        focus_percentile=percentile,
        focus_source=source,
        **{field_of(name, values[name]): values[name] for name in SHAPES if name in values},
    )


def field_of(name: str, value: object = None) -> str:
    """The attribute of `Lens` that has a value of an option of its shape."""
    if name == "dp-model" and isinstance(value, Path):
        return "dp_kernels"
    return name.replace("-", "_")


def read_lens_file(file: Path) -> dict[str, str]:
    """The lens options of a lens file, as texts that make sense; it may have reading options, too.

    Raises:
        InputError: the file cannot be read as TOML.
        UsageProblem: a key is unknown or its value makes no sense.
    """
    remedy = 'give a TOML file, with lines like focal-length = "50mm"'
    stored = read_toml(file, what="lens file", remedy=remedy)
    stored = {name: value for name, value in stored.items() if name not in NAMES_OF_OPTIONS}
    refuse_unknown(stored, tuple(PARSERS), file, "a lens file")
    refuse_contradiction(stored, f"{file}: ")
    return {
        name: based(name, checked(name, value, f"{file}: {name}"), file)
        for name, value in stored.items()
    }


def based(name: str, text: str, file: Path) -> str:
    """The text of an option that stands in ``file``: paths are relative to its folder."""
    return str(file.parent / text) if isinstance(parsed(name, text), Path) else text


def refuse_contradiction(values: Mapping[str, Any], source: str) -> None:
    """Raise UsageProblem if two options set the same, like an f-number and a diameter."""
    for one, other in ALTERNATIVES:
        if one in values and other in values:
            problem = f"contradicts {at(CALLER, other) if source == CALLER else other}"
            raise UsageProblem("contradiction", problem, "give one of them", path=at(source, one))


def refuse_missing(values: Mapping[str, Any], source: str, lacking: Path | None = None) -> None:
    """Raise UsageProblem if a required option is missing, from the metadata of a picture, too."""
    problem = "is missing" if lacking is None else f"is missing, and not in {lacking} either"
    others = dict(ALTERNATIVES)
    for name, example in _REQUIRED.items():
        other = others.get(name)
        if name in values or other in values:
            continue
        if source == CALLER:
            either = f" or ‹{other}›" if other else ""
            remedy = f"add ‹{name}› {example}{either}, or a ‹lens› FILE that has it"
        else:
            either = f" or {other}" if other else ""
            remedy = f'write {name} = "{example}"{either} below [lens]'
        raise UsageProblem("missing-option", problem, remedy, path=at(source, name))


def refuse_optics(names: Iterable[str], source: str) -> None:
    """Raise UsageProblem if an option decides the radii, which the depth files hold themselves."""
    for name in names:
        if name in _OPTICS:
            problem = "changes nothing: with depth-format coc, the files hold the radii"
            remedy = f"leave it out; {', '.join(SHAPES)} shape the opening"
            raise UsageProblem("idle-option", problem, remedy, path=at(source, name))


def shape_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that shape the opening."""
    return {name: value for name, value in options.items() if name not in _OPTICS}


def refuse_idle(name: str, value: object, blades: object, source: str) -> None:
    """Raise UsageProblem if an option of blades has a ``value``, but the aperture no ``blades``."""
    if value and not blades:
        example = "‹blades›" if source == CALLER else "blades ="
        problem = f"{OF_BLADES[name]} blades; this aperture has none"
        remedy = f"give it some, like {example} 6, or leave it out"
        raise UsageProblem("idle-option", problem, remedy, path=at(source, name))


def refuse_near_focus(foc_dist: float, foclen: float, where: str) -> None:
    """Raise UsageProblem, naming ``where``, unless a lens of ``foclen`` can focus there (mm)."""
    if foc_dist <= foclen:
        near, far = length_text(foc_dist), length_text(foclen)
        problem = f"{near} is not farther than the focal length {far}"
        remedy = "focus farther away than that, or give a shorter focal length"
        raise UsageProblem("out-of-range", problem, remedy, path=where)

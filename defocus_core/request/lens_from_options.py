"""The lens that options describe, as texts of files or as the caller gives them.

Files hold options as texts, ``{"focus": "2m"}``, with the units they have on the command line. A
lens file holds them, and reading options if it likes::

    focal-length = "50mm"
    fnumber = 1.4
    focus = "2m"
    blades = 6

The ``source`` of options is the place that they stand in, for errors: `CALLER` where the caller
gave them himself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from defocus_core.errors import CALLER, Place, UsageProblem, did_you_mean
from defocus_core.request.lens import EFFECTS, Lens
from defocus_core.request.parameters import (
    ALTERNATIVES,
    BESIDE_BLUR,
    LENS_OPTIONS,
    METADATA,
    OPENING,
    SHAPES,
    LensParam,
)
from defocus_core.request.quantities import (
    FileNumbers,
    Percentile,
    length_text,
    read_at,
    text_of,
)
from defocus_core.request.reading_options import READING_OPTIONS
from defocus_core.request.toml_file import read_toml, refuse_unknown


@lru_cache(maxsize=65536)
def parsed(name: str, text: str) -> Any:
    """The value of an option, in mm, degrees or plain numbers; off is that of a lens without it."""
    row = LENS_OPTIONS[name]
    if text.strip().lower() == "off" and row.field in EFFECTS and not row.never_off:
        return EFFECTS[row.field]
    return row.parse(text)


def checked(name: str, value: object, where: Place) -> str:
    """The text of an option, once it is known to make sense."""
    text = text_of(value)
    read_at(where, parsed, name, text)
    return text


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Options of both, of which ``over`` win, also over the alternatives to them.

    If ``over`` makes the aperture one without blades, what shapes the blades is dropped.
    """
    if not over:
        return dict(base)
    lost = {name for pair in ALTERNATIVES for name in pair if over.keys() & set(pair)}
    if str(over.get("blades")) == "0" or "aperture-image" in over:
        lost.update(row.name for row in LENS_OPTIONS.values() if row.needs == "blades")
    return {name: value for name, value in base.items() if name not in lost} | dict(over)


def make_lens(
    flags: Mapping[str, Any],
    file: Path | None,
    *,
    radii: bool = False,
    lacking: Path | None = None,
) -> Lens:
    """The lens that flags and a lens file describe together; flags win.

    `flags`: option name (``focal-length``, …) to parsed value; absent or None where not given.
    """
    options = {name: value for name, value in flags.items() if value is not None}
    refuse_contradiction(options, CALLER)
    stored = {} if file is None else read_lens_file(file)
    in_pixels = "blur" in options or "blur" in stored
    if in_pixels:
        refuse_optics([*options, *([METADATA] if lacking else [])], CALLER, in_pixels=True)
        refuse_lens_file(stored, file, CALLER.at("lens"))
    elif radii:
        refuse_optics(options, CALLER)
        stored = shape_of(stored)
    values = merged({name: parsed(name, text) for name, text in stored.items()}, options)
    sources = {name: CALLER if name in options else Place(file) for name in values}
    refuse_unusable({n: (v,) for n, v in values.items()}, sources, CALLER, radii, lacking)
    return lens_of(values, CALLER if {"focus", "focus-at"} & options.keys() else Place(file))


def refuse_unusable(
    values: Mapping[str, Sequence[Any]],
    sources: Mapping[str, Place],
    source: Place,
    radii: bool,
    lacking: Path | None = None,
) -> None:
    """Refuse a lens without a required option, with a useless one, or that may focus too near.

    `values`: of each option the value, or all or the ends of the range that it may get; `sources`:
    where each stands; `source`: where others are to be added.
    """
    if "blur" in values:
        refuse_unfocused(values, source)
    elif not radii:
        refuse_missing(values, source, lacking)
        distances = [d for d in values.get("focus", ()) if not isinstance(d, Percentile)]
        if distances:
            longest = max(values["focal-length"])
            refuse_near_focus(min(distances), longest, sources["focus"].at("focus"))
    for name in values:
        refuse_idle(LENS_OPTIONS[name], lambda of: any(values.get(of, ())), sources[name])


def lens_of(values: Mapping[str, Any], source: Place = CALLER) -> Lens:
    """The lens of parsed options, of which none is missing and none contradicts another."""
    fields: dict[str, Any] = {"foclen": math.nan, "fnum": math.nan, "foc_dist": None}
    fields |= {LENS_OPTIONS[name].field_of(value): value for name, value in values.items()}
    if (sharp := fields.get("sharp_range")) is not None:
        if isinstance(sharp, FileNumbers) != ("blur" in fields):
            problem = (
                "is in numbers of the depth file beside ‹blur›, and in distances beside a lens"
            )
            remedy = "write it like 100..200, or like 1.8m..2.4m"
            raise UsageProblem("malformed", problem, remedy, path=source.at("sharp-range"))
        if "blur" in fields and not fields.keys() & {"focus_at", "focus_value"}:
            fields["focus_value"] = sum(sharp) / 2
    if (diameter := fields.pop("aperture_diameter", None)) is not None:
        fields["fnum"] = fields["foclen"] / diameter
    if isinstance(fields["foc_dist"], Percentile):
        fields |= {"foc_dist": None, "focus_percentile": fields["foc_dist"].percent}
    return Lens(**fields, focus_source=source)


def read_lens_file(file: Path) -> dict[str, str]:
    """The lens options of a lens file, as texts that make sense; reading options are left out."""
    remedy = 'give a TOML file, with lines like focal-length = "50mm"'
    stored = read_toml(file, what="lens file", remedy=remedy)
    stored = {name: value for name, value in stored.items() if name not in READING_OPTIONS}
    refuse_unknown(stored, tuple(LENS_OPTIONS), file, "a lens file")
    refuse_contradiction(stored, Place(file))
    return {
        name: based(name, checked(name, value, Place(file, field=name)), file)
        for name, value in stored.items()
    }


def based(name: str, text: str, file: Path) -> str:
    """The text of an option that stands in ``file``: paths are relative to its folder."""
    return str(file.parent / text) if isinstance(parsed(name, text), Path) else text


def refuse_contradiction(values: Mapping[str, Any], source: Place) -> None:
    """Raise UsageProblem if two options set the same, like an f-number and a diameter."""
    for one, other in ALTERNATIVES:
        if one in values and other in values:
            problem = f"contradicts {CALLER.at(other) if source == CALLER else other}"
            raise UsageProblem("contradiction", problem, "give one of them", path=source.at(one))


def missing_options(values: Mapping[str, Any]) -> list[str]:
    """The options that a lens cannot do without and that have no value, nor have others instead."""
    others = dict(ALTERNATIVES)
    required = (row.name for row in LENS_OPTIONS.values() if row.required)
    return [name for name in required if name not in values and others.get(name) not in values]


def missing_words(lacking: Sequence[str]) -> str:
    """That the first of some options is missing, and the others are."""
    others = " and ".join(f"‹{name}›" for name in lacking[1:])
    return (
        f"is missing, as {'are' if len(lacking) > 2 else 'is'} {others}" if others else "is missing"
    )


def refuse_missing(values: Mapping[str, Any], source: Place, lacking: Path | None = None) -> None:
    """Raise UsageProblem if required options are missing, from the metadata of a picture, too."""
    missing = missing_options(values)
    if not missing:
        return
    problem = missing_words(missing)
    problem += "" if lacking is None else f", and not in {lacking} either"
    others, ways = dict(ALTERNATIVES), []
    for name in missing:
        example, other = LENS_OPTIONS[name].example, others.get(name)
        if source == CALLER:
            ways.append(f"‹{name}› {example}" + (f" or ‹{other}›" if other else ""))
        else:
            ways.append(f'{name} = "{example}"' + (f" or {other}" if other else ""))
    if source == CALLER:
        remedy = (
            f"add {', '.join(ways)}, or a ‹lens› FILE that has {'it' if len(ways) < 2 else 'them'}"
        )
    else:
        remedy = f"write {', '.join(ways)} below [lens]"
    raise UsageProblem("missing-option", problem, remedy, path=source.at(missing[0]))


def refuse_unfocused(values: Mapping[str, Any], source: Place) -> None:
    """Raise UsageProblem if nothing says what is in focus beside a blur in pixels."""
    if not values.keys() & {"focus-at", "focus-value", "sharp-range"}:
        problem, remedy = (
            "does not say what is in focus",
            "add ‹focus-at› X,Y or ‹focus-value› NUMBER",
        )
        raise UsageProblem("missing-option", problem, remedy, path=source.at("blur"))


def refuse_optics(names: Iterable[str], source: Place, *, in_pixels: bool = False) -> None:
    """Raise UsageProblem if an option decides the radii, which something else decides already."""
    for name in names:
        if in_pixels and name not in BESIDE_BLUR:
            problem = "changes nothing beside blur, which is no lens"
            raise UsageProblem(
                "contradiction", problem, "leave one of them out", path=source.at(name)
            )
        if in_pixels:
            continue
        if LENS_OPTIONS[name].is_optics:
            problem = "changes nothing: with depth-format coc, the files hold the radii"
            remedy = f"leave it out; {', '.join(OPENING)} shape the opening"
            raise UsageProblem("idle-option", problem, remedy, path=source.at(name))


def refuse_lens_file(stored: Mapping[str, str], file: Path | None, where: Place) -> None:
    """Raise UsageProblem if a lens file decides the radii, which a blur in pixels decides."""
    if "blur" in stored:
        refuse_optics(stored, Place(file), in_pixels=True)
    optics = [name for name in stored if name not in BESIDE_BLUR]
    if file is None or not optics:
        return
    problem = f"{file.name} decides radii by {', '.join(optics)}, and so does blur"
    opening = " ".join(f"‹{name}› {stored[name]}" for name in OPENING if name in stored)
    remedy = f"leave it out; its opening is {opening}" if opening else "leave it out"
    raise UsageProblem("contradiction", problem, remedy, path=where)


def shape_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that shape the opening."""
    return {name: value for name, value in options.items() if name in SHAPES}


def refuse_idle(row: LensParam, value: Callable[[str], object], source: Place) -> None:
    """Raise UsageProblem if an option has a ``value``, and the option that it needs has none."""
    if row.needs and value(row.name) and not value(row.needs):
        example = LENS_OPTIONS[row.needs].example
        given = f"‹{row.needs}› {example}" if source == CALLER else f'{row.needs} = "{example}"'
        remedy = f"add {given}, or leave it out"
        raise UsageProblem("idle-option", row.idle, remedy, path=source.at(row.name))


def refuse_near_focus(foc_dist: float, foclen: float, where: Place, at: str = "") -> None:
    """Raise UsageProblem unless a lens of ``foclen`` can focus so near (mm)."""
    if foc_dist <= foclen:
        near, far = length_text(foc_dist), length_text(foclen)
        problem = f"{at}{near} is not farther than the focal length {far}"
        remedy = "focus farther away than that, or give a shorter focal length"
        raise UsageProblem("out-of-range", problem, remedy, path=where)


MARK = "@"


@dataclass(frozen=True)
class ShippedLens:
    """A lens file that ships."""

    name: str  # as ``--lens`` takes it, with the mark
    path: Path
    subject: str  # its first line, in words


@cache
def shipped_lenses() -> tuple[ShippedLens, ...]:
    """The lens files that ship, sorted by name."""
    folder = Path(str(files("defocus_core.request"))) / "lenses"
    return tuple(
        ShippedLens(f"{MARK}{path.stem}", path, _subject(path))
        for path in sorted(folder.glob("*.toml"))
    )


def lens_path(path: Path, where: Place) -> Path:
    """The lens file of a path, or of a name like ``@portrait-85``."""
    known = {lens.name: lens.path for lens in shipped_lenses()}
    if not str(path).startswith(MARK):
        if not path.exists() and f"{MARK}{path}" in known:
            problem, remedy = f"no file {path}", f"did you mean {MARK}{path}?"
            raise UsageProblem("unknown-name", problem, remedy, path=where)
        return path
    if str(path) in known:
        return known[str(path)]
    remedy = did_you_mean(str(path), tuple(known), "see 'defocus lenses'")
    raise UsageProblem("unknown-name", f"no lens {path} ships with defocus", remedy, path=where)


def _subject(path: Path) -> str:
    return path.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")

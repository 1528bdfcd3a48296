"""Resolve options: combine the layers in which they are given, then make lens and settings of them.

A layer holds the options of one source. The layers, of which later ones override earlier ones, are
a lens file, metadata of the picture, keyframes, the command line or a jobs file, the row of the
picture in a list, and a sweep. The type and range of a value are checked when it is parsed;
contradictions between options, and options without effect, when all layers are known.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from defocus_core.errors import CALLER, Place, UsageProblem, reason
from defocus_core.request.job import Outputs, Reading
from defocus_core.request.job_options import OUTPUT_OPTIONS, READING_OPTIONS, TABLES, in_one_file
from defocus_core.request.lens import EFFECTS, Draw, LensValues
from defocus_core.request.output_kinds import INPUTS
from defocus_core.request.parameters import BESIDE_BLUR, LENS_OPTIONS, METADATA, OPENING, Param
from defocus_core.request.quantities import (
    Percentile,
    QuantityError,
    Unitless,
    length_text,
    percentage,
    read_at,
    switch,
    text_of,
)

if TYPE_CHECKING:
    from defocus_core.optics.distributions import Distribution
    from defocus_core.request.toml_file import Table


class Given(NamedTuple):
    """The value given to an option."""

    value: Any  # in mm, degrees or plain numbers; or a Distribution of these
    text: str  # as on the command line
    place: Place  # place of the option itself


Layer = Mapping[str, Given]  # by the name of the option
# The options of jobs files by table, and all of these.
OPTIONS = {"lens": LENS_OPTIONS, "reading": READING_OPTIONS, **TABLES}
ROWS: Mapping[str, Param] = {name: row for rows in OPTIONS.values() for name, row in rows.items()}
ALTERNATIVES = tuple((row.instead_of, row.name) for row in ROWS.values() if row.instead_of)


@cache
def alternatives(name: str) -> frozenset[str]:
    """The names of an option and its alternatives, like focus and focus-at."""
    return frozenset((name,)).union(*(pair for pair in ALTERNATIVES if name in pair))


_LIST = re.compile(r"\s*[\d.]+\s*[a-z%]*\s*(,\s*[\d.]+\s*[a-z%]*\s*)+", re.I)


def value_of(name: str, text: str) -> Any:
    """Parse the value of an option, in mm, degrees or plain numbers; ``off`` gives the default."""
    row = ROWS[name]
    if name in LENS_OPTIONS and not row.separator and _LIST.fullmatch(text):
        remedy = "write one, or the list below [sweep] of a jobs file"
        raise QuantityError(f"'{text}' is a list", remedy)
    is_off = text.strip().lower() == "off" and row.field in EFFECTS
    return EFFECTS[row.field] if is_off and not LENS_OPTIONS[name].never_off else row.parse(text)


def parsed(name: str, text: str, place: Place) -> Given:
    """Parse the value of an option; errors name its place."""
    return Given(read_at(place, value_of, name, text), text, place)


def layer_in(table: Table, rows: Mapping[str, Param], *others: str) -> dict[str, Given]:
    """Parse the options in a table; keys that are not in `rows` or ``others`` are errors."""
    named = keys_of(rows)
    table.refuse_unknown((*named, *others))
    return layer_of(table.values, named, table.place)


def keys_of(rows: Mapping[str, Param]) -> dict[str, Param]:
    """The rows of options by their keys in files, without options that only commands have."""
    return {row.key or name: row for name, row in rows.items() if row.only != "commands"}


def layer_of(
    values: Mapping[str, Any], rows: Mapping[str, Param], at: Callable[[str], Place]
) -> dict[str, Given]:
    """Parse the options among `values`; other keys and None are ignored.

    `rows`: the options by key; `at`: gives the place of a key. Paths are relative to the folder of
    the file in that place.
    """
    layer = {
        rows[key].name: given(rows[key].name, value, at(key))
        for key, value in values.items()
        if key in rows and value is not None and not (rows[key].flag and value is False)
    }
    refuse_contradiction(layer)
    return layer


def given(name: str, value: object, place: Place) -> Given:
    """Parse an option that a file gives as a text, a number, a boolean or a list."""
    row, text = ROWS[name], text_of(value)
    if row.flag:
        if value is not True:
            problem, remedy = f"{value!r} is neither true nor false", f"write {name} = true"
            raise UsageProblem("malformed", problem, remedy, path=place)
    elif row.parse is switch and isinstance(value, bool):
        text = "on" if value else "off"
    elif isinstance(value, bool):
        problem, remedy = f"{text.lower()} is not a value of this option", "see 'defocus help'"
        raise UsageProblem("malformed", problem, remedy, path=place)
    elif row.parse is str and not (isinstance(value, str) and value and "\0" not in value):
        remedy = "write it in quotes"
        raise UsageProblem("malformed", f"{value!r} is not a text", remedy, path=place)
    found = parsed(name, text, place)
    if isinstance(found.value, Path) and isinstance(place.path, Path):
        file = place.path.parent / text
        return Given(file, str(file), place)
    return found


def laid_over(*layers: Layer) -> dict[str, Given]:
    """Combine layers; an option replaces itself and its alternatives in earlier layers.

    If a layer removes the aperture blades, options in earlier layers that shape them are dropped.
    """
    options: dict[str, Given] = {}
    for layer in filter(None, layers):
        lost = set[str]().union(*map(alternatives, layer))
        if "aperture-image" in layer or ("blades" in layer and layer["blades"].value == 0):
            lost.update(row.name for row in LENS_OPTIONS.values() if row.needs == "blades")
        options = {name: each for name, each in options.items() if name not in lost} | dict(layer)
    return options


def refuse_contradiction(layer: Layer) -> None:
    """Raise UsageProblem if a layer has two alternative options, like focus and focus-at."""
    for one, other in ALTERNATIVES:
        if one in layer and other in layer:
            place = layer[one].place
            problem = f"contradicts {_named(other, place)}"
            raise UsageProblem("contradiction", problem, "give one of them", path=place)


def refuse_repeated(layer: Layer, places: Mapping[str, str]) -> None:
    """Raise UsageProblem if an option of `layer` is in `places`, and so is set elsewhere, too."""
    for name in layer.keys() & places.keys():
        problem = f"is in {places[name]}, too"
        raise UsageProblem("contradiction", problem, "remove one", path=layer[name].place)


# Options without a unit beside a blur in pixels: problem and remedy of other values.
_UNITLESS = {
    "sharp-range": (
        "is in numbers of the depth file beside ‹blur›, and in distances beside a lens",
        "write it like 100..200, or like 1.8m..2.4m",
    ),
    "axial-color": (
        "is in shares of ‹blur› beside it, and in lengths beside a lens",
        "write it like 0.05:0.05, or like 0.1mm:0.1mm",
    ),
}


def check_lens(
    options: Layer, where: Place, *, radii: bool = False, lacking: Path | None = None
) -> None:
    """Raise UsageProblem if the options do not define a lens.

    `where` is the table to which missing options should be added. `radii` tells whether depth files
    hold blur radii, so that only the shape of the aperture is needed. `lacking` is a picture whose
    metadata were searched for options.
    """
    possible = {name: _possible(each.value) for name, each in options.items()}
    in_pixels = "blur" in options
    refuse_optics(options, in_pixels=in_pixels, radii=radii)
    if in_pixels:
        if not options.keys() & {"focus-at", "focus-value", "sharp-range"}:
            problem = "does not say what is in focus"
            remedy = "add ‹focus-at› X,Y or ‹focus-value› NUMBER"
            raise UsageProblem("missing-option", problem, remedy, path=options["blur"].place)
    elif not radii:
        refuse_missing(options, where, lacking)
        distances = [d for d in possible.get("focus", ()) if not isinstance(d, Percentile)]
        if distances:
            longest = max(possible["focal-length"])
            refuse_near_focus(min(distances), longest, options["focus"].place)
    for name, (problem, remedy) in _UNITLESS.items():
        if any(
            isinstance(value, Unitless) != in_pixels for value in possible.get(name, ()) if value
        ):
            raise UsageProblem("malformed", problem, remedy, path=options[name].place)
    for name, (_, _, place) in options.items():
        row = LENS_OPTIONS[name]
        if row.needs and any(possible[name]) and not any(possible.get(row.needs, ())):
            example = LENS_OPTIONS[row.needs].example
            added = f"{_named(row.needs, place)} {example}"
            if place.path is not None:
                added = f'{row.needs} = "{example}"'
            raise UsageProblem("idle-option", row.idle, f"add {added}, or leave it out", path=place)


def refuse_optics(options: Layer, *, in_pixels: bool = False, radii: bool = False) -> None:
    """Raise UsageProblem if an option determines blur radii, though they are given otherwise.

    `in_pixels`: the option blur gives them; `radii`: the depth files hold them.
    """
    for name, (_, _, place) in options.items():
        if in_pixels and name not in BESIDE_BLUR:
            problem = "has no effect beside ‹blur›, which replaces the lens"
            raise UsageProblem("contradiction", problem, "leave one of them out", path=place)
        if radii and not in_pixels and (name == METADATA or LENS_OPTIONS[name].is_optics):
            problem = "has no effect: with depth-format coc, the files hold the radii"
            remedy = f"leave it out; {', '.join(OPENING)} shape the opening"
            raise UsageProblem("idle-option", problem, remedy, path=place)


def missing_options(options: Layer) -> list[str]:
    """The names of required lens options that have no value, nor an alternative with one."""
    required = (row.name for row in LENS_OPTIONS.values() if row.required)
    return [name for name in required if not alternatives(name) & options.keys()]


def missing_words(lacking: Sequence[str]) -> str:
    """The words of an error that follow the name of the first missing option: "is missing, …"."""
    others = " and ".join(f"‹{name}›" for name in lacking[1:])
    return (
        f"is missing, as {'are' if len(lacking) > 2 else 'is'} {others}" if others else "is missing"
    )


def refuse_missing(options: Layer, where: Place, lacking: Path | None = None) -> None:
    """Raise UsageProblem if required lens options are missing.

    `where` is the place for the error; `lacking` a picture whose metadata were searched for them.
    """
    missing = missing_options(options)
    if not missing:
        return
    problem = missing_words(missing)
    problem += "" if lacking is None else f", and not in {lacking} either"
    others, ways = dict(ALTERNATIVES), []
    for name in missing:
        example, other = LENS_OPTIONS[name].example, others.get(name)
        words = f"‹{name}› {example}" if where == CALLER else f'{name} = "{example}"'
        ways.append(words + (f" or {_named(other, where)}" if other else ""))
    remedy = f"write {', '.join(ways)} below [lens]"
    if where == CALLER:
        it = "it" if len(ways) < 2 else "them"
        remedy = f"add {', '.join(ways)}, or a ‹lens› FILE that has {it}"
        if "focal-length" in missing:
            remedy += "; or, of depth without a unit, ‹blur› 2% and ‹focus-at› X,Y instead"
    raise UsageProblem("missing-option", problem, remedy, path=where.with_field(missing[0]))


def refuse_near_focus(foc_dist: float, foclen: float, where: Place, at: str = "") -> None:
    """Raise UsageProblem unless the focus distance exceeds the focal length, both in mm.

    `where` is the place for the error, and `at` the text before the distance in its message.
    """
    if foc_dist <= foclen:
        near, far = length_text(foc_dist), length_text(foclen)
        problem = f"{at}{near} is not farther than the focal length {far}"
        remedy = "focus farther away than that, or give a shorter focal length"
        raise UsageProblem("out-of-range", problem, remedy, path=where)


def lens_of(options: Layer, draw: Draw | None = None) -> LensValues:
    """Make a lens of options that passed `check_lens`; `draw` identifies random values."""
    values = {name: each.value for name, each in options.items()}
    if draw is not None:
        from defocus_core.optics.distributions import Distribution, drawn

        focus = values.get("focus")
        # The last key must stay 0, so that published data sets can be reproduced
        values = drawn(values, draw.seed, draw.picture, draw.index, 0)
        if isinstance(focus, Distribution) and focus.kind == "percentile":
            values["focus"] = Percentile(values["focus"])
    fields: dict[str, Any] = {"foclen": math.nan, "fnum": math.nan, "foc_dist": None}
    for name, value in values.items():
        row = LENS_OPTIONS[name]
        fields[row.file_field if isinstance(value, Path) else row.field] = value
    sharp = fields.get("sharp_range")
    if sharp is not None and "blur" in fields and not fields.keys() & {"focus_at", "focus_value"}:
        fields["focus_value"] = sum(sharp) / 2
    if isinstance(fields["foc_dist"], Percentile):
        fields |= {"foc_dist": None, "focus_percentile": fields["foc_dist"].percent}
    ways = ("focus", "focus-at", "focus-value")
    source = next((options[name].place for name in ways if name in options), CALLER)
    return LensValues(**fields, draw=draw, focus_source=source)


_CALL = re.compile(r"\s*([a-z]\w*)\s*\((.*)\)\s*", re.I | re.S)


def distribution(name: str, text: str) -> Distribution | None:
    """Parse a distribution of a lens option, like ``uniform(1m, 4m)``; None for a plain value."""
    call = _CALL.fullmatch(text)
    if not call:
        return None
    kind, words = call[1].lower(), [word.strip() for word in call[2].split(",")]
    if kind == "percentile" and len(words) == 1:
        return None
    from defocus_core.optics.distributions import Distribution

    row = LENS_OPTIONS[name]
    if kind != "choice" and (row.separator or not row.even_in):
        raise QuantityError(f"{name} is not drawn from a range", "write choice(…)")
    if kind in ("disparity", "percentile") and name != "focus":
        raise QuantityError(f"{kind} is for the focus only", "write uniform(…) or loguniform(…)")
    values = tuple(percentage(w) if kind == "percentile" else value_of(name, w) for w in words)
    if kind != "choice" and any(isinstance(value, Percentile) for value in values):
        raise QuantityError("a percentile is not an end of a range", "write percentile(5, 95)")
    try:
        return Distribution(kind, values)
    except ValueError as error:
        raise QuantityError(f"'{text}' is not a distribution: {reason(error)}", "") from None


def fields_of(layer: Layer) -> dict[str, Any]:
    """The values of options by the names of their fields."""
    return {ROWS[name].field: each.value for name, each in layer.items()}


def outputs_of(layer: Layer, outputs: Outputs, *, one_file: bool = False) -> Outputs:
    """Apply output options to the defaults in `outputs`; options without effect are errors.

    `one_file`: whether the root may be the path of a single file.
    """
    values = fields_of(layer)
    copied = INPUTS if values.pop("inputs", None) else ()
    kinds = tuple(dict.fromkeys((*values.get("kinds", outputs.kinds), *copied)))
    outputs = replace(outputs, **{**values, "kinds": kinds})
    if one_file:
        outputs = in_one_file(outputs, values)
    for row in OUTPUT_OPTIONS.values():
        if row.name in layer and not row.suits(outputs):
            problem, place = row.idle.format(format=outputs.format), layer[row.name].place
            raise UsageProblem("idle-option", problem, row.remedy, path=place)
    return outputs


def reading_of(*layers: Layer) -> Reading:
    """The options for reading input files, combined from all layers."""
    options = laid_over(*layers)
    reading = Reading(**fields_of(options))
    repair, width = reading.depth_repair, reading.edge_width
    if width is not None and (repair == "off" or (repair != "auto" and width == 0)):
        problem, place = f"of {width:g}px contradicts depth-repair {repair}", options["edge-width"]
        raise UsageProblem("contradiction", problem, "leave one of them out", path=place.place)
    return reading


def _possible(value: Any) -> Sequence[Any]:
    """The value itself; of a distribution, its values or both ends, nothing if in percentiles."""
    kind = getattr(value, "kind", None)
    return (value,) if kind is None else () if kind == "percentile" else value.values


def _named(option: str, place: Place) -> str:
    return f"‹{option}›" if place.path is None else option

"""Reading options: their names, and how the text of each becomes a field of `Reading`.

The command line, jobs files and lens files have them under one name. ``radial`` and ``planar`` are
flags, and set the field ``geometry``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from defocus_core.batch.jobs.job import Reading
from defocus_core.batch.jobs.toml_file import read_toml
from defocus_core.batch.lenses.quantities import (
    QuantityError,
    angle,
    length,
    number,
    pixel_count,
    read_at,
    text_of,
)
from defocus_core.errors import UsageProblem, did_you_mean
from defocus_core.io.depth_formats.reading import GEOMETRIES, INVALID, KINDS, RESIZES, UNPREMULTIPLY
from defocus_core.io.depth_formats.table import NAMES, UNITS

_FRACTION = re.compile(r"\s*([\d.e+-]+)\s*/\s*([\d.e+-]+)\s*", re.I)


def one_of(words: Sequence[str]) -> Callable[[str], str]:
    """A parser that takes one of the words."""

    def parse(text: str) -> str:
        if text not in words:
            remedy = did_you_mean(text, words, f"choose from {', '.join(words)}")
            raise QuantityError(f"'{text}' is not known", remedy)
        return text

    return parse


def format_name(text: str) -> str:
    """The name of a depth format, or one of its aliases; the nearest are named for any other."""
    from difflib import get_close_matches

    name = text.lower()
    if name in NAMES:
        return name
    near = get_close_matches(name, NAMES, n=3, cutoff=0.5)
    near = list(dict.fromkeys([*(n for n in NAMES if name in n or n in name), *near]))[:4]
    nearest = f"did you mean {' or '.join(near)}? " if near else ""
    remedy = f"{nearest}'defocus help depth' lists all of them"
    raise QuantityError(f"'{text}' is no depth format", remedy)


def scale(text: str) -> float:
    """A factor, from ``0.001``, ``1/256`` or ``-1``."""
    fraction = _FRACTION.fullmatch(text)
    if fraction:
        above, below = scale(fraction[1]), scale(fraction[2])
        return above / below
    value = number(text)
    if not 0 < abs(value) < math.inf:
        raise QuantityError(f"'{text}' is 0 or not finite", "write it like 0.001 or 1/256")
    return value


def distance(text: str) -> float:
    """A positive length in mm, from ``2m`` or ``193mm``; a number alone is in metres."""
    try:
        metres = float(text)
    except ValueError:
        return length(text)
    return length(f"{text.strip()}m") if math.isfinite(metres) else length(text)


def far_distance(text: str) -> float:
    """As `distance`, or ``inf``."""
    return math.inf if text.strip().lower() in ("inf", "infinity") else distance(text)


def distances(text: str) -> tuple[float, float]:
    """Two distances in mm, from ``2m 50m``, of which one may be inf."""
    words = text.replace(",", " ").split()
    if len(words) != 2:
        raise QuantityError(f"'{text}' is not two distances", "write them like 2m 50m")
    first, second = map(far_distance, words)
    return first, second


def field_of_view(text: str) -> float:
    """A horizontal field of view in degrees."""
    degrees = angle(text)
    if not 0 < degrees < 180:
        raise QuantityError(f"'{text}' is no field of view", "give more than 0 and less than 180")
    return degrees


def whole(text: str) -> int:
    """A whole number of 0 or more."""
    if not re.fullmatch(r"\d{1,9}", text.strip()):
        raise QuantityError(f"'{text}' is not a whole number of 0 or more", "write it like 1")
    return int(text)


def depth_repair(text: str) -> str:
    """``auto``, ``off`` or ``soft-edges=SLOPE``."""
    word, equals, slope = text.strip().lower().partition("=")
    if (word, equals) == ("soft-edges", "="):
        try:
            value = number(slope)
        except QuantityError:
            value = -1.0
        if value >= 0:
            return f"soft-edges={value:.9g}"
        problem = f"'{slope}' is no slope of soft edges"
        raise QuantityError(problem, "write it like soft-edges=0.3, in px of radius per px")
    if equals or word not in REPAIRS:
        known = f"choose from {', '.join(REPAIRS)}, soft-edges=SLOPE"
        raise QuantityError(f"'{text}' is no depth repair", did_you_mean(word, REPAIRS, known))
    return word


def edge_width(text: str) -> float:
    """A width in the picture, from ``8px`` or ``8``; 0 for hard edges."""
    px = 0.0 if re.fullmatch(r"\s*0+(\.0*)?\s*(px)?\s*", text, re.I) else pixel_count(text)
    if px > WIDEST_EDGE:
        raise QuantityError(f"{px:g} px is a surface, and no edge", f"give {WIDEST_EDGE}px or less")
    return px


REPAIRS = ("auto", "off")
WIDEST_EDGE = 100  # px; of defocus_core, too


def words(text: str) -> tuple[str, ...]:
    """Words separated by commas or blanks, each once."""
    found = tuple(dict.fromkeys(text.replace(",", " ").split()))
    if not found:
        raise QuantityError(f"'{text}' names nothing", "write it like diffuse.*,specular.*")
    return found


PARSERS: dict[str, Callable[[str], Any]] = {
    "depth-format": format_name,
    "depth-unit": one_of(tuple(UNITS)),
    "depth-channel": str,
    "depth-scale": scale,
    "depth-kind": one_of(KINDS),
    "depth-range": distances,
    "focal-px": pixel_count,
    "baseline": distance,
    "doffs": number,
    "fov": field_of_view,
    "sky": number,
    "invalid": one_of(INVALID),
    "resize-depth": one_of(RESIZES),
    "depth-repair": depth_repair,
    "edge-width": edge_width,
    "color-layer": str,
    "blur-channels": words,
    "part": whole,
    "view": str,
    "unpremultiply-depth": one_of(UNPREMULTIPLY),
}
NAMES_OF_OPTIONS = (*PARSERS, *GEOMETRIES)


def reading_values(values: Mapping[str, Any], where: Callable[[str], str]) -> dict[str, Any]:
    """Fields of `Reading` of the values of a table of a TOML file; other keys are passed over.

    Args:
        values: keys of the file and their values.
        where: file and key, for errors.

    Raises:
        UsageProblem: a value makes no sense.
    """
    fields: dict[str, Any] = {}
    for name, value in values.items():
        if name in GEOMETRIES:
            if value is not True:
                raise UsageProblem(
                    "malformed", f"{value!r} is not true", f"write {name} = true", path=where(name)
                )
            if fields.setdefault("geometry", name) != name:
                raise UsageProblem(
                    "contradiction", "contradicts the other", "give one of them", path=where(name)
                )
        elif name in PARSERS:
            fields[name.replace("-", "_")] = _parsed(name, value, where(name))
    return fields


def lens_file_reading(file: Path | None) -> dict[str, Any]:
    """Fields of `Reading` that a lens file has beside the options of the lens.

    Raises:
        InputError: the file cannot be read as TOML.
        UsageProblem: a value makes no sense.
    """
    if file is None:
        return {}
    remedy = 'give a TOML file, with lines like focal-length = "50mm"'
    stored = read_toml(file, what="lens file", remedy=remedy)
    return reading_values(stored, lambda name: f"{file}: {name}")


def make_reading(
    fields: Mapping[str, Any], below: Mapping[str, Any], edge_width_place: str = "‹edge-width›"
) -> Reading:
    """The reading of the fields that are set, over those of a lens file.

    Raises:
        UsageProblem: the width of edges contradicts the repair of depth.
    """
    options = {name: value for name, value in fields.items() if value is not None}
    reading = Reading(**{**below, **options})
    repair, width = reading.depth_repair, reading.edge_width
    if width is not None and (repair == "off" or (repair != "auto" and width == 0)):
        problem = f"of {width:g}px contradicts depth-repair {repair}"
        raise UsageProblem("contradiction", problem, "leave one of them out", path=edge_width_place)
    return reading


def _parsed(name: str, value: object, where: str) -> Any:
    if PARSERS[name] is str and not (isinstance(value, str) and value and "\0" not in value):
        raise UsageProblem(
            "malformed", f"{value!r} is not a text", "write it in quotes", path=where
        )
    if isinstance(value, bool):
        raise UsageProblem(
            "malformed",
            f"{str(value).lower()} is no value of it",
            "see 'defocus help depth'",
            path=where,
        )
    return read_at(where, PARSERS[name], text_of(value))

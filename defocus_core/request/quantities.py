"""Parsers of option values: lengths with a unit, angles, pixels, counts.

Each parser takes the text of a value on the command line or in a TOML file. Lengths are returned in
mm, angles in degrees, other quantities as plain numbers. Arithmetic is decimal, so that ``2.3m`` is
exactly 2300 mm and is written back unchanged.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import TypeVar

from defocus_core import gone
from defocus_core.allowed_values import AUTO_LIGHTS
from defocus_core.errors import Place, UsageProblem, did_you_mean

T = TypeVar("T")

_PLAIN = {"": 1}
_PX = {"": 1, "px": 1}
_MM = {"mm": "1", "cm": "10", "m": "1000", "in": "25.4", "ft": "304.8"}
_DEGREES = {"": 1, "deg": 1, "°": 1}
_BYTES = {
    **{"b": 1, "kb": 10**3, "mb": 10**6, "gb": 10**9, "tb": 10**12},
    **{"kib": 2**10, "mib": 2**20, "gib": 2**30, "tib": 2**40},
}
_MAX_LENGTH = 1e30  # mm, so that its square is finite, too
_MAX_ELECTRONS = 1e9
_MAX_BLADES = 100  # blades of a polygon that looks like a circle
# Characters of a number, and of any text, as patterns take quadratic or cubic time.
_LONGEST_NUMBER, _LONGEST_TEXT = 200, 2**16
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d{1,3})?)\s*([^\W\d_]*|[°%])\s*", re.I)
_PERCENTILE = re.compile(r"\s*percentile\s*\(([^(),]*)\)\s*", re.I)


class QuantityError(ValueError):
    """A text that cannot be parsed, with the problem and what to write instead."""

    def __init__(self, problem: str, remedy: str, code: str = "malformed") -> None:
        super().__init__(f"{problem}; {remedy}")
        self.code = code
        self.problem = problem
        self.remedy = remedy


@dataclass(frozen=True)
class Percentile:
    """A focus distance given as a percentile of the depths of all pixels except sky."""

    percent: float

    def __str__(self) -> str:
        return f"percentile({self.percent:.9g})"


@dataclass(frozen=True)
class SideShare:
    """A length in the picture in percent of its longer side, like ``2%``."""

    percent: float

    def __str__(self) -> str:
        return f"{self.percent:.9g}%"


class Unitless(tuple[float, float]):
    """Two numbers without a unit, given instead of lengths.

    They are numbers of the depth file (sharp range) or shares of the blur (axial colour).
    """


def short(text: str, maximum: int = _LONGEST_NUMBER) -> str:
    """The unchanged text; raises QuantityError if it has more than `maximum` characters."""
    if len(text) > maximum:
        problem = f"'{text[:20]}…' has {len(text)} characters, of which {maximum} are read"
        raise QuantityError(problem, "write a shorter one")
    return text


def read_at(where: Place, parse: Callable[..., T], *texts: str) -> T:
    """Parse texts with `parse`; a parsing error becomes a UsageProblem that names their place."""
    try:
        for text in texts:
            short(text, _LONGEST_TEXT)
        return parse(*texts)
    except QuantityError as error:
        remedy = error.remedy
        for word in " ".join(texts).replace(",", " ").split():
            remedy = gone.remedy("value", word, where.field, remedy)
        raise UsageProblem(error.code, error.problem, remedy, path=where) from None


def quantity(
    what: str,
    example: str,
    units: Mapping[str, str | int] = _PLAIN,
    *,
    least: float = -math.inf,
    most: float = math.inf,
    is_positive: bool = False,
) -> Callable[[str], float]:
    """Make a parser of a finite number with a unit, which it converts by the factor of the unit.

    `units` are factors by unit; the key "" allows numbers without a unit. `what` (like "an angle")
    and `example` (like "like 15deg") are words for errors.
    """

    def parse(text: str) -> float:
        match = _NUMBER.fullmatch(short(text))
        if not match:
            raise QuantityError(f"'{text}' is not {what}", f"write it {example}")
        unit = match[2].lower()
        if unit not in units:
            if not unit:
                raise QuantityError(f"'{text}' has no unit", f"write it with a unit, {example}")
            known = " or ".join(filter(None, units)) or "no unit"
            raise QuantityError(f"'{text}' has an unknown unit", f"use {known}, {example}")
        value = float(Decimal(match[1]) * Decimal(units[unit]))
        if not math.isfinite(value) or (is_positive and value <= 0):
            problem = f"'{text}' is not {'positive and ' * is_positive}finite"
            raise QuantityError(problem, f"give one that is, {example}")
        if not least <= value <= most:
            limits = f"{least:g} to {most:g}" if most < math.inf else f"{least:g} or more"
            raise QuantityError(f"'{text}' is not {what}", f"give {limits}, {example}")
        return value

    return parse


number = quantity("a number", "like 1.5")
_limits = {"least": 1 / _MAX_LENGTH, "most": _MAX_LENGTH}
# A positive length in mm, from ``50mm``, ``2.5 cm``, ``2m``, ``1in`` or ``6ft``.
length = quantity("a length", "like 2m or 50mm", _MM, is_positive=True, **_limits)
# The same, where plain numbers are metres; and the end of a range, which may be 0.
distance = quantity("a length", "like 2m or 50mm", _MM | {"": "1000"}, is_positive=True, **_limits)
_end = quantity("a distance", "like 2m, 0 or inf", _MM | {"": "1000"}, least=0, most=_MAX_LENGTH)
percentage = quantity("a percentage", "like 50", {"": 1, "%": 1}, least=0, most=100)
# A positive length in the picture, from ``40px`` or ``40``.
pixel_count = quantity("a length in px", "like 40px", _PX, least=0, most=1e6, is_positive=True)
angle = quantity("an angle", "like 15deg", _DEGREES, least=-360, most=360)
field_of_view = quantity("a field of view", "like 60", _DEGREES, least=0.01, most=179)
_fnumber = quantity("an f-number", "like 1.4", is_positive=True)
_bytes = quantity("a size", "like 2GB", _BYTES, least=1)


def fnumber(text: str) -> float:
    """Parse a positive f-number, written like ``1.4`` or ``f/1.4``."""
    return _fnumber(text.lower().removeprefix("f/"))


def byte_count(text: str) -> int:
    """Parse a positive size in bytes, written like ``1GB``, ``500 MB``, ``1.5GiB`` or ``4096B``."""
    return int(_bytes(text))


def scale(text: str) -> float:
    """Parse a factor other than 0, written like ``0.001``, ``1/256`` or ``-1``."""
    over, slash, under = text.partition("/")
    divisor = number(under) if slash else 1.0
    factor = number(over) / divisor if divisor else 0.0
    if factor == 0 or not math.isfinite(factor):
        raise QuantityError(f"'{text}' is 0 or not finite", "write it like 0.001 or 1/256")
    return factor


def distances(text: str) -> tuple[float, float]:
    """Parse two distances, written like ``2m 50m``, ``0 50m`` or ``2m inf``, to mm."""
    words = text.replace(",", " ").split()
    if len(words) != 2:
        raise QuantityError(f"'{text}' is not two distances", "write them like 2m 50m")
    first, second = (math.inf if _is_infinite(word) else _end(word) for word in words)
    return first, second


def _is_infinite(text: str) -> bool:
    return text.strip().lower() in ("inf", "infinity")


def sharp_range(text: str) -> tuple[float, float]:
    """Parse a range of distances like ``1.8m..2.4m`` to its ends in mm, nearer first.

    Without units, as in ``100..200``, the numbers are returned as `Unitless`.
    """
    ends = [end.strip() for end in short(text).split("..")]
    if len(ends) != 2:
        raise QuantityError(f"'{text}' is not a range of distances", "write it like 1.8m..2.4m")
    try:
        low, high = map(number, ends)
        made: tuple[float, float] = Unitless((low, high))
    except QuantityError:
        made = low, high = length(ends[0]), math.inf if ends[1] == "inf" else length(ends[1])
    if low > high:
        raise QuantityError(f"'{text}' ends before it begins", "write the nearer distance first")
    return made


def focus(text: str) -> float | Percentile:
    """Parse a focus like ``2m`` or ``inf`` to mm, or a percentile like ``percentile(50)``."""
    if _is_infinite(text):
        return math.inf
    match = _PERCENTILE.fullmatch(short(text))
    return Percentile(percentage(match[1])) if match else length(text)


def blur(text: str) -> float | SideShare:
    """Parse a positive blur radius: in px like ``40px`` or ``40``, or a share like ``2%``."""
    if not text.strip().endswith("%"):
        return pixel_count(text)
    percent = percentage(text)
    if not percent:
        raise QuantityError(f"'{text}' is not positive", "write it like 2%")
    return SideShare(percent)


def whole_within(minimum: int, maximum: int = 10**9 - 1) -> Callable[[str], int]:
    """Make a parser of whole numbers from ``minimum`` to ``maximum``, both included."""
    limits = f"{minimum} to {maximum}" if maximum < 10**9 - 1 else f"{minimum} or more"

    def parse(text: str) -> int:
        if not re.fullmatch(r"\s*\d{1,9}\s*", short(text)):
            problem = f"'{text}' is not a whole number of {limits}"
            raise QuantityError(problem, f"write it like {max(minimum, 7)}")
        if not minimum <= int(text) <= maximum:
            raise QuantityError(f"{int(text)} is not in the range {limits}", "give one that is")
        return int(text)

    return parse


whole = whole_within(0)
_blades = whole_within(0, _MAX_BLADES)


def blades(text: str) -> int:
    """Parse the number of aperture blades: 0 for a round aperture, else 3 or more."""
    count = _blades(text)
    if count in (1, 2):
        raise QuantityError(f"{count} blades make no aperture", "give 0 (round) or 3 and more")
    return count


def pixel(text: str) -> tuple[int, int]:
    """Parse a pixel, written ``X,Y``, to (x, y), counted from 0 at the upper left."""
    match = re.fullmatch(r"\s*(-?\d+)\s*,\s*(-?\d+)\s*", short(text))
    if not match:
        raise QuantityError(f"'{text}' is not a pixel", "write it as X,Y, like 240,135")
    return int(match[1]), int(match[2])


def always(value: T) -> Callable[[str], T]:
    """Make a parser that ignores its text and returns `value`, for flags."""
    return lambda _: value


def one_of(
    words: Collection[str], code: str = "malformed", otherwise: str = ""
) -> Callable[[str], str]:
    """Make a parser that accepts only the given words.

    `code` is that of its error, `otherwise` the remedy if no word is similar.
    """

    def parse(text: str) -> str:
        if text not in words:
            remedy = did_you_mean(text, [*words], otherwise or f"choose from {', '.join(words)}")
            raise QuantityError(f"'{text}' is not known", remedy, code)
        return text

    return parse


def switch(text: str) -> bool:
    """Parse ``on`` to True and ``off`` to False."""
    return one_of(("on", "off"))(text.strip().lower()) == "on"


def several(parse: Callable[[str], T]) -> Callable[[str], tuple[T, ...]]:
    """Make a parser of values separated by commas; `parse` is for one, duplicates are dropped."""

    def parse_all(text: str) -> tuple[T, ...]:
        words = [word.strip() for word in text.split(",")]
        if not all(words):
            raise QuantityError(f"'{text}' names nothing", "write names with commas between them")
        return tuple(dict.fromkeys(map(parse, words)))

    return parse_all


def file(text: str) -> Path:
    """Parse the path of a file, which must not be empty."""
    if not text or "\0" in text:
        raise QuantityError(f"{text!r} is not the name of a file", "write it like pupil.png")
    return Path(text)


def dual_pixel(models: Sequence[str]) -> Callable[[str], str | Path]:
    """Make a parser of a dual-pixel model: one of `models`, or the path of a .npy kernel file."""

    def parse(text: str) -> str | Path:
        if (word := text.strip().lower()) in models:
            return word
        if not word.endswith(".npy") or word.startswith("@"):
            remedy = f"write {' or '.join(models)}, or name a file of kernels, like pair.npy"
            raise QuantityError(f"'{text}' is not a model of dual pixels", remedy)
        return file(text)

    return parse


def _pair(
    first: Callable[[str], float], second: Callable[[str], float], problem: str, remedy: str
) -> Callable[[str], tuple[float, float]]:
    """Make a parser of two quantities with a colon; `problem` and `remedy` describe its error."""

    def parse(text: str) -> tuple[float, float]:
        words = text.split(":")
        if len(words) != 2:
            raise QuantityError(f"'{text}' is {problem}", remedy)
        return first(words[0]), second(words[1])

    return parse


_LIGHTS, _RIM, _ELECTRONS = "like 0.93:8", "like 1.05:1.5", "like 4000:3"
_clipped = _pair(
    quantity("a threshold in linear light", _LIGHTS, least=0, most=0.999),
    quantity("a gain", _LIGHTS, least=1, most=1000),
    "no THRESHOLD:GAIN",
    f"write auto, or {_LIGHTS}",
)
rim = _pair(  # radius and distance of the rim, in radii of the opening
    quantity("the radius of a rim", _RIM, least=0.1, most=10),
    quantity("the distance of a rim", _RIM, least=0, most=100),
    "not the rim of a barrel",
    f"write it {_RIM}",
)
_electrons = partial(
    quantity, "a number of electrons", _ELECTRONS, {"": 1, "e": 1}, most=_MAX_ELECTRONS
)
_sensor = _pair(  # electrons at a light of 1, and of read noise
    _electrons(least=1 / _MAX_ELECTRONS),
    _electrons(least=0),
    "not a sensor noise",
    f"write match, or ELECTRONS:READ, {_ELECTRONS}",
)
# The noise of the photograph itself.
MATCH = "match"
_shift = quantity("a focus shift", "like 0.1mm", _MM, least=-10, most=10)
_share = quantity("a share of the blur", "like 0.1", least=-1, most=1)
_LIKE = "no RED:BLUE", "write it like 0.1mm:0.05mm"
_shifts, _shares = _pair(_shift, _shift, *_LIKE), _pair(_share, _share, *_LIKE)


def noise(text: str) -> tuple[float, float] | str:
    """Parse sensor noise like ``4000:3``, or the word ``match``.

    The numbers are the electrons that light of 1 frees, and those of the read noise.
    """
    word = text.strip().lower()
    return word if word == MATCH else _sensor(text)


def highlights(text: str) -> tuple[float, float] | None:
    """Parse threshold and gain of lights: ``0.93:8``, or ``auto``, a default; None for ``off``."""
    word = text.strip().lower()
    return {"auto": AUTO_LIGHTS, "off": None}[word] if word in ("auto", "off") else _clipped(text)


def shifts(text: str) -> tuple[float, float]:
    """Parse focus shifts of red and blue like ``0.1mm:0.05mm`` to mm; they may be negative.

    Without units, as shares of a blur in px, they are returned as `Unitless`.
    """
    has_unit = any(letter.isalpha() for letter in text.replace("e", ""))
    return _shifts(text) if has_unit else Unitless(_shares(text))


def text_of(value: object) -> str:
    """A value from TOML, JSON or CSV as it is written on the command line; lists with commas."""
    return ",".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def length_text(mm: float, digits: int = 6) -> str:
    """A length as text for people, like ``50mm``, ``2m`` or ``inf``."""
    if math.isinf(mm):
        return "inf"
    return f"{mm / 1000:.{digits}g}m" if abs(mm) >= 1000 else f"{mm:.{digits}g}mm"

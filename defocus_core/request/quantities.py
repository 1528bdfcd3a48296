"""Parsers of quantities: lengths with a unit, angles, pixels, counts.

A parser takes a text of the command line or a lens file and returns millimetres, degrees or plain
numbers. Decimal arithmetic keeps ``2.3m`` at 2300 mm, so that it can be written back unchanged.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import TypeVar

from defocus_core import gone
from defocus_core.allowed_values import AUTO_LIGHTS
from defocus_core.errors import Place, UsageProblem, did_you_mean

T = TypeVar("T")

_MM = {"mm": "1", "cm": "10", "m": "1000", "in": "25.4", "ft": "304.8"}
_BYTES = {
    **{"b": 1, "kb": 10**3, "mb": 10**6, "gb": 10**9, "tb": 10**12},
    **{"kib": 2**10, "mib": 2**20, "gib": 2**30, "tib": 2**40},
}
_MAX_LENGTH = 1e30  # mm
_MAX_ELECTRONS = 1e9
_MAX_SHIFT = 10.0  # mm of focus shift of a colour
MAX_BLADES = 100  # blades of a polygon that looks like a circle
# Characters of a number, and of any text, as patterns take quadratic or cubic time.
_LONGEST_NUMBER, _LONGEST_TEXT = 200, 2**16
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d{1,3})?)\s*([^\W\d_]*)\s*", re.I)
_PERCENTILE = re.compile(r"\s*percentile\s*\(([^(),]*)\)\s*", re.I)


class QuantityError(ValueError):
    """A text is not the wanted quantity; has the problem, and what to write instead."""

    def __init__(self, problem: str, remedy: str, code: str = "malformed") -> None:
        super().__init__(f"{problem}; {remedy}")
        self.code = code
        self.problem = problem
        self.remedy = remedy


@dataclass(frozen=True)
class Percentile:
    """The percentile of the distance over all pixels except the sky."""

    percent: float

    def __str__(self) -> str:
        return f"percentile({self.percent:.9g})"


def require_length(text: str, maximum: int = _LONGEST_TEXT) -> str:
    """The text; raises if it has too many characters."""
    if len(text) > maximum:
        problem = f"'{text[:20]}…' has {len(text)} characters, of which {maximum} are read"
        raise QuantityError(problem, "write a shorter one")
    return text


def short(text: str) -> str:
    """The text; raises if it is longer than a number may be."""
    return require_length(text, _LONGEST_NUMBER)


def read_at(where: Place, parse: Callable[..., T], *texts: str) -> T:
    """The parsed value of a text, with errors at a place."""
    try:
        for text in texts:
            require_length(text)
        return parse(*texts)
    except QuantityError as error:
        remedy = error.remedy
        for word in " ".join(texts).replace(",", " ").split():
            remedy = gone.remedy("value", word, where.field, remedy)
        raise UsageProblem(error.code, error.problem, remedy, path=where) from None


def length(text: str) -> float:
    """A positive length in mm, from ``50mm``, ``2.5 cm``, ``2m``, ``1in`` or ``6ft``."""
    value = _positive(text, "a length", "like 2m or 50mm", _MM)
    if not 1 / _MAX_LENGTH <= value <= _MAX_LENGTH:  # so that its square is finite, too
        problem = f"'{text}' is not a length from 1e-30 to 1e30 mm"
        raise QuantityError(problem, "write it like 2m or 50mm")
    return value


class Unitless(tuple[float, float]):
    """Two numbers without a unit, in place of lengths: of a depth file, or shares of a blur."""


def sharp_range(text: str) -> tuple[float, float]:
    """Nearest and farthest distance in mm, parsed from ``1.8m..2.4m``, where inf may be the end.

    Without a unit, as ``100..200``, they are `Unitless`. The range includes both ends.
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
    """The distance in focus in mm, also ``inf``, or ``percentile(50)`` of the depth."""
    if text.strip().lower() in ("inf", "infinity"):
        return math.inf
    match = _PERCENTILE.fullmatch(short(text))
    return Percentile(percentage(match[1])) if match else length(text)


def percentage(text: str) -> float:
    """A number from 0 to 100, from ``5`` or ``5%``."""
    percent = _number(text.strip().removesuffix("%"), "a percentage", "like 50", {"": 1})
    if not 0 <= percent <= 100:
        raise QuantityError(f"'{text}' is not a percentage", "write one from 0 to 100, like 50")
    return float(percent)


def pixel_count(text: str) -> float:
    """A positive length in the picture, from ``40px`` or ``40``."""
    return _positive(text, "a length in px", "like 40px", {"": 1, "px": 1})


@dataclass(frozen=True)
class SideShare:
    """A length in the picture as a share of its longer side, like ``2%``."""

    percent: float

    def __str__(self) -> str:
        return f"{self.percent:.9g}%"


def blur(text: str) -> float | SideShare:
    """A positive length in the picture, from ``40px``, ``40`` or ``2%`` of its longer side."""
    if not text.strip().endswith("%"):
        return pixel_count(text)
    percent = percentage(text)
    if not percent:
        raise QuantityError(f"'{text}' is not positive", "write it like 2%")
    return SideShare(percent)


def number(text: str) -> float:
    """A finite number of either sign."""
    try:
        value = float(short(text))
    except ValueError:
        raise QuantityError(f"'{text}' is not a number", "write it like 1.5") from None
    if not math.isfinite(value):
        raise QuantityError(f"'{text}' is not finite", "write it like 1.5")
    return value


def fnumber(text: str) -> float:
    """A positive f-number, from ``1.4`` or ``f/1.4``."""
    return _positive(text.lower().removeprefix("f/"), "an f-number", "like 1.4", {"": 1})


def angle(text: str) -> float:
    """An angle in degrees, from ``15`` or ``15deg``."""
    units = {"": 1, "deg": 1}
    degrees = float(_number(text.replace("°", "deg"), "an angle", "like 15deg", units))
    if abs(degrees) > 360:
        raise QuantityError(f"'{text}' is more than a turn", "give -360 to 360 degrees")
    return degrees


def blades(text: str) -> int:
    """The number of aperture blades: 0 for a round opening, else 3 or more."""
    try:
        count = int(short(text))
    except ValueError:
        raise QuantityError(f"'{text}' is not a whole number", "write it like 6") from None
    if count < 0 or count in (1, 2):
        raise QuantityError(f"{count} blades make no opening", "give 0 (round) or 3 and more")
    if count > MAX_BLADES:
        raise QuantityError(
            f"{count} blades are too many", f"give at most {MAX_BLADES}, or 0 (round)"
        )
    return count


def number_within(
    minimum: float, maximum: float, what: str, example: str
) -> Callable[[str], float]:
    """A parser of plain numbers from ``minimum`` to ``maximum``; infinite for no limit."""

    def parse(text: str) -> float:
        value = float(_number(text, what, example, {"": 1}))
        if not minimum <= value <= maximum:
            bounds = f"{minimum:g} " + (f"to {maximum:g}" if maximum < math.inf else "or more")
            raise QuantityError(f"'{text}' is not {what}", f"give {bounds}, {example}")
        return value

    return parse


def always(value: T) -> Callable[[str], T]:
    """A parser that returns a constant, for options without a text."""
    return lambda _: value


def one_of(words: Sequence[str], code: str = "malformed") -> Callable[[str], str]:
    """A parser that takes one of the words."""

    def parse(text: str) -> str:
        if text not in words:
            remedy = did_you_mean(text, words, f"choose from {', '.join(words)}")
            raise QuantityError(f"'{text}' is not known", remedy, code)
        return text

    return parse


def several(parse: Callable[[str], T], example: str) -> Callable[[str], tuple[T, ...]]:
    """A parser of values separated by commas, without repetition, in order."""

    def read(text: str) -> tuple[T, ...]:
        try:
            return tuple(dict.fromkeys(parse(word.strip()) for word in text.split(",")))
        except QuantityError:
            raise
        except ValueError:
            problem = f"'{text}' is not a list of such values"
            raise QuantityError(problem, f"write it like {example}") from None

    return read


def dual_pixel(models: Sequence[str]) -> Callable[[str], str | Path]:
    """A parser of a model of dual pixels, or of the path of a file of kernels."""

    def parse(text: str) -> str | Path:
        if (word := text.strip().lower()) in models:
            return word
        if not word.endswith(".npy") or word.startswith("@"):
            remedy = f"write {' or '.join(models)}, or name a file of kernels, like pair.npy"
            raise QuantityError(f"'{text}' is not a model of dual pixels", remedy)
        return file(text)

    return parse


def pair(
    first: Callable[[str], float], second: Callable[[str], float], problem: str, remedy: str
) -> Callable[[str], tuple[float, float]]:
    """A parser of two quantities separated by a colon."""

    def parse(text: str) -> tuple[float, float]:
        words = text.split(":")
        if len(words) != 2:
            raise QuantityError(f"'{text}' is {problem}", remedy)
        return first(words[0]), second(words[1])

    return parse


_LIGHTS = "like 0.93:8"
_clipped = pair(
    number_within(0, 0.999, "a threshold in linear light", _LIGHTS),
    number_within(1, 1000, "a gain", _LIGHTS),
    "no THRESHOLD:GAIN",
    f"write auto, or {_LIGHTS}",
)


def highlights(text: str) -> tuple[float, float] | None:
    """Threshold and gain of clipped lights, from ``auto`` or ``0.93:8``; None for ``off``."""
    word = text.strip().lower()
    return {"auto": AUTO_LIGHTS, "off": None}[word] if word in ("auto", "off") else _clipped(text)


_RIM = "like 1.05:1.5"
rim = pair(  # radius and distance of the rim, in radii of the opening
    number_within(0.1, 10, "the radius of a rim", _RIM),
    number_within(0, 100, "the distance of a rim", _RIM),
    "not the rim of a barrel",
    f"write it {_RIM}",
)


def _shift(text: str) -> float:
    mm = float(_number(text, "a length", "like 0.1mm", _MM))
    if abs(mm) > _MAX_SHIFT:
        raise QuantityError(f"'{text}' shifts too far", f"give {_MAX_SHIFT:g}mm at most")
    return mm


_SHARE = number_within(-1, 1, "a share of the blur", "like 0.1")
_LIKE = "no RED:BLUE", "write it like 0.1mm:0.05mm"
_shifts, _shares = pair(_shift, _shift, *_LIKE), pair(_SHARE, _SHARE, *_LIKE)


def shifts(text: str) -> tuple[float, float]:
    """Focus shifts of red and blue in mm, of either sign; `Unitless` beside a blur in px."""
    has_unit = any(letter.isalpha() for letter in text.replace("e", ""))
    return _shifts(text) if has_unit else Unitless(_shares(text))


def _electrons(minimum: float) -> Callable[[str], float]:
    parse = number_within(minimum, _MAX_ELECTRONS, "a number of electrons", "like 4000:3")
    return lambda text: parse(text.strip().removesuffix("e"))


# Electrons at a light of 1, and electrons of read noise.
noise = pair(
    _electrons(1 / _MAX_ELECTRONS),
    _electrons(0),
    "not a sensor noise",
    "write ELECTRONS:READ, like 4000:3",
)


def switch(text: str) -> bool:
    """True for ``on``, False for ``off``."""
    return one_of(("on", "off"))(text.strip().lower()) == "on"


def whole_within(minimum: int, maximum: int = 10**9 - 1) -> Callable[[str], int]:
    """A parser of whole numbers from ``minimum`` to ``maximum``."""
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


def file(text: str) -> Path:
    """The path of a file."""
    if not text or "\0" in text:
        raise QuantityError(f"{text!r} is not the name of a file", "write it like pupil.png")
    return Path(text)


def pixel(text: str) -> tuple[int, int]:
    """A pixel (x, y), counted from 0 at the upper left, from ``X,Y``."""
    match = re.fullmatch(r"\s*(-?\d+)\s*,\s*(-?\d+)\s*", short(text))
    if not match:
        raise QuantityError(f"'{text}' is not a pixel", "write it as X,Y, like 240,135")
    return int(match[1]), int(match[2])


def byte_count(text: str) -> int:
    """A positive number of bytes, from ``1GB``, ``500 MB``, ``1.5GiB`` or ``4096B``."""
    count = int(_number(text, "a size", "like 2GB", _BYTES))
    if count < 1:
        raise QuantityError(f"'{text}' holds no byte", "write it like 2GB")
    return count


def text_of(value: object) -> str:
    """The text on the command line of a value of TOML, JSON or CSV."""
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)


def length_text(mm: float, digits: int = 6) -> str:
    """A length for people, like ``50mm``, ``2m`` or ``inf``."""
    if math.isinf(mm):
        return "inf"
    return f"{mm / 1000:.{digits}g}m" if abs(mm) >= 1000 else f"{mm:.{digits}g}mm"


def _number(text: str, what: str, example: str, units: Mapping[str, str | int]) -> Decimal:
    """A number times its unit; the empty unit is for plain numbers."""
    match = _NUMBER.fullmatch(short(text))
    if not match:
        raise QuantityError(f"'{text}' is not {what}", f"write it {example}")
    unit = match[2].lower()
    if unit in units:
        return Decimal(match[1]) * Decimal(units[unit])
    if not unit:
        raise QuantityError(f"'{text}' has no unit", f"write it with a unit, {example}")
    known = " or ".join(filter(None, units)) or "no unit"
    raise QuantityError(f"'{text}' has an unknown unit", f"use {known}, {example}")


def _positive(text: str, what: str, example: str, units: Mapping[str, str | int]) -> float:
    value = float(_number(text, what, example, units))
    if not 0 < value < math.inf:
        raise QuantityError(f"'{text}' is not positive and finite", f"give one that is, {example}")
    return value

"""Lens options: their names, and how each is read and written.

Files hold options as texts, ``{"focus": "2m"}``; `parsed` reads one. What goes into a file name is
a short form of it, like ``focus2m``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from defocus_cli.jobs import quantities
from defocus_cli.jobs.quantities import length_text
from defocus_cli.system.errors import UsageProblem, did_you_mean

PARSERS: dict[str, Callable[[str], Any]] = {
    "focal-length": quantities.length,
    "fnumber": quantities.fnumber,
    "aperture-diameter": quantities.length,
    "sensor-width": quantities.length,
    "focus": quantities.focus,
    "focus-at": quantities.pixel,
    "blades": quantities.blades,
    "blade-rotation": quantities.angle,
}
LENGTHS = frozenset({"focal-length", "aperture-diameter", "sensor-width", "focus"})
ALTERNATIVES = (("fnumber", "aperture-diameter"), ("focus", "focus-at"))
EXAMPLES = {"focal-length": "50mm", "fnumber": "1.4", "focus": "2m"}
_TAGS = {
    "focal-length": "fl",
    "fnumber": "f",
    "aperture-diameter": "d",
    "sensor-width": "sensor",
    "focus": "focus",
    "focus-at": "at",
    "blades": "blades",
    "blade-rotation": "turn",
}


@lru_cache(maxsize=65536)
def parsed(name: str, text: str) -> Any:
    """The value of an option, in mm, degrees or plain numbers.

    Raises:
        QuantityError: the text makes no sense.
    """
    return PARSERS[name](text)


def text_of(value: object) -> str:
    """An option as TOML, JSON or CSV hold it, as the text that the command line would take."""
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)


def written(name: str, value: Any) -> str:
    """The text whose value this is, to the last digit."""
    if isinstance(value, tuple):
        return ",".join(map(str, value))
    length = name in LENGTHS and isinstance(value, float) and value != float("inf")
    return f"{value}mm" if length else str(value)


def tag(name: str, value: Any) -> str:
    """What a file name says of an option, like ``focus2m``, ``f1.4`` or ``at240x135``."""
    if isinstance(value, quantities.Percentile):
        return f"focusp{value.percent:.6g}"
    if isinstance(value, tuple):
        return _TAGS[name] + "x".join(map(str, value))
    return _TAGS[name] + (length_text(value) if name in LENGTHS else f"{value:.6g}")


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Options of which ``over`` win, also over the other way to say the same.

    Blades that ``over`` takes away are not turned any more.
    """
    options = dict(base)
    if str(over.get("blades")) == "0":
        options.pop("blade-rotation", None)
    for one, other in ALTERNATIVES:
        if one in over or other in over:
            options.pop(one, None)
            options.pop(other, None)
    return {**options, **over}


def refuse_unknown(name: str, where: str | Path, teller: str, more: Sequence[str] = ()) -> None:
    """Raise UsageProblem unless a lens has an option ``name``; ``more`` are known there too."""
    known = (*PARSERS, *more)
    if name not in known:
        remedy = did_you_mean(name.replace("_", "-"), known, f"{teller} knows {', '.join(known)}")
        raise UsageProblem(where, f"unknown key '{name}'", remedy)


def refuse_idle_turn(turned: object, blades: object, where: str = "") -> None:
    """Raise UsageProblem if there are no blades to be turned; ``where`` is the file, with a colon.

    Args:
        turned: whether a rotation is given.
        blades: whether the aperture has, or may have, blades.
        where: the file that says so; empty for the command line.
    """
    if turned and not blades:
        remedy = f"give it some, like {'blades =' if where else '--blades'} 6, or leave it out"
        problem = "turns blades; this aperture is round"
        raise UsageProblem(f"{where or '--'}blade-rotation", problem, remedy)


def refuse_both(values: Mapping[str, Any], where: str = "") -> None:
    """Raise UsageProblem if two options say the same; ``where`` is the file, ending in a colon."""
    dashes = "" if where else "--"
    for one, other in ALTERNATIVES:
        if one in values and other in values:
            problem = f"contradicts {dashes}{other}"
            raise UsageProblem(f"{where}{dashes}{one}", problem, "give one of them")

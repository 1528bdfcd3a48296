"""Sweeps of a jobs file: a grid of lenses, each with a name of its own.

``[sweep]`` gives an option of the lens a list of values, or a range like ``0.5m..8m @ 12 in
disparity``; several options make a grid. ``lenses`` lists sets of options that belong together. The
name of a lens holds what is swept and nothing else, so that it stays when a list grows.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from defocus_cli.jobs import lens_options
from defocus_cli.jobs.lens_options import PARSERS, parsed, tag, text_of, written
from defocus_cli.jobs.quantities import Percentile, QuantityError
from defocus_cli.jobs.toml_file import Table
from defocus_cli.system.errors import UsageProblem

MOST_LENSES = 100_000
_RANGE = re.compile(r"(.+?)\.\.(.+?)@\s*(\d{1,6})\s*(?:in\s+(\w+)\s*)?")
_RANGE_EXAMPLE = "write it like 0.5m..8m @ 12 in disparity"
_SCALES: dict[str, tuple[Callable[[float], float], Callable[[float], float]]] = {
    "depth": (float, float),
    "steps": (float, float),
    "log": (math.log, math.exp),
    "disparity": (lambda z: 1 / z, lambda x: math.inf if x == 0 else 1 / x),
}


@dataclass(frozen=True)
class Point:
    """One lens of a sweep: what it adds to a picture's name, and its options as texts."""

    suffix: str
    options: Mapping[str, str]


def read_sweep(table: Table) -> list[Point]:
    """The lenses of ``[sweep]``: the first option changes slowest. One without any if it is empty.

    Raises:
        UsageProblem: an option is unknown, a value makes no sense, or two lenses have one name.
    """
    known = (*PARSERS, "lenses")
    table.refuse_unknown(known)
    axes = [
        [{name: text} for text in _values(name, table.values[name], table.place(name))]
        for name in PARSERS
        if name in table.values
    ]
    if "lenses" in table.values:
        axes.insert(0, _sets(table))
    count = math.prod(map(len, axes))
    if count > MOST_LENSES:
        problem = f"makes {count} lenses for each picture"
        raise UsageProblem(f"{table.file}: [sweep]", problem, f"ask for at most {MOST_LENSES}")
    return _points(table, axes)


def _points(table: Table, axes: Sequence[Sequence[Mapping[str, str]]]) -> list[Point]:
    points: dict[str, Point] = {}
    for combination in product(*axes):
        options: dict[str, str] = {}
        for part in combination:
            twice = next((name for name in part if name in options), None)
            if twice is not None:
                problem = "is in lenses, too"
                raise UsageProblem(table.place(twice), problem, "sweep it in one place")
            options |= part
        lens_options.refuse_both(options, f"{table.file}: [sweep] ")
        names = (name for name in PARSERS if name in options)
        suffix = "".join(f"_{tag(name, parsed(name, options[name]))}" for name in names)
        if suffix in points:
            problem = f"has two lenses named '{suffix[1:]}'"
            raise UsageProblem(f"{table.file}: [sweep]", problem, "remove one of them")
        points[suffix] = Point(suffix, options)
    return list(points.values())


def _values(name: str, value: object, where: str) -> list[str]:
    """Texts of the values of one option."""
    if isinstance(value, str) and ".." in value:
        return _range(name, value, where)
    if not isinstance(value, list) or not value:
        remedy = f"write a list, or a range: {_RANGE_EXAMPLE.removeprefix('write it ')}"
        raise UsageProblem(where, f"{value!r} is no list of values", remedy)
    return [_checked(name, text_of(one), where) for one in value]


def _sets(table: Table) -> list[dict[str, str]]:
    sets, where = table.values["lenses"], table.place("lenses")
    if not isinstance(sets, list) or not sets or not all(isinstance(one, dict) for one in sets):
        remedy = 'write lenses = [{focus = "1m", fnumber = 2}, {focus = "2m", fnumber = 4}]'
        raise UsageProblem(where, "is no list of lenses", remedy)
    for name in {name for one in sets for name in one}:
        lens_options.refuse_unknown(name, where, "a lens")
    return [
        {name: _checked(name, text_of(value), f"{where}: {name}") for name, value in one.items()}
        for one in sets
    ]


def _checked(name: str, text: str, where: str) -> str:
    try:
        parsed(name, text)
    except QuantityError as error:
        raise UsageProblem(where, error.problem, error.remedy) from None
    return text


def _range(name: str, text: str, where: str) -> list[str]:
    found = _RANGE.fullmatch(text.strip())
    if not found:
        raise UsageProblem(where, f"'{text}' is no range", _RANGE_EXAMPLE)
    low, high = (_end(name, found[side], where) for side in (1, 2))
    count, scale = int(found[3]), found[4] or ("disparity" if name == "focus" else "steps")
    fit = ("disparity", "depth", "log") if name == "focus" else ("steps", "log")
    if scale not in fit:
        raise UsageProblem(
            where, f"{name} has no steps in {scale}", f"write in {' or in '.join(fit)}"
        )
    if count < 2:
        raise UsageProblem(
            where, f"{count} is no number of steps", "give 2 or more, both ends count"
        )
    if scale != "disparity" and math.inf in (low, high):
        raise UsageProblem(where, f"cannot reach inf in {scale}", "write in disparity")
    if scale == "log" and min(low, high) <= 0:
        raise UsageProblem(where, "needs ends above 0 in log", "write in steps")
    values = [_between(low, high, index / (count - 1), scale) for index in range(count)]
    if name == "blades":
        values = [_whole(value, where) for value in values]
    return [_checked(name, written(name, value), where) for value in values]


def _end(name: str, text: str, where: str) -> float:
    value: Any = parsed(name, _checked(name, text.strip(), where))
    if isinstance(value, Percentile | tuple):
        remedy = "write a list of values"
        raise UsageProblem(where, f"'{text.strip()}' is no end of a range", remedy)
    return float(value)


def _between(low: float, high: float, share: float, scale: str) -> float:
    """The value at a share of the range, of six digits; its ends as they are."""
    if share in (0, 1):
        return high if share else low
    to, back = _SCALES[scale]
    return float(f"{back((1 - share) * to(low) + share * to(high)):.6g}")


def _whole(value: float, where: str) -> int:
    if value != int(value):
        raise UsageProblem(where, f"gets to {value:g} blades", "write a list, like [5, 6, 8]")
    return int(value)

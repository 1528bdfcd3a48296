"""Sweeps of a jobs file: a grid of lenses, each with a name of its own.

``[sweep]`` gives an option of the lens a list of values, or a range like ``0.5m..8m @ 12 in
disparity``; several options make a grid. ``lenses`` lists sets of options that belong together. The
name of a lens holds what is swept and nothing else, so that it stays when a list grows.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from defocus_core.batch.jobs.lens_from_options import (
    based,
    checked,
    parsed,
    refuse_contradiction,
)
from defocus_core.batch.jobs.toml_file import Table, refuse_unknown
from defocus_core.batch.lenses.parameters import LENS_OPTIONS, SCALES
from defocus_core.batch.lenses.quantities import Percentile
from defocus_core.errors import Place, UsageProblem

MAX_LENSES = 100_000
_RANGE = re.compile(r"(.+?)\.\.(.+?)@\s*(\d{1,6})\s*(?:in\s+(\w+)\s*)?")
_RANGE_EXAMPLE = "write it like 0.5m..8m @ 12 in disparity"


@dataclass(frozen=True)
class Point:
    """One lens of a sweep: the suffix of its samples, and its swept options as texts."""

    suffix: str
    options: Mapping[str, str]


def read_sweep(table: Table) -> list[Point]:
    """The lenses of ``[sweep]``, the first option slowest; one without options if empty."""
    table.refuse_unknown((*LENS_OPTIONS, "lenses"))
    axes = [_sets(table)] if "lenses" in table.values else []
    for name in LENS_OPTIONS:
        if name in table.values:
            texts = _values(name, table.values[name], table.place(name), table.file)
            _refuse_many(math.prod(map(len, axes)) * len(texts), table.place())
            axes.append([{name: text} for text in texts])
    return _points(table, axes)


def _refuse_many(count: int, where: Place) -> None:
    if count > MAX_LENSES:
        problem = f"makes {count} lenses for each picture"
        raise UsageProblem("out-of-range", problem, f"ask for at most {MAX_LENSES}", path=where)


def _points(table: Table, axes: Sequence[Sequence[Mapping[str, str]]]) -> list[Point]:
    points: dict[str, Point] = {}
    for combination in product(*axes):
        options: dict[str, str] = {}
        for part in combination:
            twice = next((name for name in part if name in options), None)
            if twice is not None:
                problem = "is in lenses, too"
                raise UsageProblem(
                    "contradiction", problem, "sweep it in one place", path=table.place(twice)
                )
            options |= part
        refuse_contradiction(options, table.place())
        rows = (row for name, row in LENS_OPTIONS.items() if name in options)
        suffix = "".join(f"_{row.file_tag(parsed(row.name, options[row.name]))}" for row in rows)
        if suffix in points:
            problem = f"has two lenses named '{suffix[1:]}'"
            raise UsageProblem(
                "contradiction", problem, "remove one of them", path=table.file, field="[sweep]"
            )
        points[suffix] = Point(suffix, options)
    return list(points.values())


def _values(name: str, value: object, where: Place, file: Path) -> list[str]:
    """Texts of the values of one option."""
    if isinstance(value, str) and ".." in value:
        return _range(name, value, where)
    if not isinstance(value, list) or not value:
        remedy = f"write a list, or a range: {_RANGE_EXAMPLE.removeprefix('write it ')}"
        raise UsageProblem("malformed", f"{value!r} is no list of values", remedy, path=where)
    _refuse_many(len(value), where)
    return [based(name, checked(name, one, where), file) for one in value]


def _sets(table: Table) -> list[dict[str, str]]:
    sets, where = table.values["lenses"], table.place("lenses")
    if not isinstance(sets, list) or not sets or not all(isinstance(one, dict) for one in sets):
        remedy = 'write lenses = [{focus = "1m", fnumber = 2}, {focus = "2m", fnumber = 4}]'
        raise UsageProblem("malformed", "is no list of lenses", remedy, path=where)
    _refuse_many(len(sets), where)
    refuse_unknown((name for one in sets for name in one), tuple(LENS_OPTIONS), where, "a lens")
    return [
        {
            name: based(name, checked(name, value, where.at(f"lenses: {name}")), table.file)
            for name, value in one.items()
        }
        for one in sets
    ]


def _range(name: str, text: str, where: Place) -> list[str]:
    """Texts of the values of a range; its ends are as they are written, values between rounded."""
    match = _RANGE.fullmatch(text.strip())
    if not match:
        raise UsageProblem("malformed", f"'{text}' is no range", _RANGE_EXAMPLE, path=where)
    low, high = (_end(name, match[side].strip(), where) for side in (1, 2))
    row = LENS_OPTIONS[name]
    fit = ("disparity", "depth", "log") if row.even_in == "disparity" else ("steps", "log")
    count, scale = int(match[3]), match[4] or fit[0]
    for wrong, problem, remedy in (
        (scale not in fit, f"{name} has no steps in {scale}", f"write in {' or in '.join(fit)}"),
        (count < 2, f"{count} is no number of steps", "give 2 or more, both ends count"),
        (
            scale != "disparity" and math.inf in (low, high),
            f"cannot reach inf in {scale}",
            "write in disparity",
        ),
        (scale == "log" and min(low, high) <= 0, "needs ends above 0 in log", "write in steps"),
    ):
        if wrong:
            raise UsageProblem("malformed", problem, remedy, path=where)
    _refuse_many(count, where)
    to, back = SCALES[scale]
    fractions = (index / (count - 1) for index in range(1, count - 1))
    between = [back((1 - fraction) * to(low) + fraction * to(high)) for fraction in fractions]
    values = [low, *(float(f"{value:.6g}") for value in between), high]
    return [checked(name, row.text(value), where) for value in values]


def _end(name: str, text: str, where: Place) -> float:
    value: Any = parsed(name, checked(name, text, where))
    if isinstance(value, Percentile | tuple | Path | str):
        raise UsageProblem(
            "malformed", f"'{text}' is no end of a range", "write a list of values", path=where
        )
    return float(value)

"""Sweeps and random draws of lens options: the tables ``[sweep]`` and ``[sample]`` of a jobs file.

The suffix that names a lens has its swept options alone, so it stays the same when more values are
added. A random draw depends only on ``seed``, the name of the picture, the suffix of the swept lens
and the number of the draw.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

from defocus_core.errors import Place, UsageProblem
from defocus_core.request.parameters import LENS_OPTIONS, SCALES
from defocus_core.request.picture_lenses import LISTED, Sampling
from defocus_core.request.quantities import Percentile, read_at, short, text_of, whole, whole_within
from defocus_core.request.resolver import (
    Given,
    Layer,
    distribution,
    given,
    refuse_contradiction,
    value_of,
)
from defocus_core.request.toml_file import Table, refuse_unknown

MAX_LENSES = 100_000
_RANGE = re.compile(r"(.+?)\.\.(.+?)@\s*(\d{1,6})\s*(?:in\s+(\w+)\s*)?")
_RANGE_EXAMPLE = "write it like 0.5m..8m @ 12 in disparity"


def read_sweep(table: Table) -> dict[str, Layer]:
    """The swept options of each lens of ``[sweep]``, by the suffix that names the lens.

    There is a lens for each combination of values; the first option varies slowest.
    """
    table.refuse_unknown((*LENS_OPTIONS, "lenses"))
    axes = [_sets(table)] if "lenses" in table.values else []
    for name in LENS_OPTIONS:
        if name in table.values:
            values = _values(name, table.values[name], table.place(name))
            _refuse_many(math.prod(map(len, axes)) * len(values), table.place())
            axes.append([{name: each} for each in values])
    return _points(table, axes)


def _refuse_many(count: int, where: Place) -> None:
    if count > MAX_LENSES:
        problem = f"makes {count} lenses for each picture"
        raise UsageProblem("out-of-range", problem, f"ask for at most {MAX_LENSES}", path=where)


def _points(table: Table, axes: Sequence[Sequence[Layer]]) -> dict[str, Layer]:
    points: dict[str, Layer] = {}
    for combination in product(*axes):
        options: dict[str, Given] = {}
        for part in combination:
            twice = next((name for name in part if name in options), None)
            if twice is not None:
                problem = "is in lenses, too"
                remedy = "sweep it in one place"
                raise UsageProblem("contradiction", problem, remedy, path=table.place(twice))
            options |= part
        refuse_contradiction(options)
        named = (row for name, row in LENS_OPTIONS.items() if name in options)
        suffix = "".join(f"_{row.file_tag(options[row.name].value)}" for row in named)
        if suffix in points:
            problem = f"has two lenses named '{suffix[1:]}'"
            remedy = "remove one of them"
            raise UsageProblem("contradiction", problem, remedy, path=table.file, field="[sweep]")
        points[suffix] = options
    return points


def _values(name: str, value: object, where: Place) -> list[Given]:
    if isinstance(value, str) and ".." in value:
        return _range(name, value, where)
    if not isinstance(value, list) or not value:
        remedy = f"write a list, or a range: {_RANGE_EXAMPLE.removeprefix('write it ')}"
        raise UsageProblem("malformed", f"{value!r} is not a list of values", remedy, path=where)
    _refuse_many(len(value), where)
    return [given(name, one, where) for one in value]


def _sets(table: Table) -> list[dict[str, Given]]:
    sets, where = table.values["lenses"], table.place("lenses")
    if not isinstance(sets, list) or not sets or not all(isinstance(one, dict) for one in sets):
        remedy = 'write lenses = [{focus = "1m", fnumber = 2}, {focus = "2m", fnumber = 4}]'
        raise UsageProblem("malformed", "is not a list of lenses", remedy, path=where)
    _refuse_many(len(sets), where)
    refuse_unknown((name for one in sets for name in one), tuple(LENS_OPTIONS), where, "a lens")
    return [
        {
            name: given(name, value, where.with_field(f"{LISTED}{name}"))
            for name, value in one.items()
        }
        for one in sets
    ]


def _range(name: str, text: str, where: Place) -> list[Given]:
    """The values of a range like ``0.5m..8m @ 12 in disparity``; all but the ends are rounded."""
    match = _RANGE.fullmatch(read_at(where, short, text).strip())
    if not match:
        raise UsageProblem("malformed", f"'{text}' is not a range", _RANGE_EXAMPLE, path=where)
    low, high = (_end(name, match[side].strip(), where) for side in (1, 2))
    row = LENS_OPTIONS[name]
    fit = ("disparity", "depth", "log") if row.even_in == "disparity" else ("steps", "log")
    count, scale = int(match[3]), match[4] or fit[0]
    for wrong, problem, remedy in (
        (scale not in fit, f"{name} has no steps in {scale}", f"write in {' or in '.join(fit)}"),
        (count < 2, f"{count} is not a number of steps", "give 2 or more, both ends count"),
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
    return [given(name, row.text(value), where) for value in values]


def _end(name: str, text: str, where: Place) -> float:
    value: Any = read_at(where, value_of, name, text)
    if isinstance(value, Percentile | tuple | Path | str):
        remedy = "write a list of values"
        raise UsageProblem("malformed", f"'{text}' is not an end of a range", remedy, path=where)
    return float(value)


_SAMPLE_KEYS = ("n", "seed", *LENS_OPTIONS)


def read_sampling(table: Table) -> Sampling:
    """Read the table ``[sample]``; without it, the count of draws is 0."""
    if not table.values:
        return Sampling()
    table.refuse_unknown(_SAMPLE_KEYS)
    count, seed = table.parsed("n", whole_within(1)), table.parsed("seed", whole)
    if count is None or seed is None:
        key = "n" if count is None else "seed"
        remedy = f"write {key} = 7 below [sample]"
        raise UsageProblem("missing-option", "is missing", remedy, path=table.place(key))
    texts = {name: text_of(table.values[name]) for name in table.values if name in LENS_OPTIONS}
    options = {
        name: Given(read_at(table.place(name), distribution, name, text), text, table.place(name))
        for name, text in texts.items()
    }
    refuse_contradiction(options)
    for value, text, place in options.values():
        if value is None:
            remedy = "put it below [lens], or write it like uniform(a, b) or choice(a, b)"
            raise UsageProblem("malformed", f"'{text}' is not a distribution", remedy, path=place)
    if not options:
        remedy = 'write fnumber = "loguniform(1.4, 16)" below [sample]'
        problem = "draws no option of the lens"
        raise UsageProblem("idle-option", problem, remedy, path=table.file, field="[sample]")
    return Sampling(count, seed, options)

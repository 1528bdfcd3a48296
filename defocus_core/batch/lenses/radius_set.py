"""A set of pictures by the radii of their blur, which other pictures are to have, too.

It is the folder of a finished batch, or a table, ``.csv`` or ``.jsonl``, with a row for each
picture and columns ``coc_mean_px``, ``coc_p50_px`` and ``coc_p99_px``: mean, median and 99th
percentile of its radii without sign, in px. ``count`` says how many pictures a row stands for, as
in a histogram.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

from defocus_core.errors import InputError, Place
from defocus_core.io.rows import read_rows

MEASURES = ("coc_mean_px", "coc_p50_px", "coc_p99_px")
INDEX = "metadata.jsonl"
_COUNT = "count"
_EXAMPLE = '{"coc_mean_px": 2.1, "coc_p50_px": 1.5, "coc_p99_px": 8}'
_GOLDEN = (math.sqrt(5) - 1) / 2
Radii = tuple[float, float, float]


@dataclass(frozen=True)
class RadiusSet:
    """The distributions of mean, median and 99th percentile over the pictures of a set.

    Attributes:
        values: of each, ascending.
        fractions: of each value the middle of its share of the pictures, in 0…1.
    """

    values: tuple[tuple[float, ...], ...]
    fractions: tuple[tuple[float, ...], ...]

    def at(self, fraction: float) -> Radii:
        """The radii at a share of each distribution: those of one rank go together.

        Values between two are interpolated, and have six digits.
        """
        mean, median, maximum = (
            float(f"{_interpolated(fraction, *one):.6g}")
            for one in zip(self.fractions, self.values, strict=True)
        )
        return mean, median, maximum


def spread(first: float, index: int) -> float:
    """The share in 0…1 of a lens of a picture: those of one picture spread evenly, however many.

    Args:
        first: that of the first lens.
        index: number of the lens.
    """
    return (first + index * _GOLDEN) % 1


def read_radius_set(place: Path) -> RadiusSet:
    """The set of a finished batch or a table.

    Raises:
        InputError: it cannot be read, or has no radii.
    """
    file = place / INDEX if place.is_dir() else place
    if place.is_dir() and not file.exists():
        remedy = f"finish that batch, or run 'defocus merge {place}'"
        raise InputError("empty", f"has no {INDEX} of a finished batch", remedy, path=place)
    rows: list[tuple[float, ...]] = []
    for where, row in read_rows(file, "table of radii", _EXAMPLE):
        if any(name in row for name in MEASURES) or file.name != INDEX:
            rows.append(_numbers(row, where))
    rows = [row for row in rows if row[-1]]
    if not rows:
        remedy = f"give a finished batch, or rows like {_EXAMPLE}"
        raise InputError("empty", "has no radii of pictures", remedy, path=file)
    return _set_of(rows)


def _numbers(row: Mapping[str, Any], where: Place) -> tuple[float, ...]:
    """Mean, median and 99th percentile of a row, and its count."""
    numbers = []
    for name in (*MEASURES, _COUNT):
        value = row.get(name, 1 if name == _COUNT else None)
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = math.nan
        if not 0 <= number < math.inf or isinstance(value, bool):
            what = f"has no {name}" if value is None else f"has the {name} {value!r:.40}"
            raise InputError(
                "malformed", f"{what}, not a number of at least 0", f"write {_EXAMPLE}", path=where
            )
        numbers.append(number)
    return tuple(numbers)


def _set_of(rows: Sequence[tuple[float, ...]]) -> RadiusSet:
    values, fractions = [], []
    total = sum(row[-1] for row in rows)
    for which in range(len(MEASURES)):
        ordered = sorted((row[which], row[-1]) for row in rows)
        ends = accumulate(count for _, count in ordered)
        values.append(tuple(value for value, _ in ordered))
        fractions.append(
            tuple((end - n / 2) / total for end, (_, n) in zip(ends, ordered, strict=True))
        )
    return RadiusSet(tuple(values), tuple(fractions))


def _interpolated(fraction: float, places: Sequence[float], values: Sequence[float]) -> float:
    """The value at a place between the places of values; beyond the ends that of the end."""
    high = bisect_left(places, fraction)
    if high in (0, len(places)):
        return values[min(high, len(places) - 1)]
    low = high - 1
    part = (fraction - places[low]) / (places[high] - places[low])
    return values[low] + part * (values[high] - values[low])

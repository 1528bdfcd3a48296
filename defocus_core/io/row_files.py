"""Files of rows: CSV with a header, or JSONL with a JSON object per line; # begins comments."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from io import TextIOWrapper
from pathlib import Path
from typing import Any, TextIO

from defocus_core.errors import InputError, Place, cannot_read, reason
from defocus_core.io.read_files import open_plain

_LONGEST_LINE = 2**20
Row = tuple[Place, Mapping[str, Any]]  # the line, for errors, and values by key
Columns = Callable[[list[str], Place], list[str]]


def read_rows(
    file: Path,
    what: str,
    example: str,
    header: str = "color,depth",
    columns: Columns = lambda cells, _: cells,
) -> Iterator[Row]:
    """Yield the place and the values of each row, without empty or null values.

    `what`: the file, in words for errors; `example`: a row of JSON to propose, empty if JSONL is
    not accepted; `header`: a header of CSV to propose; `columns`: makes the keys from the cells of
    a header and its place.
    """
    suffix, known = file.suffix.lower(), (".csv", ".jsonl") if example else (".csv",)
    if suffix not in known:
        remedy = f"name it after its type, {' or '.join(known)}"
        raise InputError("wrong-type", f"is not a {what} by its name", remedy, path=file)
    try:
        with TextIOWrapper(open_plain(file), encoding="utf-8-sig", newline="") as opened:
            if suffix == ".csv":
                yield from _csv_rows(file, opened, header, columns)
            else:
                yield from _json_rows(file, opened, example)
    except OSError as error:
        raise cannot_read(file, error, "check the path") from None
    except UnicodeDecodeError:
        raise InputError("not-utf-8", "is not UTF-8 text", "save it as UTF-8", path=file) from None


def _csv_rows(file: Path, opened: TextIO, example: str, columns: Columns) -> Iterator[Row]:
    reader = csv.reader(opened, strict=True)
    keys: list[str] = []
    try:
        for cells in reader:
            values = [cell.strip() for cell in cells]
            if not any(values) or values[0].startswith("#"):
                continue
            place = Place(file, f"line {reader.line_num}")
            if "\0" in "".join(values):
                problem, remedy = "has a zero byte, and so is not CSV", "save it as text"
                raise InputError("wrong-type", problem, remedy, path=file)
            if not keys:
                keys = columns(values, place)
                if len(keys) == 1 and ";" in keys[0]:
                    problem = "has semicolons between its cells"
                    raise InputError("malformed", problem, "write commas", path=place)
                if twice := [key for key, times in Counter(keys).items() if times > 1]:
                    problem, remedy = f"names '{twice[0]}' twice", "remove one of the columns"
                    raise InputError("duplicate", problem, remedy, path=place)
            elif len(values) != len(keys):
                problem = f"has {len(values)} cells, but the header names {len(keys)}"
                raise InputError("malformed", problem, "mend that line", path=place)
            else:
                yield place, {k: value for k, value in zip(keys, values, strict=True) if value}
    except csv.Error as error:
        problem, place = f"is not CSV: {reason(error)}", Place(file, f"line {reader.line_num}")
        raise InputError("malformed", problem, "mend that line", path=place) from None
    if not keys:
        raise InputError("empty", "is empty", f"begin it with a line like {example}", path=file)


def _json_rows(file: Path, opened: TextIO, example: str) -> Iterator[Row]:
    lines = iter(partial(opened.readline, _LONGEST_LINE), "")
    for number, text in enumerate(lines, 1):
        if not text.strip():
            continue
        place, remedy = Place(file, f"line {number}"), f"write it like {example}"
        try:
            row = json.loads(text, object_pairs_hook=_without_duplicates)
        except (ValueError, RecursionError) as error:
            problem = f"is not a row of JSON: {reason(error)}"
            raise InputError("malformed", problem, remedy, path=place) from None
        if not isinstance(row, dict):
            raise InputError("malformed", "is not a JSON object", remedy, path=place)
        yield place, {key: value for key, value in row.items() if value not in (None, "")}


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if twice := [key for key, times in Counter(key for key, _ in pairs).items() if times > 1]:
        raise ValueError(f"'{twice[0]}' stands in it twice")
    return dict(pairs)

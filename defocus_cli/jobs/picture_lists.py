"""Lists of pictures: CSV with a header line, or JSON Lines."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TextIO

from defocus_cli.system.errors import InputError, reason

LONGEST_LINE = 2**20
SUFFIXES = (".csv", ".jsonl")
Row = tuple[int, Mapping[str, Any]]


def read_rows(file: Path) -> Iterator[Row]:
    """Line number and values of each row, those that are empty or null left out.

    Raises:
        InputError: the file cannot be read, or a line is no row; the line is named.
    """
    if file.suffix.lower() not in SUFFIXES:
        remedy = f"name it after its type, {' or '.join(SUFFIXES)}"
        raise InputError(file, "is no list of pictures by its name", remedy)
    rows = _csv_rows if file.suffix.lower() == ".csv" else _json_rows
    try:
        with file.open(encoding="utf-8-sig", newline="") as opened:
            yield from rows(file, opened)
    except OSError as error:
        raise InputError(file, f"cannot be read: {reason(error)}", "check the path") from None
    except UnicodeDecodeError:
        raise InputError(file, "is not UTF-8 text", "save it as UTF-8") from None


def _csv_rows(file: Path, opened: TextIO) -> Iterator[Row]:
    reader = csv.reader(opened, strict=True)
    try:
        keys = [key.strip() for key in next(reader, [])]
        if not keys:
            raise InputError(file, "is empty", "begin it with a line like color,depth")
        if twice := [key for key in keys if keys.count(key) > 1]:
            problem = f"names '{twice[0]}' twice"
            raise InputError(line(file, 1), problem, "remove one of the columns")
        for cells in reader:
            values = [cell.strip() for cell in cells]
            if any(values) and len(values) != len(keys):
                problem = f"has {len(values)} cells, but the header names {len(keys)}"
                raise InputError(line(file, reader.line_num), problem, "mend that line")
            if any(values):
                row = zip(keys, values, strict=True)
                yield reader.line_num, {key: value for key, value in row if value}
    except csv.Error as error:
        where = line(file, reader.line_num)
        raise InputError(where, f"is not CSV: {reason(error)}", "mend that line") from None


def _json_rows(file: Path, opened: TextIO) -> Iterator[Row]:
    number = 0
    while text := opened.readline(LONGEST_LINE):
        number += 1
        if not text.strip():
            continue
        remedy = 'write it like {"color": "a.exr", "depth": "b.exr"}'
        try:
            row = json.loads(text)
        except (ValueError, RecursionError) as error:
            problem = f"is not JSON: {reason(error)}"
            raise InputError(line(file, number), problem, remedy) from None
        if not isinstance(row, dict):
            raise InputError(line(file, number), "is no JSON object", remedy)
        yield number, {key: value for key, value in row.items() if value not in (None, "")}


def line(file: Path, number: int) -> str:
    """The place of a row, for errors."""
    return f"{file}: line {number}"

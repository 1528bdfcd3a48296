"""Rows of a table in a file: CSV with a header, or JSON Lines."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from io import TextIOWrapper
from itertools import count
from pathlib import Path
from typing import Any, TextIO

from defocus_core.errors import InputError, Place, cannot_read, reason
from defocus_core.io.below import open_plain

SUFFIXES = (".csv", ".jsonl")
_LONGEST_LINE = 2**20
Row = tuple[Place, Mapping[str, Any]]  # for errors, and values


def read_rows(file: Path, what: str, example: str) -> Iterator[Row]:
    """Place and values of each row, without those that are empty or null."""
    if file.suffix.lower() not in SUFFIXES:
        remedy = f"name it after its type, {' or '.join(SUFFIXES)}"
        raise InputError("wrong-type", f"is no {what} by its name", remedy, path=file)
    try:
        with TextIOWrapper(open_plain(file), encoding="utf-8-sig", newline="") as opened:
            if file.suffix.lower() == ".csv":
                yield from _csv_rows(file, opened)
            else:
                yield from _json_rows(file, opened, example)
    except OSError as error:
        raise cannot_read(file, error, "check the path") from None
    except UnicodeDecodeError:
        raise InputError("not-utf-8", "is not UTF-8 text", "save it as UTF-8", path=file) from None


def _csv_rows(file: Path, opened: TextIO) -> Iterator[Row]:
    reader = csv.reader(opened, strict=True)
    try:
        keys = [key.strip() for key in next(filter(_says, reader), [])]
        if not keys:
            raise InputError(
                "empty", "is empty", "begin it with a line like color,depth", path=file
            )
        if twice := [key for key, times in Counter(keys).items() if times > 1]:
            problem = f"names '{twice[0]}' twice"
            remedy = "remove one of the columns"
            raise InputError("duplicate", problem, remedy, path=file, field="line 1")
        for cells in filter(_says, reader):
            values = [cell.strip() for cell in cells]
            if any(values) and len(values) != len(keys):
                problem = f"has {len(values)} cells, but the header names {len(keys)}"
                raise _malformed(file, reader.line_num, problem, "mend that line")
            if any(values):
                row = zip(keys, values, strict=True)
                filled = {key: value for key, value in row if value}
                yield Place(file, f"line {reader.line_num}"), filled
    except csv.Error as error:
        problem = f"is not CSV: {reason(error)}"
        raise _malformed(file, reader.line_num, problem, "mend that line") from None


def _says(cells: Sequence[str]) -> bool:
    """Whether a line is no comment, which begins with # and holds one cell."""
    return not (len(cells) == 1 and cells[0].lstrip().startswith("#"))


def _json_rows(file: Path, opened: TextIO, example: str) -> Iterator[Row]:
    for number in count(1):
        text = opened.readline(_LONGEST_LINE)
        if not text:
            return
        if not text.strip():
            continue
        remedy = f"write it like {example}"
        try:
            row = json.loads(text)
        except (ValueError, RecursionError) as error:
            problem = f"is not JSON: {reason(error)}"
            raise _malformed(file, number, problem, remedy) from None
        if not isinstance(row, dict):
            raise _malformed(file, number, "is no JSON object", remedy)
        yield (
            Place(file, f"line {number}"),
            {key: value for key, value in row.items() if value not in (None, "")},
        )


def _malformed(file: Path, line: int, problem: str, remedy: str) -> InputError:
    return InputError("malformed", problem, remedy, path=file, field=f"line {line}")

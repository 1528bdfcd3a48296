"""Lists of pictures: CSV with a header line or JSON Lines, and file patterns."""

from __future__ import annotations

import csv
import glob
import json
import os
import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
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
        _check_header(file, keys)
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) != len(keys):
                problem = f"has {len(cells)} cells, but the header names {len(keys)}"
                raise InputError(line(file, reader.line_num), problem, "mend that line")
            values = {key: cell.strip() for key, cell in zip(keys, cells, strict=True)}
            yield reader.line_num, {key: value for key, value in values.items() if value}
    except csv.Error as error:
        where = line(file, reader.line_num)
        raise InputError(where, f"is not CSV: {reason(error)}", "mend that line") from None


def _check_header(file: Path, keys: list[str]) -> None:
    if not keys:
        raise InputError(file, "is empty", "begin it with a line like color,depth")
    twice = next((key for key in keys if keys.count(key) > 1), None)
    if twice is not None:
        raise InputError(line(file, 1), f"names '{twice}' twice", "remove one of the columns")


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


_WILDCARD = re.compile(r"\*\*/|\*\*|\*|\?|\[[^\]]+\]")


_GROUPS = {"**/": "((?:[^/]+/)*)", "**": "(.*)", "*": "([^/]*)"}


def has_wildcard(pattern: str) -> bool:
    """Whether there is anything in it to expand."""
    return _WILDCARD.search(pattern) is not None


def matching(folder: Path, pattern: str, suffixes: frozenset[str]) -> dict[str, Path]:
    """Name to file, sorted by name.

    Args:
        folder: what the pattern is relative to.
        pattern: a path with ``*``, ``?``, ``[…]``, or ``**`` for folders at any depth.
        suffixes: the types of files to take; others are passed over.

    Raises:
        InputError: nothing matches, two files get one name, a folder cannot be looked into, or
            holds a link to itself.
    """
    pattern = os.path.normpath(pattern)  # as glob writes what it finds
    _refuse_closed(folder, pattern)
    expression = re.compile(_expression(pattern), re.S)
    found: dict[str, Path] = {}
    # Path.glob takes no absolute pattern, and the hidden files too.
    for text in glob.iglob(pattern, root_dir=folder, recursive=True):  # noqa: PTH207
        path = folder / text
        if path.suffix.lower() not in suffixes or path.is_dir():
            continue
        if "**" in pattern:
            _refuse_circle(path.parent)
        name = "_".join(_parts(expression, text)) or path.stem
        if name in found:
            problem = f"names both {found[name]} and {path} '{name}'"
            raise InputError(folder / pattern, problem, "use a narrower pattern")
        found[name] = path
    if not found:
        known = ", ".join(sorted(suffix[1:] for suffix in suffixes))
        problem = f"matches no file of type {known}"
        raise InputError(folder / pattern, problem, "check the pattern")
    return {name: found[name] for name in sorted(found)}


def _refuse_closed(folder: Path, pattern: str) -> None:
    """Refuse folders that glob would pass over without a word, for want of permission."""
    parts = Path(pattern).parts
    for depth, part in enumerate(parts):
        listed = has_wildcard(part) or parts[:depth][-1:] == ("**",)
        needed = os.R_OK | os.X_OK if listed else os.X_OK
        above = os.path.join(*parts[:depth], "")  # noqa: PTH118 - Path drops the last slash
        shown = [above]
        if has_wildcard(above):
            shown = glob.glob(above, root_dir=folder, recursive=True)  # noqa: PTH207
        for text in shown:
            path = folder / text
            if path.is_dir() and not os.access(path, needed):
                remedy = "check its permissions, or use a narrower pattern"
                raise InputError(path, "cannot be looked into", remedy)


@lru_cache(maxsize=4096)
def _refuse_circle(folder: Path) -> None:
    """Refuse a folder in which glob would find itself again and again."""
    for place in (folder, *folder.parents):
        if place.is_symlink() and place.parent.resolve().is_relative_to(place.resolve()):
            problem = "is a symbolic link to a folder that it is in"
            raise InputError(place, problem, "remove it, or use a narrower pattern")


def _parts(expression: re.Pattern[str], text: str) -> Iterator[str]:
    """What each wildcard stands for; of the file's own suffix, nothing."""
    match = expression.fullmatch(text)
    if match is None:
        return
    stop = len(text) - len(Path(text).suffix)
    for index in range(1, expression.groups + 1):
        begin, end = match.span(index)
        part = text[begin : min(end, stop)].strip("/")
        if part:
            yield part.replace("/", "_")


def _expression(pattern: str) -> str:
    """The regular expression with a group for each wildcard; what fits in it, glob has decided."""
    pieces, place = [], 0
    for found in _WILDCARD.finditer(pattern):
        pieces.append(re.escape(pattern[place : found.start()]))
        pieces.append(_GROUPS.get(found[0], "([^/])"))
        place = found.end()
    return "".join([*pieces, re.escape(pattern[place:])])

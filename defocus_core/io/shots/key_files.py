"""Files of keys: the values of lens options at frames of a shot, as texts.

A ``.csv`` has a header that names frame and options, like ``frame,focus,fnumber``; ``x,y`` is
focus-at, and an empty cell is no key. Nuke's ``.chan`` of a camera has in each line the frame,
three numbers of place, three of rotation, and the vertical field of view in degrees, which alone is
read. Any other file is a curve of one option: lines of a frame and a value, with blanks or a comma
between them.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from defocus_core.errors import InputError, UsageProblem, reason
from defocus_core.io.below import open_plain

FIELD_OF_VIEW = "vertical-fov"  # of a .chan file, which becomes a focal length
_CHAN_COLUMNS = 8
_LARGEST_FILE = 2**26  # bytes


class Key(NamedTuple):
    """The value of an option at a frame, as a text, and its place in a file for errors."""

    text: str
    where: str


Keys = Mapping[str, Mapping[int, Key]]  # by option, by frame


def read_keys(file: Path, option: str | None) -> Keys:
    """The keys of a file that is no TOML.

    Args:
        file: the file.
        option: the option that a curve is of; None for a file that names its options.

    Raises:
        InputError: the file cannot be read, or a line makes no sense; the line is named.
        UsageProblem: a curve is given without its option, or a file of columns with one.
    """
    rows = _rows(file)
    first = next(rows, None)
    if first is None:
        raise InputError("", "has no key", "write lines like 1001 1.2m", path=file)
    suffix, is_curve = file.suffix.lower(), len(first[1]) == 2 and _is_frame(first[1][0])
    if option is None and is_curve:
        remedy = f"name the option that it is of, like ‹animate› focus={file}"
        raise UsageProblem("", "is a curve of one option", remedy, path=file)
    if option is not None and not is_curve:
        remedy = f"give it without the option, ‹animate› {file}"
        raise UsageProblem("", "is no curve of lines like 1001 1.2m", remedy, path=file)
    every = [first, *rows]
    if option is not None:
        return {option: _curve(every)}
    return _chan(every, file) if suffix == ".chan" else _columns(every, file)


def frame_of(text: str, where: str) -> int:
    """The number of a frame.

    Raises:
        InputError: the text is none.
    """
    if not _is_frame(text):
        raise InputError(
            "", f"'{text}' is no frame", "begin the line with a frame, like 1001", path=where
        )
    return round(float(text))


def _is_frame(text: str) -> bool:
    try:
        return float(text) == round(float(text))
    except (ValueError, OverflowError):
        return False


def _rows(file: Path) -> Iterator[tuple[str, list[str]]]:
    """Place and cells of each line that is neither empty nor a comment."""
    try:
        with open_plain(file) as opened:
            data = opened.read(_LARGEST_FILE + 1)
        text = data.decode("utf-8-sig")
    except OSError as error:
        raise InputError(
            "", f"cannot be read: {reason(error)}", "check the path", path=file
        ) from None
    except UnicodeDecodeError:
        raise InputError("", "is not UTF-8 text", "save it as UTF-8", path=file) from None
    if "\0" in text or len(data) > _LARGEST_FILE:
        raise InputError(
            "", "is no file of keys", "give CSV, TOML, .chan or lines of a curve", path=file
        )
    lines = text.splitlines()
    if file.suffix.lower() == ".csv":
        try:
            cells = list(csv.reader(lines, strict=True))
        except csv.Error as error:
            raise InputError(
                "", f"is not CSV: {reason(error)}", "mend that line", path=file
            ) from None
    else:
        cells = [line.replace(",", " ").split() for line in lines]
    for number, row in enumerate(cells, 1):
        stripped = [cell.strip() for cell in row]
        if any(stripped) and not stripped[0].startswith("#"):
            yield f"{file}: line {number}", stripped


def _curve(rows: Sequence[tuple[str, list[str]]]) -> dict[int, Key]:
    keys: dict[int, Key] = {}
    for where, cells in rows:
        if len(cells) != 2:
            raise InputError(
                "", "is not a frame and a value", "write it like 1001 1.2m", path=where
            )
        _add(keys, frame_of(cells[0], where), Key(cells[1], where))
    return keys


def _chan(rows: Sequence[tuple[str, list[str]]], file: Path) -> Keys:
    keys: dict[int, Key] = {}
    for where, cells in rows:
        if len(cells) < _CHAN_COLUMNS:
            problem = f"has {len(cells)} numbers, and none of the lens"
            remedy = "export the camera with its vertical field of view, the eighth number"
            raise InputError("", problem, remedy, path=where)
        _add(keys, frame_of(cells[0], where), Key(cells[_CHAN_COLUMNS - 1], where))
    return {FIELD_OF_VIEW: keys}


def _columns(rows: Sequence[tuple[str, list[str]]], file: Path) -> Keys:
    (place, header), *lines = rows
    names = [name.lower().replace("_", "-").replace(" ", "-") for name in header]
    if "frame" not in names:
        remedy = "begin it with a line like frame,focus,fnumber"
        raise InputError("", "names no column frame", remedy, path=place)
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError("", f"names '{twice[0]}' twice", "remove one of the columns", path=place)
    if ("x" in names) != ("y" in names):
        raise InputError("", "names one of x and y", "give both, the pixel of focus-at", path=place)
    keys: dict[str, dict[int, Key]] = {name: {} for name in names if name not in ("frame", "y")}
    for where, cells in lines:
        if len(cells) != len(names):
            problem = f"has {len(cells)} cells, but the header names {len(names)}"
            raise InputError("", problem, "mend that line", path=where)
        row = dict(zip(names, cells, strict=True))
        frame = frame_of(row.pop("frame"), where)
        if "x" in row:
            row["x"] = f"{row['x']},{row.pop('y')}".strip(",")
        for name, text in row.items():
            if text:
                _add(keys[name], frame, Key(text, f"{where}: {name}"))
    if "x" in keys:
        keys["focus-at"] = keys.pop("x")
    return keys


def _add(keys: dict[int, Key], frame: int, key: Key) -> None:
    if frame in keys:
        problem = f"is another key of frame {frame}, like {keys[frame].where}"
        raise InputError("", problem, "remove one of them", path=key.where)
    keys[frame] = key

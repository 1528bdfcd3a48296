"""Files of keys: the values of lens options at frames of a shot, as texts.

A ``.csv`` has a header that names frame and options, like ``frame,focus,fnumber``; ``x,y`` is
focus-at, and an empty cell is no key.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from defocus_core.errors import InputError, Place
from defocus_core.io.row_files import read_rows

_HEADER = "frame,focus,fnumber"
_MAX_ROWS = 2**17 - 1  # a shot of 90 minutes


class Key(NamedTuple):
    """The value of an option at a frame, as a text, and its place for errors."""

    text: str
    where: Place


Keys = Mapping[str, Mapping[int, Key]]  # by option, by frame


def read_keys(file: Path) -> Keys:
    """The keys of a file that is no TOML."""
    if file.suffix.lower() != ".csv":
        remedy = "give CSV with a header like frame,focus,fnumber, or TOML"
        raise InputError("wrong-type", "is not a file of keys by its name", remedy, path=file)
    rows = read_rows(file, "file of keys", "", _HEADER, _columns)
    keys: dict[str, dict[int, Key]] = {}
    for number, (place, row) in enumerate(rows):
        if number == _MAX_ROWS:
            problem = f"has more than {_MAX_ROWS} keys"
            raise InputError("too-large", problem, "cut it into shots", path=file)
        frame, values = frame_of(row.get("frame", ""), place), dict(row)
        if {"x", "y"} & row.keys():
            if "focus-at" in row:
                problem, where = "stands beside x and y", place.with_field("focus-at")
                raise InputError("contradiction", problem, "leave one of them out", path=where)
            values["focus-at"] = ",".join(values.pop(name, "") for name in "xy").strip(",")
        values.pop("frame", None)
        for option, text in values.items():
            key = Key(text, place.with_field(option))
            if (other := keys.setdefault(option, {}).setdefault(frame, key)) is not key:
                problem = f"is another key of frame {frame}, like {other.where}"
                raise InputError("duplicate", problem, "remove one of them", path=key.where)
    if not keys:
        raise InputError("empty", "has no key", f"begin it with a line like {_HEADER}", path=file)
    return keys


def _columns(cells: list[str], place: Place) -> list[str]:
    """The options that the cells of a header name, x, y and frame."""
    names = [cell.lower().replace("_", "-").replace(" ", "-") for cell in cells]
    problem, remedy = "has no column named frame", f"begin it with a line like {_HEADER}"
    if ("x" in names) != ("y" in names):
        problem, remedy = "has only one of the columns x and y", "give both, the pixel of focus-at"
    elif "frame" in names or (len(names) == 1 and ";" in names[0]):
        return names
    raise InputError("malformed", problem, remedy, path=place)


def frame_of(text: str, where: Place) -> int:
    """The number of a frame."""
    with suppress(ValueError, OverflowError):
        if float(text) == round(float(text)):
            return round(float(text))
    remedy = "begin the line with a frame, like 1001"
    raise InputError("malformed", f"'{text}' is not a frame", remedy, path=where)

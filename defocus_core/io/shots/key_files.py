"""Files of keys: the values of lens options at frames of a shot, as texts.

A ``.csv`` has a header that names frame and options, like ``frame,focus,fnumber``; ``x,y`` is
focus-at, and an empty cell is no key. Nuke's ``.chan`` of a camera has in each line the frame,
three numbers of place, three of rotation, and the vertical field of view in degrees, which alone is
read.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from defocus_core.errors import InputError, Place, cannot_read, reason
from defocus_core.io.below import read_plain

FIELD_OF_VIEW = "vertical-fov"  # of a .chan file, which becomes a focal length
_SUFFIXES = (".csv", ".chan")
_CHAN_COLUMNS = 8
_MAX_LINES = 2**17  # a shot of 90 minutes


class _Line(NamedTuple):
    """The cells of a line of a file."""

    file: Path
    number: int
    cells: list[str]

    @property
    def place(self) -> Place:
        """The line, for errors."""
        return Place(self.file, f"line {self.number}")

    def frame(self, text: str) -> int:
        """The number of a frame that one of the cells says."""
        return frame_of(text, self.place)

    def malformed(self, problem: str, remedy: str) -> InputError:
        """The error for a line that makes no sense."""
        return InputError("malformed", problem, remedy, path=self.place)


class Key(NamedTuple):
    """The value of an option at a frame, as a text, and its place for errors."""

    text: str
    where: Place


Keys = Mapping[str, Mapping[int, Key]]  # by option, by frame


def read_keys(file: Path) -> Keys:
    """The keys of a file that is no TOML."""
    if file.suffix.lower() not in _SUFFIXES:
        remedy = "give CSV with a header like frame,focus,fnumber, TOML, or .chan"
        raise InputError("wrong-type", "is not a file of keys by its name", remedy, path=file)
    every = [*_rows(file)]
    if not every:
        remedy = "begin it with a line like frame,focus,fnumber"
        raise InputError("empty", "has no key", remedy, path=file)
    return _chan(every) if file.suffix.lower() == ".chan" else _columns(every)


def frame_of(text: str, where: Place) -> int:
    """The number of a frame."""
    if not _is_frame(text):
        remedy = "begin the line with a frame, like 1001"
        raise InputError("malformed", f"'{text}' is not a frame", remedy, path=where)
    return round(float(text))


def _is_frame(text: str) -> bool:
    try:
        return float(text) == round(float(text))
    except (ValueError, OverflowError):
        return False


def _rows(file: Path) -> Iterator[_Line]:
    """The lines that are neither empty nor a comment."""
    try:
        text = read_plain(file).decode("utf-8-sig")
    except OSError as error:
        raise cannot_read(file, error, "check the path") from None
    except UnicodeDecodeError:
        raise InputError("not-utf-8", "is not UTF-8 text", "save it as UTF-8", path=file) from None
    if "\0" in text:
        remedy = "give CSV, TOML or .chan"
        raise InputError("wrong-type", "is not a file of keys", remedy, path=file)
    lines = text.splitlines()
    if len(lines) > _MAX_LINES:
        problem = f"has {len(lines)} lines, more than {_MAX_LINES}"
        raise InputError("too-large", problem, "cut it into shots", path=file)
    if file.suffix.lower() == ".csv":
        try:
            cells = list(csv.reader(lines, strict=True))
        except csv.Error as error:
            problem = f"is not CSV: {reason(error)}"
            raise InputError("malformed", problem, "mend that line", path=file) from None
    else:
        cells = [line.replace(",", " ").split() for line in lines]
    for number, row in enumerate(cells, 1):
        stripped = [cell.strip() for cell in row]
        if any(stripped) and not stripped[0].startswith("#"):
            yield _Line(file, number, stripped)


def _chan(lines: Sequence[_Line]) -> Keys:
    keys: dict[int, Key] = {}
    for line in lines:
        if len(line.cells) < _CHAN_COLUMNS:
            problem = f"has {len(line.cells)} numbers, and none of the lens"
            remedy = "export the camera with its vertical field of view, the eighth number"
            raise line.malformed(problem, remedy)
        _add(keys, line, line.frame(line.cells[0]), line.cells[_CHAN_COLUMNS - 1])
    return {FIELD_OF_VIEW: keys}


def _columns(lines: Sequence[_Line]) -> Keys:
    header, *below = lines
    names = [name.lower().replace("_", "-").replace(" ", "-") for name in header.cells]
    if "frame" not in names and ";" in header.cells[0]:
        raise header.malformed("has semicolons between its cells", "write commas")
    if "frame" not in names:
        remedy = "begin it with a line like frame,focus,fnumber"
        raise header.malformed("has no column named frame", remedy)
    if twice := [name for name in names if names.count(name) > 1]:
        problem, remedy = f"names '{twice[0]}' twice", "remove one of the columns"
        raise InputError("duplicate", problem, remedy, path=header.place)
    if ("x" in names) != ("y" in names):
        raise header.malformed(
            "has only one of the columns x and y", "give both, the pixel of focus-at"
        )
    keys: dict[str, dict[int, Key]] = {name: {} for name in names if name not in ("frame", "y")}
    for line in below:
        if len(line.cells) != len(names):
            problem = f"has {len(line.cells)} cells, but the header names {len(names)}"
            raise line.malformed(problem, "mend that line")
        row = dict(zip(names, line.cells, strict=True))
        frame = line.frame(row.pop("frame"))
        if "x" in row:
            row["x"] = f"{row['x']},{row.pop('y')}".strip(",")
        for name, text in row.items():
            if text:
                _add(keys[name], line, frame, text, name)
    if "x" in keys:
        keys["focus-at"] = keys.pop("x")
    return keys


def _add(keys: dict[int, Key], line: _Line, frame: int, text: str, column: str = "") -> None:
    place = line.place.at(column)
    if frame in keys:
        problem = f"is another key of frame {frame}, like {keys[frame].where}"
        raise InputError("duplicate", problem, "remove one of them", path=place)
    keys[frame] = Key(text, place)

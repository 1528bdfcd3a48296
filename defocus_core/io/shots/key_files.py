"""Files of keys: the values of lens options at frames of a shot, as texts.

A ``.csv`` has a header that names frame and options, like ``frame,focus,fnumber``; ``x,y`` is
focus-at, and an empty cell is no key. Nuke's ``.chan`` of a camera has in each line the frame,
three numbers of place, three of rotation, and the vertical field of view in degrees, which alone is
read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from defocus_core.errors import InputError, Place, cannot_read
from defocus_core.io.below import read_plain
from defocus_core.io.row_files import Row, read_rows

FIELD_OF_VIEW = "vertical-fov"  # of a .chan file, which becomes a focal length
_HEADER = "frame,focus,fnumber"
_CHAN_COLUMNS = 8
_MAX_ROWS = 2**17 - 1  # a shot of 90 minutes


class Key(NamedTuple):
    """The value of an option at a frame, as a text, and its place for errors."""

    text: str
    where: Place


Keys = Mapping[str, Mapping[int, Key]]  # by option, by frame


def read_keys(file: Path) -> Keys:
    """The keys of a file that is no TOML."""
    suffix = file.suffix.lower()
    if suffix not in (".csv", ".chan"):
        remedy = "give CSV with a header like frame,focus,fnumber, TOML, or .chan"
        raise InputError("wrong-type", "is not a file of keys by its name", remedy, path=file)
    csv = read_rows(file, "file of keys", "", _HEADER, _columns)
    rows = _chan(file) if suffix == ".chan" else csv
    keys: dict[str, dict[int, Key]] = {}
    for number, (place, row) in enumerate(rows):
        if number == _MAX_ROWS:
            problem = f"has more than {_MAX_ROWS} keys"
            raise InputError("too-large", problem, "cut it into shots", path=file)
        frame, values = frame_of(row.get("frame", ""), place), dict(row)
        if {"x", "y"} & row.keys():
            values["focus-at"] = ",".join(values.pop(name, "") for name in "xy").strip(",")
        values.pop("frame", None)
        for option, text in values.items():
            key = Key(text, place.at(option.removeprefix(FIELD_OF_VIEW)))
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


def _chan(file: Path) -> Iterator[Row]:
    try:
        lines = read_plain(file).decode("utf-8-sig").splitlines()
    except OSError as error:
        raise cannot_read(file, error, "check the path") from None
    except UnicodeDecodeError:
        raise InputError("not-utf-8", "is not UTF-8 text", "save it as UTF-8", path=file) from None
    for number, line in enumerate(lines, 1):
        cells, place = line.replace(",", " ").split(), Place(file, f"line {number}")
        if not cells or cells[0].startswith("#"):
            continue
        if len(cells) < _CHAN_COLUMNS:
            problem = f"has {len(cells)} numbers, and none of the lens"
            remedy = "export the camera with its vertical field of view, the eighth number"
            raise InputError("malformed", problem, remedy, path=place)
        yield place, {"frame": cells[0], FIELD_OF_VIEW: cells[_CHAN_COLUMNS - 1]}

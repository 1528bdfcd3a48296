"""Animation of lens options by keyframes, called keys: values of an option at given frames.

Between two keys, a value is interpolated linearly in the variable in which the blur is smooth:
disparity for the focus distance, the logarithm for f-number, focal length and other sizes, the
value itself for angles and pixels. The value of the first key also holds before it, that of the
last key after it. Numbers without a unit are metres for a focus distance, and mm for other lengths.
A CSV file begins with a header of column names, like ``frame,focus,fnumber``. Its columns ``x`` and
``y`` together are the option focus-at; an empty cell sets no key.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from defocus_core.errors import CALLER, InputError, Place, UsageProblem
from defocus_core.io.row_files import read_rows
from defocus_core.request.job_options import ANIMATION_OPTIONS
from defocus_core.request.parameters import LENS_OPTIONS, SCALES, LensParam
from defocus_core.request.quantities import read_at, text_of
from defocus_core.request.resolver import Given, alternatives, keys_of, refuse_contradiction
from defocus_core.request.toml_file import Table, read_toml, refuse_unknown
from defocus_core.request.toml_file import table as table_of

_DIGITS = 9


@dataclass(frozen=True)
class Animation:
    """Keyframes of lens options."""

    keys: Mapping[str, Mapping[int, Given]]  # keys by option, then by frame, ascending

    @property
    def places(self) -> dict[str, str]:
        """The place of the first keyframe of each animated option, as text, by option name.

        An alternative option, like focus-at beside focus, has the same place.
        """
        return {
            same: str(_first(keys).place)
            for name, keys in self.keys.items()
            for same in alternatives(name)
        }

    def options_at(self, frame: int) -> dict[str, Given]:
        """The value of each animated option at a frame, interpolated between its keyframes."""
        return {
            name: _value_at(LENS_OPTIONS[name], keys, frame) for name, keys in self.keys.items()
        }


def _value_at(row: LensParam, keys: Mapping[int, Given], frame: int) -> Given:
    frames = [*keys]
    after = bisect_right(frames, frame)
    is_between = 0 < after < len(frames) and frames[after - 1] != frame
    start = keys[frames[max(after - 1, 0)]]
    if not (is_between and row.even_in) or start.value == keys[frames[after]].value:
        return start
    first, last = frames[after - 1], frames[after]
    end = keys[last].value
    if not all(isinstance(value, int | float | tuple) for value in (start.value, end)):
        problem = f"is {start.text}, whose value cannot be interpolated"
        raise UsageProblem("idle-option", problem, f"give it like {row.example}", path=start.place)
    fraction = (frame - first) / (last - first)
    text = row.text(_interpolated(row, start.value, end, fraction), _DIGITS)
    return Given(row.parse(text), text, start.place)


def _interpolated(row: LensParam, first: Any, last: Any, fraction: float) -> Any:
    """Interpolate between two numbers, or between two tuples element by element.

    `fraction` is 0 at `first` and 1 at `last`; `row` gives the scale in which to interpolate.
    """
    if isinstance(first, tuple):
        pairs = zip(first, last, strict=True)
        return type(first)(_interpolated(row, *pair, fraction) for pair in pairs)
    to, back = SCALES[row.even_in]
    value = back((1 - fraction) * to(first) + fraction * to(last))
    return round(value) if isinstance(first, int) else value


def read_animation(files: Iterable[str], table: Table | None = None) -> Animation | None:
    """Read the keyframes in `files`; or those in the table ``[animate]`` and the files it names.

    The result is None if there are none. Files are CSV or TOML.
    """
    root, every = Path(), dict[str, dict[int, Given]]()
    if table is not None:
        root, files, every = table.file.parent, table.texts("file"), _collected(_of_table(table))
    for text in files:
        file, (option, is_curve, _) = root / text, text.partition("=")
        if is_curve and not file.exists():
            remedy = f"give CSV, with the header frame,{option} above its lines"
            where = CALLER.with_field("animate") if table is None else table.place("file")
            raise UsageProblem("malformed", f"'{text}' is not a file of keys", remedy, path=where)
        keys = read_keys(file)
        for twice in keys.keys() & every.keys():
            problem = f"animates {twice}, as does {_first(every[twice]).place}"
            raise UsageProblem("contradiction", problem, "remove one of them", path=file)
        every |= keys
    if not every:
        return None
    refuse_contradiction({name: _first(keys) for name, keys in every.items()})
    return Animation(every)


def _first(keys: Mapping[int, Given]) -> Given:
    return next(iter(keys.values()))


_Key = tuple[str, int, str, Place]  # option, frame, text and place
_HEADER = "frame,focus,fnumber"
_MAX_ROWS = 2**17 - 1  # a shot of 90 minutes
_REMEDY = 'write [animate] and focus = {1001 = "1.2m", 1060 = "4m"}'


def _collected(keys: Iterable[_Key]) -> dict[str, dict[int, Given]]:
    """Group keyframes by option and sort them by frame: ``{option: {frame: value}}``.

    Numbers without a unit get the default unit of their option.
    """
    every: dict[str, dict[int, Given]] = {}
    for name, frame, text, where in keys:
        refuse_unknown([name], tuple(LENS_OPTIONS), where, "a lens", "option")
        row, same = LENS_OPTIONS[name], every.setdefault(name, {})
        if frame in same:
            problem = f"is another key of frame {frame}, like {same[frame].place}"
            raise InputError("duplicate", problem, "remove one of them", path=where)
        text = row.with_unit(text)
        same[frame] = Given(read_at(where, row.parse, text), text, where)
    return {name: dict(sorted(same.items())) for name, same in every.items()}


def read_keys(file: Path) -> dict[str, dict[int, Given]]:
    """Read the keyframes of a CSV or TOML file: ``{option: {frame: value}}``, sorted by frame."""
    if file.suffix.lower() == ".toml":
        tables = read_toml(file, what="file of keys", remedy=_REMEDY)
        refuse_unknown(tables, ("animate",), file, "a file of keys", "table")
        if not tables:
            raise InputError("empty", "has no table [animate]", _REMEDY, path=file)
        return _collected(_of_table(table_of(file, tables, "animate")))
    if file.suffix.lower() != ".csv":
        remedy = "give CSV with a header like frame,focus,fnumber, or TOML"
        raise InputError("wrong-type", "is not a file of keys by its name", remedy, path=file)
    if keys := _collected(_of_csv(file)):
        return keys
    raise InputError("empty", "has no key", f"begin it with a line like {_HEADER}", path=file)


def _of_table(table: Table) -> Iterator[_Key]:
    """The keyframes in the table ``[animate]``, where an option has a table of values by frame."""
    table.refuse_unknown((*LENS_OPTIONS, *keys_of(ANIMATION_OPTIONS)))
    for name, frames in table.values.items():
        if name in keys_of(ANIMATION_OPTIONS):
            continue
        if not isinstance(frames, dict) or not frames:
            remedy = f'write {name} = {{1001 = "1.2m", 1060 = "4m"}}'
            problem = f"{frames!r:.40} is not a table of frames"
            raise UsageProblem("malformed", problem, remedy, path=table.place(name))
        for text, value in frames.items():
            frame = _frame_of(text, table.place(name))
            yield name, frame, text_of(value), table.place(f"{name}: {text}")


def _of_csv(file: Path) -> Iterator[_Key]:
    for number, (place, row) in enumerate(read_rows(file, "file of keys", "", _HEADER, _columns)):
        if number == _MAX_ROWS:
            problem = f"has more than {_MAX_ROWS} keys"
            raise InputError("too-large", problem, "cut it into shots", path=file)
        values = dict(row)
        frame = _frame_of(values.pop("frame", ""), place)
        if {"x", "y"} & values.keys():
            if "focus-at" in values:
                problem, where = "contradicts the columns x and y", place.with_field("focus-at")
                raise InputError("contradiction", problem, "leave one of them out", path=where)
            values["focus-at"] = ",".join(values.pop(name, "") for name in "xy").strip(",")
        for name, text in values.items():
            yield name, frame, text, place.with_field(name)


def _columns(cells: list[str], place: Place) -> list[str]:
    """The column names of a CSV header; refuses it without ``frame``, or with x or y alone."""
    names = [cell.lower().replace("_", "-").replace(" ", "-") for cell in cells]
    problem, remedy = "has no column named frame", f"begin it with a line like {_HEADER}"
    if ("x" in names) != ("y" in names):
        problem, remedy = "has only one of the columns x and y", "give both, the pixel of focus-at"
    elif "frame" in names or (len(names) == 1 and ";" in names[0]):
        return names
    raise InputError("malformed", problem, remedy, path=place)


def _frame_of(text: str, where: Place) -> int:
    """Parse a frame number; ``where`` is the place to name in the error."""
    with suppress(ValueError, OverflowError):
        if float(text) == round(float(text)):
            return round(float(text))
    remedy = "begin the line with a frame, like 1001"
    raise InputError("malformed", f"'{text}' is not a frame", remedy, path=where)

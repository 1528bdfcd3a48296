"""Keys: options of a lens by frame, and their interpolation between frames.

Interpolation is linear in the variable in which the blur is smooth: disparity for the focus, the
logarithm for f-number, focal length and other sizes, the value itself for angles and pixels. The
first key holds before it, the last one after it. Numbers without a unit are metres for a focus, and
mm for other lengths.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from defocus_core.errors import CALLER, InputError, UsageProblem
from defocus_core.io.shots.key_files import Key, frame_of, read_keys
from defocus_core.request.job_options import ANIMATION_OPTIONS
from defocus_core.request.parameters import LENS_OPTIONS, SCALES, LensParam
from defocus_core.request.quantities import read_at, text_of
from defocus_core.request.resolver import Given, alternatives, keys_of, refuse_contradiction
from defocus_core.request.toml_file import Table, read_toml, refuse_unknown
from defocus_core.request.toml_file import table as table_of

_DIGITS = 9


@dataclass(frozen=True)
class Animation:
    """Options of a lens with keys."""

    keys: Mapping[str, Mapping[int, Given]]  # keys by option, then by frame, ascending

    @property
    def places(self) -> dict[str, str]:
        """The animated options and their alternatives, with their places."""
        return {
            same: str(_first(keys).place)
            for name, keys in self.keys.items()
            for same in alternatives(name)
        }

    def options_at(self, frame: int) -> dict[str, Given]:
        """The options of a frame, exact at a key."""
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
    """The value interpolated between two numbers, or of each of several."""
    if isinstance(first, tuple):
        pairs = zip(first, last, strict=True)
        return type(first)(_interpolated(row, *pair, fraction) for pair in pairs)
    to, back = SCALES[row.even_in]
    value = back((1 - fraction) * to(first) + fraction * to(last))
    return round(value) if isinstance(first, int) else value


def read_animation(files: Iterable[str], table: Table | None = None) -> Animation | None:
    """The animation of files and of ``[animate]``; None without keys."""
    root, every = Path(), dict[str, Mapping[int, Key]]()
    if table is not None:
        root, files = table.file.parent, table.texts("file")
        every = _keys_of(table)
    for text in files:
        file, (option, is_curve, _) = root / text, text.partition("=")
        if is_curve and not file.exists():
            remedy = f"give CSV, with the header frame,{option} above its lines"
            where = CALLER.with_field("animate") if table is None else table.place("file")
            raise UsageProblem("malformed", f"'{text}' is not a file of keys", remedy, path=where)
        is_toml = file.suffix.lower() == ".toml"
        keys = _keys_of(_animate_of(file)) if is_toml else read_keys(file)
        for twice in keys.keys() & every.keys():
            problem = f"animates {twice}, as does {_first(every[twice]).where}"
            raise UsageProblem("contradiction", problem, "remove one of them", path=file)
        every |= keys
    checked = {name: _checked(name, keys) for name, keys in every.items() if keys}
    if not checked:
        return None
    refuse_contradiction({name: _first(keys) for name, keys in checked.items()})
    return Animation(checked)


_K = TypeVar("_K")


def _first(keys: Mapping[int, _K]) -> _K:
    return next(iter(keys.values()))


def _checked(name: str, keys: Mapping[int, Key]) -> dict[int, Given]:
    """The keys of an option by frame, with units added to plain numbers."""
    refuse_unknown([name], tuple(LENS_OPTIONS), _first(keys).where, "a lens", "option")
    row, made = LENS_OPTIONS[name], {}
    for frame, key in sorted(keys.items()):
        text = row.with_unit(key.text)
        made[frame] = Given(read_at(key.where, row.parse, text), text, key.where)
    return made


_REMEDY = 'write [animate] and focus = {1001 = "1.2m", 1060 = "4m"}'


def _animate_of(file: Path) -> Table:
    tables = read_toml(file, what="file of keys", remedy=_REMEDY)
    refuse_unknown(tables, ("animate",), file, "a file of keys", "table")
    if not tables:
        raise InputError("empty", "has no table [animate]", _REMEDY, path=file)
    return table_of(file, tables, "animate")


def _keys_of(table: Table) -> dict[str, Mapping[int, Key]]:
    """The keys of ``[animate]``: for each option a table of values by frame."""
    every: dict[str, Mapping[int, Key]] = {}
    for name, frames in table.values.items():
        if name in keys_of(ANIMATION_OPTIONS):
            continue
        if not isinstance(frames, dict) or not frames:
            remedy = f'write {name} = {{1001 = "1.2m", 1060 = "4m"}}'
            problem = f"{frames!r:.40} is not a table of frames"
            raise UsageProblem("malformed", problem, remedy, path=table.place(name))
        keys: dict[int, Key] = {}
        for text, value in frames.items():
            key = Key(text_of(value), table.place(f"{name}: {text}"))
            if keys.setdefault(frame := frame_of(text, table.place(name)), key) is not key:
                problem = f"is another key of frame {frame}"
                raise UsageProblem("duplicate", problem, "remove one of them", path=key.where)
        every[name] = keys
    return every

"""Animated lenses: options of a lens with keys at frames, and their values between the keys.

Between two keys a value goes evenly in the variable in which the blur is smooth: the focus in
disparity, f-number, focal length and other sizes in their logarithm (an f-number in stops), angles
and pixels as they are. ``ease`` begins and ends softly at each key. Before the first key and after
the last one its value holds. Of numbers without a unit a focus is in metres, other lengths in mm.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from defocus_core.batch.jobs.lens_from_options import refuse_contradiction
from defocus_core.batch.jobs.reading_options import field_of_view
from defocus_core.batch.jobs.toml_file import read_toml, refuse_unknown
from defocus_core.batch.lenses.parameters import LENS_OPTIONS, SCALES, LensParam
from defocus_core.batch.lenses.quantities import read_at, text_of
from defocus_core.errors import CALLER, InputError, Place, UsageProblem
from defocus_core.io.shots.key_files import FIELD_OF_VIEW, Key, Keys, frame_of, read_keys

INTERPOLATIONS = ("linear", "ease")
_FIELD_OF_VIEW = LensParam(
    name=FIELD_OF_VIEW,
    parse=field_of_view,
    help="Vertical field of view in degrees, of which a focal length is made.",
    tag="fov",
    example="40",
    even_in="log",
)
_ANIMATED = {**LENS_OPTIONS, FIELD_OF_VIEW: _FIELD_OF_VIEW}
_DIGITS = 9


@dataclass(frozen=True)
class Animation:
    """Options of a lens with keys."""

    # By option the frames that have a key, ascending, and the keys
    keys: Keys = field(default_factory=dict)
    interpolation: str = "linear"

    @property
    def frames(self) -> tuple[int, ...]:
        """The frames that have a key, ascending."""
        return tuple(sorted({frame for keys in self.keys.values() for frame in keys}))

    def source(self, name: str) -> Place:
        """The place of the first key of an option, for errors."""
        return next(iter(self.keys[name].values())).where

    def texts(self, frame: int) -> dict[str, str]:
        """The options of a frame as texts; at a key, the text of the key."""
        return {name: self._text(name, frame) for name in self.keys}

    def _text(self, name: str, frame: int) -> str:
        keys, row = self.keys[name], _ANIMATED[name]
        frames = [*keys]
        after = bisect_right(frames, frame)
        is_between = 0 < after < len(frames) and frames[after - 1] != frame
        if not (is_between and row.even_in):
            return keys[frames[max(after - 1, 0)]].text
        first, last = frames[after - 1], frames[after]
        fraction = (frame - first) / (last - first)
        if self.interpolation == "ease":
            fraction = fraction * fraction * (3 - 2 * fraction)
        start, end = (row.parse(keys[each].text) for each in (first, last))
        if start == end:
            return keys[first].text
        if not all(isinstance(value, int | float | tuple) for value in (start, end)):
            problem = f"is {keys[first].text}, which has nothing between it and another key"
            raise UsageProblem(
                "idle-option", problem, f"give it like {row.example}", path=keys[first].where
            )
        return row.text(_between(row, start, end, fraction), _DIGITS)


def _between(row: LensParam, first: Any, last: Any, fraction: float) -> Any:
    """The value between two numbers, or of each of several."""
    if isinstance(first, tuple):
        return tuple(_between(row, *pair, fraction) for pair in zip(first, last, strict=True))
    to, back = SCALES[row.even_in]
    value = back((1 - fraction) * to(first) + fraction * to(last))
    return round(value) if isinstance(first, int) else value


def read_animation(
    files: Iterable[str], interpolation: str | None, keys: Keys | None = None, root: Path = Path()
) -> Animation:
    """The animation of files, or ``option=FILE`` for a curve.

    `interpolation`: linear or ease; None for that of a TOML file, or linear.
    """
    every: dict[str, Mapping[int, Key]] = dict(keys or {})
    for text in files:
        option, _, name = text.rpartition("=") if not (root / text).exists() else ("", "", text)
        if option:
            refuse_unknown([option], tuple(LENS_OPTIONS), CALLER.at("animate"), "a lens", "option")
        file = root / name
        if file.suffix.lower() == ".toml" and not option:
            of_file, interpolation = _of_toml(file, interpolation)
        else:
            of_file = read_keys(file, option or None)
        _add(every, of_file, file)
    return animation_of(every, interpolation)


def animation_of(keys: Keys, interpolation: str | None) -> Animation:
    """The animation of keys, once all of them make sense."""
    every = {}
    for name, of_option in keys.items():
        if not of_option:
            continue
        where = next(iter(of_option.values())).where
        refuse_unknown([name], tuple(_ANIMATED), where, "a lens", "option")
        every[name] = {
            frame: Key(_check(name, key), key.where) for frame, key in sorted(of_option.items())
        }
    if every:
        refuse_contradiction(every, next(iter(next(iter(every.values())).values())).where)
    return Animation(every, interpolation or INTERPOLATIONS[0])


def keys_of_table(values: Mapping[str, Any], where: Place) -> dict[str, dict[int, Key]]:
    """The keys of the table ``[animate]``: of each option a table of values by frame."""
    keys: dict[str, dict[int, Key]] = {}
    for name, table in values.items():
        if not isinstance(table, dict) or not table:
            remedy = f'write {name} = {{1001 = "1.2m", 1060 = "4m"}}'
            raise UsageProblem(
                "malformed", f"{table!r:.40} is no table of frames", remedy, path=where.at(name)
            )
        refuse_unknown([name], tuple(LENS_OPTIONS), where, "a lens", "option")
        keys[name] = {
            frame_of(frame, where.at(name)): Key(text_of(value), where.at(f"{name}: {frame}"))
            for frame, value in table.items()
        }
    return keys


def _of_toml(file: Path, interpolation: str | None) -> tuple[Keys, str | None]:
    """The keys of a TOML file, and the interpolation unless the command line says one."""
    remedy = 'write [animate] and focus = {1001 = "1.2m", 1060 = "4m"}'
    tables = read_toml(file, what="file of keys", remedy=remedy)
    refuse_unknown(tables, ("animate",), file, "a file of keys", "table")
    values = tables.get("animate")
    if not isinstance(values, dict):
        raise InputError("empty", "has no table [animate]", remedy, path=file)
    where = Place(file, "[animate]")
    values, said = interpolation_of(values, where)
    return keys_of_table(values, where), interpolation or said


def interpolation_of(values: Mapping[str, Any], where: Place) -> tuple[dict[str, Any], str | None]:
    """The table ``[animate]`` without its interpolation, and the interpolation."""
    said = values.get("interpolation")
    if said is not None and said not in INTERPOLATIONS:
        remedy = f"choose from {', '.join(INTERPOLATIONS)}"
        raise UsageProblem(
            "unknown-name", f"'{said}' is not known", remedy, path=where.at("interpolation")
        )
    return {name: value for name, value in values.items() if name != "interpolation"}, said


def _add(every: dict[str, Mapping[int, Key]], keys: Keys, file: Path) -> None:
    for name, of_option in keys.items():
        if name in every:
            where = next(iter(every[name].values())).where
            raise UsageProblem(
                "contradiction",
                f"animates {name}, as does {where}",
                "remove one of them",
                path=file,
            )
        every[name] = of_option


def _check(name: str, key: Key) -> str:
    """The text of a key with the unit that a bare number has."""
    row = _ANIMATED[name]
    text = row.with_unit(key.text)
    read_at(key.where, row.parse, text)
    return text

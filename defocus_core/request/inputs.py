"""Pictures of a jobs file: from paths, patterns, lists and tables, with lens options of their own.

``[inputs]`` knows
  color, depth                files, folders, or patterns like ``frames/*.exr``; without depth, each
                              colour EXR holds its own; ``shot.####.exr`` numbers frames
  frames, missing             of such a shot the frames wanted, and what to do without a file
  hidden-color, hidden-depth  what lies behind, in the same form
  over-color, over-depth      the plate that elements lie over, in the same form
  holdout-color               deep pictures that hide what is behind them, in the same form
  matte                       the coverage of the subject of each picture, in the same form
  list                        CSV or JSONL files with a row for each picture
  pictures                    such rows in the jobs file itself: ``[[inputs.pictures]]``

A row has ``color`` and, if need be, ``depth``, those of hidden and over, ``stem`` (what
its outputs are named) and any option of a lens. Paths are relative to the file they stand in.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

from defocus_core.errors import InputError, Place, UsageProblem
from defocus_core.io.row_files import Row, read_rows
from defocus_core.io.shots.frame_patterns import FrameChoice, frame_choice
from defocus_core.request.job import OTHERS, Picture
from defocus_core.request.job_options import INPUT_OPTIONS
from defocus_core.request.pairing import SCENE_SUFFIXES, find
from defocus_core.request.parameters import LENS_OPTIONS
from defocus_core.request.resolver import Layer, keys_of, layer_of
from defocus_core.request.toml_file import Table, refuse_unknown
from defocus_core.system.memory import without_collections

# The options that name files, by their keys.
_FILES = {key: row.name for key, row in keys_of(INPUT_OPTIONS).items() if row.is_path}
_KNOWN = (*LENS_OPTIONS, *_FILES, "stem")
_KNOWN_SET = frozenset(_KNOWN)
_TRIED = 100  # first rows of which one file at least must exist
_EXAMPLE = '{"color": "a.exr", "depth": "b.exr"}'


@dataclass(frozen=True, slots=True)
class Entry:
    """A picture, its place in a file for errors, and its own lens options."""

    picture: Picture
    where: Place
    options: Layer = field(default_factory=dict)


def read_inputs(table: Table, keyed: tuple[int, ...] = ()) -> tuple[list[Entry], list[Entry]]:
    """The pictures of ``[inputs]`` in the order of the file, and all frames of its shot, if any.

    `table`: ``[inputs]``, whose patterns give pictures by name.
    """
    table.refuse_unknown(tuple(keys_of(INPUT_OPTIONS)))
    entries, shot = _from_files(table, keyed)
    for name in table.texts("list"):
        file = table.file.parent / name
        entries += _from_rows(read_rows(file, "list of pictures", _EXAMPLE), file)
    entries += _from_tables(table)
    if not entries:
        remedy = 'write color = "frames/*.exr" and depth = "depth/*.exr" below [inputs]'
        raise UsageProblem("empty", "names no picture", remedy, path=table.file, field="[inputs]")
    named: dict[str, Entry] = {}
    for entry in entries:
        stem = entry.picture.stem
        first = named.setdefault(stem, entry)
        if first is not entry:
            problem = f"has the same name as that of {first.where}, '{stem}'"
            raise UsageProblem("duplicate", problem, "give it a stem of its own", path=entry.where)
    return entries, shot


def _others(paths: Mapping[str, Path], where: Place) -> dict[str, tuple[Path, Path | None]]:
    """Colour and depth of what belongs to each picture, by role."""
    for role in OTHERS:
        if f"{role}-depth" in paths and role not in paths:
            problem = f"stands without {INPUT_OPTIONS[role].key}"
            path = where.at(f"{role}-depth")
            raise UsageProblem("missing-option", problem, "add that", path=path)
    return {role: (paths[role], paths.get(f"{role}-depth")) for role in OTHERS if role in paths}


def choice_of(options: Layer, at: Callable[[str], Place], keyed: tuple[int, ...]) -> FrameChoice:
    """The frames that options ask for; ``at``: the place of an option, ``keyed``: with a key."""
    frames, missing = (
        options[name].text if name in options else None for name in ("frames", "missing")
    )
    return frame_choice(frames, missing, (at("frames"), at("missing")), keyed)


def _from_files(table: Table, keyed: tuple[int, ...]) -> tuple[list[Entry], list[Entry]]:
    values = {key: value for key, value in table.values.items() if key not in ("list", "pictures")}
    options = layer_of(values, INPUT_OPTIONS, table.place)
    paths = {name: Path(each.text) for name, each in options.items() if INPUT_OPTIONS[name].is_path}
    if "color" not in paths:
        if options:
            place = next(iter(options.values())).place
            raise UsageProblem("missing-option", "stands without color", "add color", path=place)
        return [], []
    found = find(
        paths["color"],
        paths.get("depth"),
        _others(paths, table.place()),
        patterns_in=table.file.parent,
        frames=choice_of(options, table.place, keyed),
    )
    pictures, shot = ([Entry(picture, table.place()) for picture in each] for each in found)
    return pictures, shot


def _from_tables(table: Table) -> list[Entry]:
    tables = table.values.get("pictures", [])
    if not isinstance(tables, list) or not all(isinstance(row, dict) for row in tables):
        remedy = "write [[inputs.pictures]] above each picture's color and depth"
        raise UsageProblem(
            "malformed", "is not a list of tables", remedy, path=table.place("pictures")
        )
    if not tables:
        return []
    places = (Place(table.file, f"[[inputs.pictures]] {number}") for number in count(1))
    return _from_rows(zip(places, tables, strict=False), table.file)


def _from_rows(rows: Iterable[Row], file: Path) -> list[Entry]:
    """The pictures of rows; a missing file fails in its own job, unless all of them are missing."""
    with without_collections():
        entries = [_entry(row, where, file) for where, row in rows]
    if not entries:
        raise InputError("empty", "has no row", "write one for each picture", path=file)
    if not any(entry.picture.color.exists() for entry in entries[:_TRIED]):
        first = entries[0]
        remedy = f"paths are relative to {file.parent}, the folder of {file.name}"
        raise InputError(
            "not-found", f"{first.picture.color}: no such file", remedy, path=first.where
        )
    return entries


def _entry(row: Mapping[str, Any], where: Place, file: Path) -> Entry:
    if not _KNOWN_SET.issuperset(row):
        refuse_unknown(row, _KNOWN, where, "a row")
    options = layer_of(row, LENS_OPTIONS, where.at)
    paths = {
        name: file.parent / _path(row[key], where, key)
        for key, name in _FILES.items()
        if key in row
    }
    if "color" not in paths:
        raise InputError("empty", "has no color", "give it the path of a colour file", path=where)
    color = paths["color"]
    if "depth" not in paths and color.suffix.lower() not in SCENE_SUFFIXES:
        raise InputError(
            "empty",
            "has no depth, and its color is not an EXR that holds both",
            "give depth",
            path=where,
        )
    others: dict[str, Any] = {
        role: Picture(other.stem, other, depth or other)
        for role, (other, depth) in _others(paths, where).items()
    }
    stem = _stem(row["stem"], where) if "stem" in row else color.stem
    return Entry(Picture(stem, color, paths.get("depth", color), **others), where, options)


def _path(value: object, where: Place, key: str) -> str:
    if not isinstance(value, str) or not value or "\0" in value:
        problem, remedy = f"{value!r} is not a path", "write it in quotes"
        raise InputError("malformed", problem, remedy, path=where.at(key))
    return value


def _stem(value: object, where: Place) -> str:
    stem = str(value)
    odd = not stem or "/" in stem or "\0" in stem or stem.startswith(".") or not stem.isprintable()
    if odd or not isinstance(value, str | int):
        remedy = "it becomes OUT/<kind>/<stem>.<ext>, so write a plain name"
        raise InputError(
            "malformed", f"{value!r} cannot name a file", remedy, path=where, field="stem"
        )
    return stem

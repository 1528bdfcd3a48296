"""Jobs files: TOML files that list the pictures of a batch, the lenses for each, and the outputs.

`defocus help batch` describes the tables and keys. A jobs file contains everything that decides the
content of the outputs, but neither the output folder nor the machine to compute on. Its paths are
relative to its own folder.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import count, filterfalse
from pathlib import Path
from typing import Any, NamedTuple

from defocus_core.errors import InputError, Place, UsageProblem
from defocus_core.io.row_files import Row, read_rows
from defocus_core.request.animation import Animation, read_animation
from defocus_core.request.job import Job, Machine, Outputs, PictureFiles, Reading, is_label
from defocus_core.request.job_options import (
    INPUT_OPTIONS,
    MACHINE_OPTIONS,
    OUTPUT_OPTIONS,
    READING_OPTIONS,
    SHOT_OPTIONS,
)
from defocus_core.request.lens import LensValues
from defocus_core.request.lens_files import lens_path, read_lens_file
from defocus_core.request.origin import JobsSource, read_origin
from defocus_core.request.pairing import SCENE_SUFFIXES, choice_of, find, others_of
from defocus_core.request.parameters import LENS_OPTIONS, METADATA
from defocus_core.request.picture_lenses import PictureLenses
from defocus_core.request.resolver import (
    OPTIONS,
    Layer,
    fields_of,
    keys_of,
    layer_in,
    layer_of,
    outputs_of,
    reading_of,
)
from defocus_core.request.shots import with_shot
from defocus_core.request.splits import read_splits
from defocus_core.request.sweeps import read_sampling, read_sweep
from defocus_core.request.toml_file import Table, parsed_toml, read_bytes, refuse_unknown, table
from defocus_core.system.memory import without_collections

TABLES = (
    *("inputs", "split", "lens", "animate", "shot", "sweep", "sample"),
    *("reading", "outputs", "machine", "dataset"),
)
MAX_JOBS = 10_000_000
# Options of a single picture, and their table and key in jobs files.
KEYS = {
    **{
        row.name: f"[{table}] {key}"
        for table, rows in OPTIONS.items()
        for key, row in keys_of(rows).items()
    },
    **{METADATA: f"[lens] {METADATA}", "lens": "[lens] file"},
}


class Batch(NamedTuple):
    """The jobs of a batch, and the jobs file or tables that they come from."""

    jobs: list[Job]
    source: JobsSource


def read_batch(
    asked: Path | Mapping[str, Any],
    outputs: Outputs,
    machine: Machine,
    part: tuple[int, int] | None = None,
) -> Batch:
    """Read the jobs of a batch from a jobs file, or from the same tables as a mapping.

    Jobs of the same picture are consecutive.

    Args:
        asked: The path of a jobs file, or its tables.
        outputs: Defaults for ``[outputs]``.
        machine: Defaults for ``[machine]``.
        part: (k, n) to return only shard k of n, k from 1: every n-th picture with all its lenses;
            if there are fewer than n pictures, every n-th job.
    """
    if isinstance(asked, Mapping):
        path, stored = Path("jobs"), asked
        source = JobsSource(None, json.dumps(stored, indent=1, default=str).encode() + b"\n")
    else:
        what, remedy = "jobs file", "give a jobs file, with tables [inputs] and [lens]"
        path, source = asked, JobsSource(asked, read_bytes(asked, what, remedy))
        stored = parsed_toml(source.data, path, what=what, remedy=remedy)
    refuse_unknown(stored, TABLES, path, "a jobs file", "table")
    tables = {name: table(path, stored, name) for name in TABLES}
    read_origin(tables["dataset"])
    file = _lens_file(tables["lens"])
    reading = reading_of(
        read_lens_file(file, READING_OPTIONS), layer_in(tables["reading"], READING_OPTIONS)
    )
    animation = read_animation((), tables["animate"])
    lenses = _lenses(tables["lens"], tables["sweep"], tables["sample"], animation, reading)
    outputs = outputs_of(layer_in(tables["outputs"], OUTPUT_OPTIONS), outputs)
    quality = fields_of(layer_in(tables["machine"], MACHINE_OPTIONS))
    entries, shot = read_inputs(tables["inputs"])
    outputs = replace(outputs, labels=tuple(tables["inputs"].values.get("carry", ())))
    if (count := len(entries) * lenses.count) > MAX_JOBS:
        problem, remedy = f"asks for {count} pictures", f"split it into files of at most {MAX_JOBS}"
        raise UsageProblem("out-of-range", problem, remedy, path=path)
    machine = replace(machine, **quality)
    splits = read_splits(tables["split"], [entry.picture for entry in entries])
    first, of = (0, 1) if part is None else (part[0] - 1, part[1])
    own, each = slice(first, None, of), [range(lenses.count)] * len(entries)
    if len(entries) < of:  # a single scene with many lenses is divided, too
        begins = (n * lenses.count for n in range(len(entries)))
        own, each = slice(None), [range((first - at) % of, lenses.count, of) for at in begins]
    jobs = [
        Job(entry.picture, lens, reading, outputs, machine, suffix, split=split)
        for entry, split, numbers in zip(entries[own], splits[own], each, strict=False)
        for suffix, lens in lenses.lenses(entry.picture, numbers, entry.options)
    ]

    @cache
    def lens_of(picture: PictureFiles, suffix: str) -> LensValues:
        return next(lenses.lenses(picture, [lenses.suffixes.index(suffix)]))[1]

    decisions = layer_in(tables["shot"], SHOT_OPTIONS)
    every = [each.picture for each in shot]
    return Batch(with_shot(jobs, every, lens_of, decisions, moving=lenses.moves_focus), source)


def _lenses(
    lens: Table, sweep: Table, sample: Table, animation: Animation | None, reading: Reading
) -> PictureLenses:
    """The lenses defined by ``[lens]``, ``[sweep]``, ``[sample]`` and ``[animate]``."""
    lens.refuse_unknown((*LENS_OPTIONS, "file", METADATA))
    return PictureLenses(
        own=layer_of(lens.values, LENS_OPTIONS, lens.place),
        where=lens.place(),
        file=_lens_file(lens),
        file_key="file",
        reading=reading,
        animation=animation,
        metadata=lens.flag(METADATA) or False,
        points=read_sweep(sweep),
        sampling=read_sampling(sample),
    )


def _lens_file(lens: Table) -> Path | None:
    """The path of the lens file that ``[lens]`` names, if any.

    A path is relative to the jobs file; a name like ``@portrait-85`` is a lens of this package.
    """
    name = lens.text("file")
    return None if name is None else lens.file.parent / lens_path(Path(name), lens.place("file"))


# The options that name files, by their keys.
_FILES = {key: row.name for key, row in keys_of(INPUT_OPTIONS).items() if row.is_path}
_KNOWN = (*LENS_OPTIONS, *_FILES, "stem")
_KNOWN_SET = frozenset(_KNOWN)
_TRIED = 100  # first rows, at least one of whose files must exist
_EXAMPLE = '{"color": "a.exr", "depth": "b.exr"}'


@dataclass(frozen=True, slots=True)
class Entry:
    """A picture with its own lens options, and its place in the jobs file or list, for errors."""

    picture: PictureFiles
    where: Place
    options: Layer = field(default_factory=dict)


def read_inputs(table: Table) -> tuple[list[Entry], list[Entry]]:
    """The pictures of ``[inputs]``; and all frames of its frame pattern, empty without one."""
    table.refuse_unknown((*keys_of(INPUT_OPTIONS), "carry"))
    entries, shot = _from_files(table)
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


def _from_files(table: Table) -> tuple[list[Entry], list[Entry]]:
    apart = ("list", "pictures", "carry")
    values = {key: value for key, value in table.values.items() if key not in apart}
    carried = _carried(table)
    options = layer_of(values, keys_of(INPUT_OPTIONS), table.place)
    paths = {name: Path(each.text) for name, each in options.items() if INPUT_OPTIONS[name].is_path}
    if "color" not in paths:
        if options or carried:
            place = next((each.place for each in options.values()), table.place("carry"))
            raise UsageProblem("missing-option", "needs color", "add color", path=place)
        return [], []
    found = find(
        paths["color"],
        paths.get("depth"),
        others_of(paths, table.place()),
        patterns_in=table.file.parent,
        frames=choice_of(options, table.place),
        carried=carried,
    )
    pictures, shot = ([Entry(picture, table.place()) for picture in each] for each in found)
    return pictures, shot


def _carried(table: Table) -> dict[str, Path]:
    """The path pattern of each label, from the key ``carry`` of ``[inputs]``."""
    given, where = table.values.get("carry", {}), table.place("carry")
    if not isinstance(given, dict):
        remedy = 'write carry = {masks = "masks/*.png"}'
        raise UsageProblem("malformed", "is not a table of paths", remedy, path=where)
    for rows in {"list", "pictures"} & {*table.values} if given else ():
        problem, remedy = f"is not for the rows of {rows}", "name color and depth by patterns"
        raise UsageProblem("idle-option", problem, remedy, path=where)
    for name in filterfalse(is_label, given):
        remedy = "use another one, of small letters, digits and _"
        raise UsageProblem("malformed", f"cannot name a label '{name}'", remedy, path=where)
    return {name: Path(_path(value, where, name)) for name, value in given.items()}


def _from_tables(table: Table) -> list[Entry]:
    if "pictures" not in table.values:
        return []
    tables = table.values["pictures"]
    if not isinstance(tables, list) or not all(isinstance(row, dict) for row in tables):
        remedy = "write [[inputs.pictures]] above each picture's color and depth"
        problem = "is not a list of tables"
        raise UsageProblem("malformed", problem, remedy, path=table.place("pictures"))
    places = (Place(table.file, f"[[inputs.pictures]] {number}") for number in count(1))
    return _from_rows(zip(places, tables, strict=False), table.file)


def _from_rows(rows: Iterable[Row], file: Path) -> list[Entry]:
    """The pictures of the rows of a list.

    A job whose files are missing fails later. InputError is raised here only if no colour file of
    the first `_TRIED` rows exists.
    """
    with without_collections():
        entries = [_entry(row, where, file) for where, row in rows]
    if not entries:
        raise InputError("empty", "has no row", "write one for each picture", path=file)
    if not any(entry.picture.color.exists() for entry in entries[:_TRIED]):
        first = entries[0]
        remedy = f"paths are relative to {file.parent}, the folder of {file.name}"
        problem = f"{first.picture.color}: no such file"
        raise InputError("not-found", problem, remedy, path=first.where)
    return entries


def _entry(row: Mapping[str, Any], where: Place, file: Path) -> Entry:
    if not _KNOWN_SET.issuperset(row):
        refuse_unknown(row, _KNOWN, where, "a row")
    options = layer_of(row, LENS_OPTIONS, where.with_field)
    paths = {
        name: file.parent / _path(row[key], where, key)
        for key, name in _FILES.items()
        if key in row
    }
    if "color" not in paths:
        raise InputError("empty", "has no color", "give it the path of a colour file", path=where)
    color = paths["color"]
    if "depth" not in paths and color.suffix.lower() not in SCENE_SUFFIXES:
        problem = "has no depth, and its color is not an EXR that holds both"
        raise InputError("empty", problem, "give depth", path=where)
    others: dict[str, Any] = {
        role: PictureFiles(other.stem, other, depth or other)
        for role, (other, depth) in others_of(paths, where).items()
    }
    stem = str(row.get("stem", color.stem))
    odd = not stem or "/" in stem or "\0" in stem or stem.startswith(".") or not stem.isprintable()
    if "stem" in row and (odd or not isinstance(row["stem"], str | int)):
        problem = f"{row['stem']!r} cannot name a file"
        remedy = "it becomes OUT/<kind>/<stem>.<ext>, so write a plain name"
        raise InputError("malformed", problem, remedy, path=where, field="stem")
    return Entry(PictureFiles(stem, color, paths.get("depth", color), **others), where, options)


def _path(value: object, where: Place, key: str) -> str:
    if not isinstance(value, str) or not value or "\0" in value:
        problem, remedy = f"{value!r} is not a path", "write it in quotes"
        raise InputError("malformed", problem, remedy, path=where.with_field(key))
    return value

"""Jobs files: the pictures of a batch, the lenses that take each, and the outputs.

A TOML file with the tables
  [inputs]    pictures, see `inputs`
  [split]     shares of train, test, …, see `splits`
  [dataset]   title, licence, source and citation, see `batch.datasets.origin`
  [lens]      the options of a lens; ``file``, a lens file below them; ``max-coc``, see [sample]
  [animate]   keys of lens options by frame, see `animation`; ``file``, files of
              keys; ``interpolation``
  [shot]      steady, focus-smooth, motion: what frames have in common, see `shots`
  [sweep]     lists, grids and ranges of lens options, see `sweeps`
  [sample]    random lenses, see `sweeps`; ``max-coc``, like
              "40px", bounds the radius of the blur: a lens beyond it is drawn again, and where no
              draw suits, or none was drawn, the picture is rejected
  [reading]   depth-format and the other options of reading, see `reading_options`
  [outputs]   kinds, format, map-format, exr-type, compression, jpeg-quality, preview;
              inputs = "copy" adds the sharp picture and its depth, kinds image and depth
  [machine]   quality; depth-repair may stand here instead

All that decides what the outputs look like stands in it; where they go and who computes them does
not.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from defocus_core.errors import UsageProblem
from defocus_core.request.animation import read_animation
from defocus_core.request.inputs import read_inputs
from defocus_core.request.job import Job, Machine, Outputs, Picture, Reading
from defocus_core.request.job_options import MACHINE_OPTIONS, OUTPUT_OPTIONS, SHOT_OPTIONS
from defocus_core.request.lens import Lens
from defocus_core.request.lens_files import reading_in
from defocus_core.request.origin import JobsSource, read_origin
from defocus_core.request.parameters import METADATA
from defocus_core.request.picture_lenses import lens_file_of, read_lenses
from defocus_core.request.reading_options import READING_OPTIONS
from defocus_core.request.resolver import (
    OPTIONS,
    fields_of,
    keys_of,
    layer_in,
    layer_of,
    outputs_of,
    reading_of,
)
from defocus_core.request.shots import decisions_of, with_shot
from defocus_core.request.splits import read_splits
from defocus_core.request.toml_file import Table, parsed_toml, read_bytes, refuse_unknown, table

TABLES = (
    *("inputs", "split", "lens", "animate", "shot", "sweep", "sample"),
    *("reading", "outputs", "machine", "dataset"),
)
MAX_JOBS = 10_000_000
# Options of a single picture, and the table and key that they are here.
KEYS = {
    **{
        row.name: f"[{table}] {key}"
        for table, rows in OPTIONS.items()
        for key, row in keys_of(rows).items()
    },
    **{METADATA: f"[lens] {METADATA}", "lens": "[lens] file"},
}


class Batch(NamedTuple):
    """The jobs of a batch, and what they were made of, to be kept."""

    jobs: list[Job]
    source: JobsSource


def read_batch(asked: Path | Mapping[str, Any], outputs: Outputs, machine: Machine) -> Batch:
    """What a jobs file, or its tables, ask for; jobs of one picture follow one another.

    `outputs`: directory to write to, and defaults for ``[outputs]``; `machine`: device, threads and
    memory, and defaults for ``[machine]``.
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
    reading = _reading(tables["reading"], tables["lens"], tables["machine"])
    animation = read_animation((), None, tables["animate"])
    lenses = read_lenses(tables["lens"], tables["sweep"], tables["sample"], animation, reading)
    outputs = outputs_of(layer_in(tables["outputs"], OUTPUT_OPTIONS), outputs)
    quality = fields_of(layer_in(tables["machine"], MACHINE_OPTIONS, "depth-repair"))
    entries, shot = read_inputs(tables["inputs"], animation.frames)
    if (count := len(entries) * lenses.count) > MAX_JOBS:
        problem, remedy = f"asks for {count} pictures", f"split it into files of at most {MAX_JOBS}"
        raise UsageProblem("out-of-range", problem, remedy, path=path)
    machine = replace(machine, **quality)
    splits = read_splits(tables["split"]).of([entry.picture for entry in entries])
    jobs = [
        Job(entry.picture, lens, reading, outputs, machine, suffix, split=split)
        for entry, split in zip(entries, splits, strict=True)
        for suffix, lens in lenses.lenses(entry.picture, range(lenses.count), entry.options)
    ]

    @cache
    def lens_of(picture: Picture, suffix: str) -> Lens:
        return next(lenses.lenses(picture, [lenses.suffixes.index(suffix)]))[1]

    decisions = decisions_of(layer_in(tables["shot"], SHOT_OPTIONS))
    every, moving = [each.picture for each in shot], "focus-at" in animation.keys
    return Batch(with_shot(jobs, every, lens_of, decisions, moving=moving), source)


def read_jobs(path: Path, outputs: Outputs, machine: Machine) -> list[Job]:
    """The jobs of a jobs file, as of `read_batch`."""
    return read_batch(path, outputs, machine).jobs


def _reading(section: Table, lens: Table, machine: Table) -> Reading:
    """The options of ``[reading]``, over those of the lens file."""
    repair = {n: value for n, value in machine.values.items() if n == "depth-repair"}
    if repair and "depth-repair" in section.values:
        problem, place = "stands in [reading], too", machine.place("depth-repair")
        raise UsageProblem("contradiction", problem, "keep one of them", path=place)
    return reading_of(
        reading_in(lens_file_of(lens)),
        layer_of(repair, READING_OPTIONS, machine.place),
        layer_in(section, READING_OPTIONS),
    )

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

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from defocus_core.errors import UsageProblem
from defocus_core.request.animation import read_animation_table
from defocus_core.request.inputs import Entry, read_inputs
from defocus_core.request.job import Job, Machine, Outputs, Picture, Reading
from defocus_core.request.job_options import MACHINE_OPTIONS, OUTPUT_OPTIONS, SHOT_OPTIONS
from defocus_core.request.lens import Lens
from defocus_core.request.lens_files import reading_in
from defocus_core.request.origin import JobsSource, read_origin, source_of_tables
from defocus_core.request.parameters import METADATA
from defocus_core.request.picture_lenses import PictureLenses, lens_file_of, read_lenses
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


@dataclass(frozen=True)
class Batch:
    """What a jobs file asks for: each picture by each lens. Its jobs are made of it."""

    path: Path  # the jobs file, or what errors call its tables
    tables: Mapping[str, Table]  # the tables by name
    entries: Sequence[Entry]
    shot: Sequence[Entry]  # all frames of a shot, whichever are wanted
    lenses: PictureLenses  # the lenses of each
    reading: Reading  # how to read the files
    outputs: Outputs
    machine: Machine  # how it is computed
    source: JobsSource  # what of all this was made, to be kept

    @property
    def count(self) -> int:
        """How many jobs there are."""
        return len(self.entries) * self.lenses.count

    def jobs(self) -> list[Job]:
        """The jobs; those of one picture follow one another."""
        pictures = [entry.picture for entry in self.entries]
        splits = read_splits(self.tables["split"]).of(pictures)
        jobs = [
            Job(entry.picture, lens, self.reading, self.outputs, self.machine, suffix, split=split)
            for entry, split in zip(self.entries, splits, strict=True)
            for suffix, lens in self.lenses.lenses(
                entry.picture, range(self.lenses.count), entry.options
            )
        ]
        suffixes = {suffix: number for number, suffix in enumerate(self.lenses.suffixes)}

        @cache
        def lens_of(picture: Picture, suffix: str) -> Lens:
            return next(self.lenses.lenses(picture, [suffixes[suffix]]))[1]

        return with_shot(
            jobs,
            [each.picture for each in self.shot],
            lens_of,
            decisions_of(layer_in(self.tables["shot"], SHOT_OPTIONS)),
            moving="focus-at" in self.lenses.animation.keys,
        )


def read_batch(path: Path, outputs: Outputs, machine: Machine) -> Batch:
    """What a jobs file asks for.

    `outputs`: directory to write to, and defaults for ``[outputs]``; `machine`: device, threads and
    memory, and defaults for ``[machine]``.
    """
    what, remedy = "jobs file", "give a jobs file, with tables [inputs] and [lens]"
    data = read_bytes(path, what, remedy)
    tables = parsed_toml(data, path, what=what, remedy=remedy)
    return batch_of(tables, path, outputs, machine, JobsSource(path, data))


def read_jobs(path: Path, outputs: Outputs, machine: Machine) -> list[Job]:
    """The jobs of a batch: those of one picture follow one another, in the order of the file.

    Arguments and errors are those of `read_batch`, and of `Batch.jobs`.
    """
    return read_batch(path, outputs, machine).jobs()


def batch_of(
    stored: Mapping[str, Any],
    path: Path,
    outputs: Outputs,
    machine: Machine,
    source: JobsSource | None = None,
) -> Batch:
    """What the tables of a jobs file ask for; all else is as of `read_batch`.

    `source`: what they were read from; None for tables from Python.
    """
    refuse_unknown(stored, TABLES, path, "a jobs file", "table")
    named = {name: table(path, stored, name) for name in TABLES}
    read_origin(named["dataset"])
    reading = _reading(named["reading"], named["lens"], named["machine"])
    animation = read_animation_table(named["animate"])
    tables = (named["lens"], named["sweep"], named["sample"])
    lenses = read_lenses(*tables, animation, reading)
    outputs = _outputs(named["outputs"], outputs)
    machine = _machine(named["machine"], machine)
    entries, shot = read_inputs(named["inputs"], animation.frames)
    source = source or source_of_tables(stored)
    batch = Batch(path, named, entries, shot, lenses, reading, outputs, machine, source)
    if batch.count > MAX_JOBS:
        problem = f"asks for {batch.count} pictures"
        raise UsageProblem(
            "out-of-range", problem, f"split it into files of at most {MAX_JOBS}", path=path
        )
    return batch


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


def _outputs(section: Table, outputs: Outputs) -> Outputs:
    return outputs_of(layer_in(section, OUTPUT_OPTIONS), outputs)


def _machine(section: Table, machine: Machine) -> Machine:
    fields = fields_of(layer_in(section, MACHINE_OPTIONS, "depth-repair"))
    return dataclasses.replace(machine, **fields)

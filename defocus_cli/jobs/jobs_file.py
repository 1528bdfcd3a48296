"""Jobs files: the pictures of a batch, the lenses that take each, and the outputs.

A TOML file with the tables
  [inputs]    pictures, see `defocus_cli.jobs.inputs`
  [lens]      the options of a lens; ``file``, a lens file below them; ``max-coc``, see [sample]
  [sweep]     lists, grids and ranges of lens options, see `defocus_cli.jobs.sweep`
  [sample]    random lenses, see `defocus_cli.jobs.random_lenses`; ``max-coc``, like
              "40px", bounds the radius of the blur: a lens beyond it is drawn again, and where no
              draw suits, or none was drawn, the picture is rejected
  [reading]   depth-unit, depth-channel, color-layer, part
  [outputs]   kinds, format, exr-type, jpeg-quality, preview
  [machine]   quality, or tolerance, like "1px"; depth-repair, "auto" or "off"

All that decides what the outputs look like stands in it; where they go and who computes them does
not.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from defocus_cli.formats.depth_conventions import CONVENTIONS
from defocus_cli.formats.kinds import FORMAT_ALIASES, KINDS, SUFFIXES
from defocus_cli.jobs.inputs import read_inputs
from defocus_cli.jobs.job import (
    DEPTH_REPAIRS,
    QUALITIES,
    Job,
    Machine,
    Outputs,
    Reading,
)
from defocus_cli.jobs.lens_expansion import read_plan
from defocus_cli.jobs.quantities import pixel_count
from defocus_cli.jobs.toml_file import Table, read_toml, table
from defocus_cli.system.errors import UsageProblem, did_you_mean

TABLES = ("inputs", "lens", "sweep", "sample", "reading", "outputs", "machine")
LARGEST_FILE = 2**26  # bytes
MOST_JOBS = 10_000_000


def read_jobs(path: Path, outputs: Outputs, machine: Machine) -> list[Job]:
    """The jobs of a batch: those of one picture follow one another, in the order of the file.

    Args:
        path: the jobs file.
        outputs: where to write; what to write, unless ``[outputs]`` says otherwise.
        machine: who computes; ``[machine]`` says the quality and whether depth is repaired.

    Raises:
        InputError: a file cannot be read or found, or files do not pair up.
        UsageProblem: a key is unknown, a value makes no sense, or two contradict each other.
    """
    remedy = "give a jobs file, with tables [inputs] and [lens]"
    stored = read_toml(path, what="jobs file", remedy=remedy, largest=LARGEST_FILE)
    for name in stored:
        if name not in TABLES:
            known = f"a jobs file knows [{'], ['.join(TABLES)}]"
            raise UsageProblem(path, f"unknown table '{name}'", did_you_mean(name, TABLES, known))
    named = {name: table(path, stored, name) for name in TABLES}
    plan = read_plan(named["lens"], named["sweep"], named["sample"])
    reading = _reading(named["reading"])
    outputs = _outputs(named["outputs"], outputs)
    machine = _machine(named["machine"], machine)
    entries = read_inputs(named["inputs"])
    if len(entries) * plan.count > MOST_JOBS:
        problem = f"asks for {len(entries) * plan.count} pictures"
        raise UsageProblem(path, problem, f"split it into files of at most {MOST_JOBS}")
    for entry in entries:
        plan.check(entry)
    return [
        Job(entry.picture, lens, reading, outputs, machine, suffix)
        for entry in entries
        for suffix, lens in plan.lenses(entry)
    ]


def _reading(found: Table) -> Reading:
    found.refuse_unknown(("depth-unit", "depth-channel", "color-layer", "part"))
    return Reading(
        depth_unit=found.choice("depth-unit", tuple(CONVENTIONS)),
        depth_channel=found.text("depth-channel"),
        color_layer=found.text("color-layer"),
        part=found.whole("part", 0),
    )


def _outputs(found: Table, outputs: Outputs) -> Outputs:
    found.refuse_unknown(("kinds", "format", "exr-type", "jpeg-quality", "preview"))
    name = found.values.get("format")
    if isinstance(name, str):
        aliased = {**found.values, "format": FORMAT_ALIASES.get(name, name)}
        found = Table(found.file, found.name, aliased)
    given = {
        "kinds": _kinds(found),
        "format": found.choice("format", tuple(SUFFIXES)),
        "exr_type": found.choice("exr-type", ("half", "float")),
        "jpeg_quality": found.whole("jpeg-quality", 1, 100),
        "preview": found.flag("preview"),
    }
    told = dataclasses.replace(outputs, **_told(given))
    for field, kind in (("exr_type", "exr"), ("jpeg_quality", "jpg")):
        if given[field] is not None and told.format != kind:
            problem = f"says nothing about {told.format}"
            remedy = f'leave it out, or use format = "{kind}"'
            raise UsageProblem(found.place(field.replace("_", "-")), problem, remedy)
    return told


def _kinds(found: Table) -> tuple[str, ...] | None:
    value = found.values.get("kinds")
    if value is None:
        return None
    kinds = value.split(",") if isinstance(value, str) else value
    if not isinstance(kinds, list) or not kinds:
        raise UsageProblem(found.place("kinds"), f"{value!r} is no list", 'write ["render", "coc"]')
    kinds = [str(kind).strip() for kind in kinds]
    for kind in kinds:
        if kind not in KINDS:
            remedy = did_you_mean(kind, tuple(KINDS), f"choose from {', '.join(KINDS)}")
            raise UsageProblem(found.place("kinds"), f"'{kind}' is not an output", remedy)
    return tuple(dict.fromkeys(kinds))


def _machine(found: Table, machine: Machine) -> Machine:
    found.refuse_unknown(("quality", "tolerance", "depth-repair"))
    told = {
        "quality": found.choice("quality", QUALITIES),
        "tolerance": found.parsed("tolerance", pixel_count),
    }
    if None not in told.values():
        remedy = "keep one of them"
        raise UsageProblem(found.place("tolerance"), "stands beside quality", remedy)
    told["depth_repair"] = found.choice("depth-repair", DEPTH_REPAIRS)
    return dataclasses.replace(machine, **_told(told))


def _told(given: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in given.items() if value is not None}

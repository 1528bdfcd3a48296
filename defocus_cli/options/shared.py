"""Options that commands share, bundled: a command receives one object for each group.

``@output_options`` adds ``--out``, … and hands the command ``outputs: Outputs``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from defocus_cli.options.rows import given_options, param_option
from defocus_cli.options.types import (
    Command,
    Decorator,
    FilePath,
    ReportPath,
    bundle,
    files_option,
    machine_option,
    option,
    output_option,
)
from defocus_cli.words.console import Due
from defocus_core.allowed_values import MIN_TILE
from defocus_core.errors import InputError, UsageProblem
from defocus_core.request.job import DEVICES, FIELDS, Machine, Outputs
from defocus_core.request.job_options import MACHINE_OPTIONS, OUTPUT_OPTIONS, QUALITY
from defocus_core.request.quantities import byte_count
from defocus_core.request.resolver import fields_of, outputs_of
from defocus_core.system.process import cores

MAX_THREADS = 1024  # more than any machine has cores for one picture
_MAX_TILE = 1 << 14  # px


def others_options(command: Command) -> Command:
    """Hand a command ``others``: by role, colour and depth of what belongs to each picture.

    A plate may have no depth; a deep holdout and a matte have none.
    """
    options = [
        files_option(
            "--hidden COLOR DEPTH",
            "Colour and depth of what lies behind, where it is known: depth inf with colour 0 is "
            "unknown, and invented; inf with colour is sky.",
            FilePath(),
            nargs=2,
        ),
        files_option(
            "--over PLATE [DEPTH]",
            "Plate behind the element COLOR, blurred with it as one scene. Without DEPTH it is "
            "the EXR's own, or else infinitely far.",
            FilePath(),
        ),
        files_option("--over-depth DEPTH", "Depth of the plate.", FilePath()),
        files_option(
            "--holdout DEEP",
            "Deep EXR whose samples hide what is behind them and show nothing, like objects that "
            "are composited later: colour and alpha are cut out.",
            FilePath(),
        ),
        files_option(
            "--matte FILE",
            "Coverage of the near subject, 0 to 1, in grey or alpha, as of a portrait mode: its "
            "silhouette is the edge of the depth, and hair is parted from what is behind it.",
            FilePath(),
        ),
    ]
    return bundle("others", _others, options)(command)


def _others(**given: Any) -> dict[str, tuple[Path, Path | None]]:
    """Colour and depth by role."""
    below = given.pop("over_depth")
    if given["over"] is None and below is not None:
        raise UsageProblem(
            "missing-option", "stands without --over", "give the plate", field="over-depth"
        )
    pairs = {"hidden": given.pop("hidden"), "over": given["over"] and (given.pop("over"), below)}
    pairs |= {role: (path, None) for role, path in given.items() if path is not None}
    return {role: pair for role, pair in pairs.items() if pair is not None}


def output_options(command: Command) -> Command:
    """Hand a command ``outputs``: what to write, and where."""
    rows = [row for row in OUTPUT_OPTIONS.values() if not row.in_files]
    options = [
        output_option(
            "-o --out OUT",
            "Directory to write to; or a file like picture.png, for one picture of one "
            "kind alone, without a journal; one that defocus wrote is replaced.",
            FilePath(),
            into="root",
            required=True,
        ),
        *(param_option("Output", row) for row in rows),
        output_option("--overwrite", "Render again and replace what is there.", is_common=True),
    ]

    def make(root: Path, overwrite: bool, **values: Any) -> Outputs:
        given = given_options(values, OUTPUT_OPTIONS)
        return outputs_of(given, Outputs(root, overwrite=overwrite), one_file=True)

    return bundle("outputs", make, options)(command)


def name_option(command: Command) -> Command:
    """Hand a command ``name``: the template of the names of pictures, or None."""
    text = (
        "Names of the pictures, like '{stem}_{focus}', of "
        f"{', '.join(FIELDS)}.  [default: {{stem}}, and {{stem}}_{{view}} of several views]"
    )
    return output_option("--name TEMPLATE", text)(command)


def machine_options(command: Command) -> Command:
    """Hand a command ``machine``: how to compute."""
    return bundle("machine", _machine, _computing())(command)


def draft_options(command: Command) -> Command:
    """Hand a command ``machine``: how to compute drafts."""
    return bundle("machine", _machine, _computing()[1:])(command)


def rendering_options(command: Command) -> Command:
    """Hand a command ``machine``: how to compute pictures of any size, as accurate as wanted."""
    return bundle("machine", _machine, [*_computing(), *memory_options()])(command)


def _machine(quality: str | None = None, **others: Any) -> Machine:
    return Machine(**fields_of(given_options({"quality": quality}, MACHINE_OPTIONS)), **others)


def _computing() -> list[Decorator]:
    return [
        param_option("Machine", QUALITY),
        device_option(),
        machine_option(
            "--threads N",
            "Threads to compute with.  [default: one for each core]",
            click.IntRange(1, MAX_THREADS),
            default=cores,
        ),
    ]


def device_option() -> Decorator:
    """``--device``: where to compute."""
    text = "Where to compute; auto takes a GPU if there is one."
    kind = click.Choice(DEVICES)
    return machine_option("--device", text, kind, default="auto", show_default=True)


def memory_options() -> list[Decorator]:
    """Bounds of memory, which change no picture by more than the last digits."""
    return [
        machine_option(
            "--memory SIZE",
            "Memory a process may take, like 2GB: what is larger goes through scratch files "
            "in TMPDIR.  [default: most of what is free]",
            byte_count,
        ),
        machine_option(
            "--tile PX",
            "Side of the tiles to compute in; changes the last digits.",
            click.IntRange(min=MIN_TILE, max=_MAX_TILE),
        ),
    ]


def check_inputs_option(command: Command) -> Command:
    """Hand a command ``check_inputs``: stat or hash."""
    return machine_option(
        "--check-inputs",
        "How to see that an input of what is done has changed: size and time, or its bytes.",
        ["stat", "hash"],
        default="stat",
        show_default=True,
    )(command)


def json_option(command: Command) -> Command:
    """Hand a command ``as_json``."""
    text = "Print one JSON document on stdout.  ('defocus help json')"
    return option("--json", text, into="as_json")(command)


def verbose_option(command: Command) -> Command:
    """Hand a command ``verbose``; with ``--quiet`` it says warnings and errors alone."""

    def be_quiet(ctx: click.Context, _: click.Parameter, value: bool) -> None:
        if value and ctx.params.get("verbose"):
            raise UsageProblem("contradiction", "stands beside -v", "keep one", field="quiet")
        Due.quiet = value

    text = "Say nothing but warnings and errors."
    quiet = option("-q --quiet", text, expose_value=False, callback=be_quiet)
    text = "Say more, on stderr."
    verbose = option("-v --verbose", text, is_eager=True)
    return verbose(quiet(command))


def html_option(text: str) -> Decorator:
    """``--html``: where to write the report that people look at."""
    return output_option("--html FILE.html", text, ReportPath("html"))


def refuse_existing(path: Path, *, overwrite: bool) -> None:
    """Refuse to replace a file, unless ``--overwrite`` asks for it."""
    if path.exists() and not overwrite:
        remedy = "give another name, or --overwrite"
        raise InputError("exists", "is there already", remedy, path=path)

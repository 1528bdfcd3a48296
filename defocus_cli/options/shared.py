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
    machine_option,
    option,
    output_option,
)
from defocus_cli.words.console import Due
from defocus_core.errors import InputError, UsageProblem
from defocus_core.request.job import FIELDS, Machine, Outputs
from defocus_core.request.job_options import INPUT_OPTIONS, MACHINE_OPTIONS, OUTPUT_OPTIONS
from defocus_core.request.resolver import fields_of, outputs_of
from defocus_core.system.process import cores


def others_options(command: Command) -> Command:
    """Hand a command ``others``: by role, colour and depth of what belongs to each picture.

    A plate may have no depth; a deep holdout and a matte have none.
    """
    rows = [INPUT_OPTIONS[name] for name in ("hidden", "over", "over-depth", "holdout", "matte")]
    return bundle("others", _others, list(map(param_option, rows)))(command)


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
    rows = [row for row in OUTPUT_OPTIONS.values() if row.only != "files"]
    options = [
        output_option(
            "-o --out OUT",
            "Directory to write to; or a file like picture.png, for one picture of one "
            "kind alone, without a journal; one that defocus wrote is replaced.",
            FilePath(),
            into="root",
            required=True,
        ),
        *map(param_option, rows),
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


def machine_options(*names: str) -> Decorator:
    """Hand a command ``machine``: how to compute, by some of the options of a machine."""

    def make(**values: Any) -> Machine:
        given = fields_of(given_options(values, MACHINE_OPTIONS))
        return Machine(**{"threads": cores(), **given})

    return bundle("machine", make, [param_option(MACHINE_OPTIONS[name]) for name in names])


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

"""Options that commands share."""

from __future__ import annotations

from pathlib import Path

import click

from defocus_cli.options.types import (
    Command,
    Decorator,
    ReportPath,
    machine_option,
    option,
    output_option,
)
from defocus_cli.words.console import Due
from defocus_core.errors import InputError, UsageProblem
from defocus_core.request.quantities import byte_count


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


def dataset_options(command: Command) -> Command:
    """Hand a command ``shards_size``, bytes or None."""
    return option(
        "--shards-size SIZE",
        "When all is done, pack the samples into WebDataset tars of this size, like 1GB; "
        "those that are there are packed again if samples change.",
        byte_count,
    )(command)

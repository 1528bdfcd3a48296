"""``defocus golden``: pictures that later renders must be like."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path

import click

from defocus_cli.options import comparing
from defocus_cli.options.batch import crew_options
from defocus_cli.options.shared import FilePath, GroupedCommand, json_option, option
from defocus_cli.words import batch as batch_report
from defocus_cli.words import console
from defocus_core.batch.run_batch import WorkerConfig
from defocus_core.batch.workers.run import Execution
from defocus_core.compare.goldens import (
    FreshPictures,
    accept,
    change_words,
    compared,
    read_store,
    rendered,
)
from defocus_core.compare.record import EXTRA, MISSING
from defocus_core.compare.thresholds import ROUNDING, Rules
from defocus_core.errors import InputError
from defocus_core.reports import comparison_words as compare_report
from defocus_core.reports.html import comparisons
from defocus_core.system.text import counted

_DEFAULT_RULES = Rules(fail=(ROUNDING,))


@click.group(
    "golden",
    invoke_without_command=True,
    short_help="Keep pictures that later renders must be like, and check them.",
)
@click.pass_context
def command(ctx: click.Context) -> None:
    """Keep goldens: the pictures of a jobs file that were accepted; later renders must be like.

    DIR has the pictures, and for each sample a file of the settings, inputs and versions of it.
    Without rules, no value may differ by more than 1e-4, since another processor rounds otherwise.

    \b
    Examples:
      defocus golden update jobs.toml goldens --accept
      defocus golden check jobs.toml goldens --junit goldens.xml
    """  # noqa: D301  click reads the backspace
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


_only = option(
    "--only PATTERN",
    "Only jobs that write a picture of this name, like render/spheres.exr or 'left/*'; may be "
    "repeated.",
    multiple=True,
)


@command.command("update", cls=GroupedCommand)
@click.argument("jobs_file", type=FilePath(), metavar="JOBS.toml")
@click.argument("folder", type=FilePath(), metavar="DIR")
@option("--accept", "Make what changed the new goldens.", into="accepted")
@_only
@comparing.comparison_options(_DEFAULT_RULES, rules_alone=True)
@crew_options
def update(
    jobs_file: Path,
    folder: Path,
    accepted: bool,
    only: tuple[str, ...],
    asked: comparing.ComparisonOptions,
    crew: WorkerConfig,
) -> int:
    """Render JOBS.toml, say what is not like the goldens in DIR, and accept it with --accept.

    Goldens that a new picture is like stay as they are. If a render fails, nothing is accepted.
    The exit code is 1 if something would change, or if a render failed.

    \b
    Examples:
      defocus golden update jobs.toml goldens
      defocus golden update jobs.toml goldens --accept
      defocus golden update jobs.toml goldens --only render/spheres.exr --accept
    """  # noqa: D301  click reads the backspace
    store = read_store(folder, anew=True)
    with _render(jobs_file, crew, only) as fresh:
        store = store.only({job.sample_id for job in fresh.jobs}) if only else store
        changes = store.changes(fresh)
        console.stdout(*changes["inputs"], *changes["settings"])
        records = list(compared(store, fresh, asked.task, crew.count))
        changed = [record for record in records if not record.passes]
        for record in changed:
            lone = record.status in (EXTRA, MISSING)
            words = record.name if lone else compare_report.line(record)
            console.stdout(f"{change_words(record)}: {words}")
        batch_report.end(fresh.summary)
        if not fresh.complete:
            raise InputError(
                "empty", "has jobs that made no picture", "mend them first", path=jobs_file
            )
        if accepted and (changed or any(changes.values()) or store.listed):
            accept(store, fresh, records)
        if not changed:
            console.stdout(f"{folder}: {counted(len(records), 'golden')}, none changes")
        elif not accepted:
            console.stdout(
                f"{folder}: {len(changed)} would change; --accept makes them the goldens"
            )
            return 1
        else:
            console.stdout(f"{folder}: {counted(len(changed), 'golden')} changed")
    return 0


@command.command("check", cls=GroupedCommand)
@click.argument("jobs_file", type=FilePath(), metavar="JOBS.toml")
@click.argument("folder", type=FilePath(), metavar="DIR")
@_only
@comparing.comparison_options(_DEFAULT_RULES)
@json_option
@crew_options
def check(
    jobs_file: Path,
    folder: Path,
    only: tuple[str, ...],
    asked: comparing.ComparisonOptions,
    as_json: bool,
    crew: WorkerConfig,
) -> int:
    """Render JOBS.toml again, and compare with the goldens in DIR.

    \b
    Examples:
      defocus golden check jobs.toml goldens --thresholds compare.toml --junit goldens.xml
      defocus golden check jobs.toml goldens --html goldens.html
    """  # noqa: D301  click reads the backspace
    start = time.perf_counter()
    store = read_store(folder)
    with _render(jobs_file, crew, only) as fresh:
        store = store.only({job.sample_id for job in fresh.jobs}) if only else store
        changes = store.changes(fresh)
        changed = [*changes["inputs"], *changes["settings"]]
        if not as_json:
            console.stdout(*changed)
        records = list(compared(store, fresh, asked.task, crew.count))
        words = [f"Jobs: {jobs_file}", f"A: goldens in {folder}", "B: rendered now", *changed]
        commands = comparisons.golden_commands(jobs_file, folder, asked.rules.of, _DEFAULT_RULES)
        title = f"{jobs_file} checked with {folder}"
        header = comparisons.ReportHeader(title, words, commands, "rendered now")
        failures = asked.write_reports(records, header, time.perf_counter() - start, crew.count)
    if as_json:
        document = {f"{name}_changed": lines for name, lines in changes.items()}
        document |= compare_report.document(records)
        console.print_json(**document, failed=failures.records())
    else:
        for record in records:
            if compare_report.is_worth_a_line(record, verbose=False, lone=False):
                console.stdout(compare_report.line(record))
        console.stdout(compare_report.summary(records))
    batch_report.end(fresh.summary)
    failures.end()
    return compare_report.exit_code(records)


def _render(
    jobs_file: Path, crew: WorkerConfig, only: Sequence[str]
) -> AbstractContextManager[FreshPictures]:
    console.name_keys()
    report = batch_report.BatchReport(each=False)
    execution = Execution(crew.execute(), spread=crew.spread)
    return rendered(jobs_file, crew.machine, execution, report, only)

"""``defocus render``: colour and depth in, defocused pictures out."""

from __future__ import annotations

from pathlib import Path

import click

from defocus_cli import options, report, stats_table
from defocus_cli.job import (
    Job,
    Lens,
    Machine,
    Outputs,
    Reading,
    find_pictures,
    make_jobs,
    with_hidden,
)
from defocus_cli.option_types import FilePath


@click.command(
    "render",
    cls=options.GroupedCommand,
    short_help="Defocus pictures: colour and depth in, render, left, right, coc out.",
)
@click.argument("color", type=FilePath())
@click.argument("depth", type=FilePath(), required=False)
@options.lens_options(required=True)
@options.output_options
@options.hidden_option
@options.reading_options
@options.machine_options
@options.json_option
@options.verbose_option
@options.stats_option
@click.option(
    "--dry-run",
    is_flag=True,
    help="Say what would be read and written, how long it takes and in how much memory, and stop.",
)
def command(
    color: Path,
    depth: Path | None,
    lens: Lens,
    outputs: Outputs,
    hidden: tuple[Path, Path] | None,
    reading: Reading,
    machine: Machine,
    as_json: bool,
    verbose: bool,
    stats: bool,
    dry_run: bool,
) -> None:
    """Defocus COLOR as a lens would that sees DEPTH, and write to OUT/<kind>/<stem>.<ext>.

    COLOR and DEPTH are two files, or two directories whose files pair up by stem. Without DEPTH,
    COLOR is an EXR that holds both, or a directory of such.

    \b
    Kinds:
      render        the defocused picture
      left, right   what the left and right half of the lens see (dual pixel)
      coc           signed radius of the circle of confusion in px, beyond the focus positive
      disparity     dual-pixel disparity in px, signed alike
      trust         share of the lens that saw what the picture holds: 1 is nothing invented

    --dry-run opens the inputs and renders nothing. What it says of time goes by a measurement of
    this machine, made once and kept.

    \b
    Examples:
      defocus render rgb.exr depth.exr -o out --focal-length 50mm --fnumber 1.4 --focus 2m
      defocus render photo.jpg depth_mm.png -o out --lens 50mm.toml --focus-at 640,360 --format png
      defocus render frames/ depths/ -o out --lens 50mm.toml --outputs render,left,right,coc
      defocus render scene.exr -o out --lens 50mm.toml --focus inf --blades 6 --preview
      defocus render frames/ depths/ -o out --lens 50mm.toml --dry-run
    """  # noqa: D301  click reads the backspace
    pictures = with_hidden(find_pictures(color, depth), color, hidden)
    jobs = make_jobs(pictures, lens, reading=reading, outputs=outputs, machine=machine)
    if dry_run:
        _plan(jobs, as_json)
        return
    records = _run(jobs, verbose=verbose, stats=stats)
    if as_json:
        report.print_json(dry_run=False, pictures=records)


def _plan(jobs: list[Job], as_json: bool) -> None:
    from defocus_cli import forecast

    found = forecast.forecasts(jobs)
    looked_at = list(found.values())
    if as_json:
        records = []
        for number, job in enumerate(jobs):
            told = {"forecast": forecast.record(found[number])} if number in found else {}
            records.append({**report.plan_record(job), **told})
        whole = forecast.total(looked_at, len(jobs))
        report.print_json(dry_run=True, pictures=records, forecast=whole)
        return
    for number, job in enumerate(jobs):
        click.echo(report.plan_line(job))
        if number in found:
            click.echo(forecast.line(found[number]))
    for line in forecast.total_lines(looked_at, len(jobs)):
        click.echo(line)


def _run(jobs: list[Job], *, verbose: bool, stats: bool) -> list[dict[str, object]]:
    from defocus_cli import engine

    engine.load()
    records = []
    with report.progress(jobs) as (counted, tile_count):
        for job in counted:
            outcome = engine.run(job, tile_count)
            for line in report.outcome_lines(outcome, verbose=verbose):
                report.say(line)
            if stats:
                for line in stats_table.lines(outcome.stats):
                    report.say(line)
            records.append(report.outcome_record(outcome))
    return records

"""``defocus compare``: whether two pictures, or two folders of them, are the same."""

from __future__ import annotations

import time
from pathlib import Path

import click

from defocus_cli.compare.metrics import METRICS
from defocus_cli.compare.pairing import find_pairs
from defocus_cli.compare.record import Settings
from defocus_cli.compare.run import Task, compare_all
from defocus_cli.compare.selection import Region
from defocus_cli.compare.thresholds import Rule, read_thresholds
from defocus_cli.html import comparisons
from defocus_cli.options import comparing, shared
from defocus_cli.options.types import FilePath, GroupedCommand
from defocus_cli.reports import compare_report
from defocus_cli.reports.batch_report import bar
from defocus_cli.reports.junit import write_junit
from defocus_cli.system import console

_METRICS = "\n".join(f"  {m.name:<15} {m.help}" for m in METRICS.values())
_HELP = f"""Say whether B is the same as A, and if not, what happened to it.

A is the reference. A and B are two files, or two directories whose files pair up by their relative
path; a file that one of them lacks is a difference.

All values must be equal over the display window, or pass the rules of --fail. NaN or infinity on
one side only, another size and a missing channel are never the same. Number type, compression,
order of channels and data window are noted; metadata counts with --metadata.

The exit code is 0 if all are the same, 1 if some differ, 2 for wrong usage, 3 if a file cannot be
read.

\b
Metrics for --fail and --warn:
{_METRICS}

'defocus help compare' has a file of thresholds, an example for CI, and the names of what happened.

\b
Examples:
  defocus compare golden.exr render.exr
  defocus compare golden/ out/ --fail 'psnr<45' --warn 'max>0.02' --junit compare.xml
  defocus compare golden/ out/ --html compare.html
  defocus compare golden/ out/ --thresholds compare.toml --diff differences
  defocus compare golden/render out/render --coc out/coc --fail 'elsewhere-psnr<50'
"""


@click.command(
    "compare",
    cls=GroupedCommand,
    help=_HELP,
    short_help="Say whether pictures are the same, and what happened if not.",
)
@click.argument("a", type=FilePath())
@click.argument("b", type=FilePath())
@comparing.rule_options
@comparing.selection_options
@comparing.report_options
@shared.json_option
@shared.verbose_option
def command(
    a: Path,
    b: Path,
    fail: tuple[Rule, ...],
    warn: tuple[Rule, ...],
    over: float | None,
    thresholds: Path | None,
    metadata: bool,
    region: Region | None,
    mask: Path | None,
    coc: Path | None,
    flip: bool,
    diff: Path | None,
    junit: Path | None,
    html: Path | None,
    processes: int,
    as_json: bool,
    verbose: bool,
) -> int:
    """Compare, as the help says."""
    start = time.perf_counter()
    rules = read_thresholds(thresholds, fail, warn, over)
    pairs = find_pairs(a, b)
    for pattern in rules.idle([pair.name for pair in pairs]):
        console.say(f"{thresholds}: no picture matches files = '{pattern}'")
    settings = Settings(region, mask, coc, flip, metadata)
    task = Task(rules, settings, diff)
    records, lone = [], not a.is_dir()
    with bar("pair", len(pairs)) as watched:
        for record in compare_all(pairs, task, processes):
            records.append(record)
            watched.update()
            worth = compare_report.is_worth_a_line(record, verbose=verbose, lone=lone)
            if worth and not as_json:
                console.tell(compare_report.line(record))
    if junit is not None:
        write_junit(junit, records, time.perf_counter() - start)
    if html is not None:
        words = [f"A: {a}", f"B: {b}", *comparisons.setting_lines(settings)]
        commands = comparisons.compare_commands(rules.of, settings)
        title = f"{b} compared with {a}"
        occasion = comparisons.Occasion(title, words, commands)
        comparisons.write(html, occasion, records, settings, processes)
    if as_json:
        console.print_json(**compare_report.document(records))
    elif not lone:
        console.tell(compare_report.summary(records))
    return compare_report.exit_code(records)

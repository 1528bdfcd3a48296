"""``defocus compare``: whether two pictures, or two folders of them, are the same."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from defocus_cli.options import comparing, shared
from defocus_cli.options.types import FilePath, GroupedCommand, machine_option, output_option
from defocus_cli.words import console
from defocus_cli.words.endings import Failures
from defocus_core.compare.metrics import METRICS
from defocus_core.compare.pairing import are_batches, find_pairs, pair_batches
from defocus_core.compare.record import DIFFERENT, EXTRA, Comparison
from defocus_core.compare.run import accept_files, compare_all
from defocus_core.reports import comparison_words as compare_report
from defocus_core.reports.html import comparisons
from defocus_core.system.process import cores
from defocus_core.system.text import counted

_METRICS = "\n".join(f"  {m.name:<15} {m.help}" for m in METRICS.values())
_HELP = f"""Say whether B is the same as A, and if not, what happened to it.

A is the reference. A and B are two files, or two directories whose files pair up by their relative
path; a file that one of them lacks is a difference. Of two finished batches, pictures pair up by
sample and kind, and what differs in their recipes (settings, lens, versions, inputs) is said first.

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
  defocus compare golden/ out/ --like render --junit compare.xml
  defocus compare golden/ out/ --fail 'hdr-p99.9>0.01' --fail found:clipped
  defocus compare golden/ out/ --html compare.html
  defocus compare golden/ out/ --like render --accept
  defocus compare batch1/ batch2/ --like encoder
  defocus compare golden/ out/ --thresholds compare.toml --diff differences
  defocus compare golden/render out/render --coc out/coc --fail 'elsewhere-psnr<50'
"""


@click.command("compare", cls=GroupedCommand, help=_HELP)
@click.argument("a", type=FilePath())
@click.argument("b", type=FilePath())
@comparing.comparison_options()
@output_option(
    "--accept",
    "After the report, make the files of B that differ the new A. Files that B lacks stay.",
)
@machine_option(
    "--processes N",
    "Processes to compare directories with.  [default: one for each core]",
    click.IntRange(min=1),
    default=cores,
)
@shared.json_option
@shared.verbose_option
def command(
    a: Path,
    b: Path,
    asked: comparing.ComparisonOptions,
    accept: bool,
    processes: int,
    as_json: bool,
    verbose: bool,
) -> int:
    """Compare, as the help says."""
    start = time.perf_counter()
    batches = pair_batches(a, b) if are_batches(a, b) else None
    pairs = find_pairs(a, b) if batches is None else batches.pairs
    recipes = [] if batches is None else list(batches.lines())
    for recipe in () if as_json else recipes:
        console.stdout(recipe)
    for pattern in asked.rules.idle([pair.name for pair in pairs]):
        console.stderr(f"{asked.file}: no picture matches files = '{pattern}'")
    lone = not a.is_dir()

    def say(record: Comparison) -> None:
        if compare_report.is_worth_a_line(record, verbose=verbose, lone=lone):
            console.stdout(compare_report.line(record))

    def report(records: Sequence[Comparison]) -> Failures:
        """Say what came of the pairs that were compared; all of them, unless interrupted."""
        if not (as_json or lone):
            console.stdout(compare_report.summary(records, len(pairs)))
        words = [f"A: {a}", f"B: {b}", *recipes, *comparisons.setting_lines(asked.settings)]
        commands = comparisons.compare_commands(asked.rules.of, asked.settings)
        header = comparisons.ReportHeader(f"{b} compared with {a}", words, commands)
        return asked.write_reports(records, header, time.perf_counter() - start, processes)

    head = {} if batches is None else {"recipes": [asdict(each) for each in batches.changes]}
    rows: Any = console.json_rows("pairs", **head) if as_json else nullcontext((say, {}))
    records: list[Comparison] = []
    with rows as (show, tail):
        try:
            for record in console.watch(
                compare_all(pairs, asked.task, processes), "pair", len(pairs)
            ):
                records.append(record)
                show(compare_report.pair_record(record) if as_json else record)
        finally:
            tail |= compare_report.counts(records, len(pairs))
            failures = report(records)
            tail["failed"] = failures.records()
        accepted = accept_files(a, b, records) if accept and not failures else []
        tail |= {"accepted": [str(path) for path in accepted]} if accept else {}
    failures.end()
    if accept and not as_json:
        console.stdout(f"{a}: {counted(len(accepted), 'file')} accepted from {b}")
    left = [r for r in records if not (accept and r.status in (DIFFERENT, EXTRA))]
    return compare_report.exit_code(left)

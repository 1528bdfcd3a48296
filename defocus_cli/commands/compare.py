"""``defocus compare``: compare two pictures, or two directories of them."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path

import click

from defocus_cli.options import comparing
from defocus_cli.options.shared import (
    FilePath,
    GroupedCommand,
    json_option,
    machine_option,
    option,
    verbose_option,
)
from defocus_cli.words import console
from defocus_core.compare.accepting import accept_files
from defocus_core.compare.metrics import METRICS
from defocus_core.compare.pairing import (
    are_batches,
    chosen_pairs,
    find_pairs,
    is_batch,
    pair_batches,
    samples_of,
)
from defocus_core.compare.record import DIFFERENT, EXTRA, SAME
from defocus_core.compare.run import compare_all
from defocus_core.errors import with_dashes
from defocus_core.reports import comparison_words as compare_report
from defocus_core.reports.html import comparisons
from defocus_core.system.process import cores
from defocus_core.system.text import command_line, counted

_METRICS = with_dashes("\n".join(f"  {m.name:<10} {m.help}" for m in METRICS.values()))
_HELP = f"""Compare pictures B with their references A; where they differ, name the cause.

A and B are two files, or two directories. In directories, pictures with the same relative path are
compared, and a picture that only one directory has counts as a difference. In two finished batches,
pictures of the same sample and kind are compared, and differences of settings, lens, versions and
inputs are printed first.

Without rules, all values must be equal inside the display window. With --fail or --like, a picture
fails if a rule says so. Whatever the rules, it fails if its size differs, if a channel is missing,
or if NaN or infinity stands on one side only. Differences of number type, compression, order of
channels and data window are printed and do not fail; differences of metadata fail with --metadata.

The exit code is 0 if all pictures pass, 1 if some fail, 2 for wrong usage, 3 if a file cannot be
read.

\b
Metrics for --fail and --warn:
{_METRICS}

'defocus help compare' lists the causes, and shows a file of rules and an example for CI.

\b
Examples:
  defocus compare golden.exr render.exr
  defocus compare golden/ out/ --like render --junit compare.xml
  defocus compare golden/ out/ --fail 'hdr-p99.9>0.01' --fail found:clipped
  defocus compare golden/ out/ --html compare.html
  defocus compare goldens/ new/ --like golden --accept --only 'render/a*'
  defocus compare batch1/ batch2/ --like encoder
  defocus compare golden/ out/ --thresholds compare.toml --diff differences
"""


@click.command("compare", cls=GroupedCommand, help=_HELP)
@click.argument("a", type=FilePath())
@click.argument("b", type=FilePath())
@comparing.comparison_options()
@option(
    "--accept",
    "After the report, replace references in A by the pictures of B that fail; A is created if it "
    "does not exist. References that B lacks stay.",
)
@option(
    "--only PATTERN",
    "Compare only pictures whose relative path matches, like render/spheres.exr or 'left/*'; may "
    "be repeated.  [default: all]",
    multiple=True,
    heading="What is compared",
)
@machine_option(
    "--processes N",
    "Number of processes that compare the pictures of directories.  [default: one for each core]",
    click.IntRange(min=1),
    default=cores,
)
@json_option
@verbose_option
def command(
    a: Path,
    b: Path,
    asked: comparing.ComparisonOptions,
    accept: bool,
    only: tuple[str, ...],
    processes: int,
    as_json: bool,
    verbose: bool,
) -> int:
    """Run the comparison, print and write its results, and return the exit code."""
    start = time.perf_counter()
    batches = pair_batches(a, b, only) if are_batches(a, b) else None
    pairs = chosen_pairs(find_pairs(a, b, anew=accept), only) if batches is None else batches.pairs
    recipes = [] if batches is None else list(batches.lines())
    for recipe in () if as_json else recipes:
        console.stdout(recipe)
    for pattern in asked.rules.idle([pair.name for pair in pairs]):
        console.stderr(f"{asked.file}: no picture matches files = '{pattern}'")
    asked.task.require_room(pairs)
    lone, records = not a.is_dir(), []
    try:
        compared = compare_all(pairs, asked.task, processes)
        for record in console.bar("pair", len(pairs), compared):
            records.append(record)
            is_told = verbose or lone or record.status != SAME  # equal pairs among many are not
            if is_told and not as_json:
                console.stdout(compare_report.line(record))
    finally:  # an interrupted run reports the pairs compared so far
        if not (as_json or lone):
            console.stdout(compare_report.summary(records, len(pairs)))
        words = [f"A: {a}", f"B: {b}", *recipes, *comparisons.setting_lines(asked.settings)]
        again = ["defocus", "compare", a, b, "--causes", "none", "--accept"]
        again += ["--metadata"] * asked.settings.metadata
        header = comparisons.ReportHeader(
            f"{b} compared with {a}", words, accept=command_line(again)
        )
        seconds = time.perf_counter() - start
        failures = asked.write_reports(
            records, header, pairs=len(pairs), seconds=seconds, processes=processes
        )
        whole = accept and not failures and len(records) == len(pairs)
        samples = samples_of(b, pairs) if whole and b.is_dir() and not is_batch(a) else {}
        accepted = accept_files(a, b, records, samples) if whole else []
        if as_json:
            document = compare_report.document(records, len(pairs))
            if batches is not None:
                document |= {"recipes": [asdict(each) for each in batches.changes]}
            document |= {"accepted": [str(path) for path in accepted]} if accept else {}
            console.print_json(**document, failed=failures.records())
    failures.end()
    if accept and not as_json:
        console.stdout(f"{a}: {counted(len(accepted), 'file')} accepted from {b}")
    left = [r for r in records if not (accept and r.status in (DIFFERENT, EXTRA))]
    return compare_report.exit_code(left)

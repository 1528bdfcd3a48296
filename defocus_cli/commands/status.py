"""``defocus status``: progress of a batch, and why jobs failed."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from defocus_cli.options.shared import FilePath, GroupedCommand, json_option, option
from defocus_cli.words import batch as batch_report
from defocus_cli.words import console
from defocus_core.batch.journal.progress import progress
from defocus_core.request.origin import KEPT


@click.command("status", cls=GroupedCommand)
@click.argument("out", type=FilePath())
@option(
    "--failures N",
    "List the last N failed jobs; 0 lists none.",
    click.IntRange(min=0),
    default=10,
    show_default=True,
)
@json_option
def command(out: Path, failures: int, as_json: bool) -> None:
    """Show the progress of the batch in OUT: numbers of jobs done and left, and failed jobs.

    Failed jobs are listed with their reasons. The command only reads the journal of the batch, so
    you can run it while the batch runs.

    \b
    Examples:
      defocus status out
      defocus status out --json
      jq -r 'select(.status == "failed") | .message' out/journal.jsonl
    """  # noqa: D301  click reads the backspace
    if (out / KEPT).exists():
        console.name_keys()
    state = progress(out, failures)
    if as_json:
        console.print_json(**asdict(state))
        return
    console.stdout(*batch_report.progress_lines(out, state))

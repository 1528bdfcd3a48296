"""``defocus merge``: merge the journals of the shards of a batch."""

from __future__ import annotations

from pathlib import Path

import click

from defocus_cli.options.shared import FilePath, GroupedCommand, dataset_options, json_option
from defocus_cli.words import console
from defocus_core.batch.datasets import update
from defocus_core.batch.journal import progress
from defocus_core.batch.journal.journal import Ledger
from defocus_core.system.text import counted


@click.command("merge", cls=GroupedCommand)
@click.argument("out", type=FilePath())
@dataset_options
@json_option
def command(out: Path, shards_size: int | None, as_json: bool) -> None:
    """Merge the journals that 'defocus batch --shard' left in OUT, and write the index of samples.

    The result is that of a single run. The index lists the samples of all batches in OUT; 'defocus
    batch' without --shard lists those of its jobs file alone. No shard may be running.

    \b
    Examples:
      defocus merge out
      defocus merge out --shards-size 1GB
    """  # noqa: D301  click reads the backspace
    named = {record.sample_id: record.split for record in Ledger(out).records()}
    packed = None if shards_size is None else list(named)
    update.refuse_foreign(out, {*named.values()}, packed)
    merged = progress.merge(out)
    written = update.index(out, shards_size)
    journals = counted(merged.journals, "journal")
    console.stderr(f"{out}: {counted(merged.jobs, 'job')}, from {journals} of shards")
    if merged.missing:
        missing = f"no journal of shards {', '.join(merged.missing)}"
        console.stderr(f"{out}: warning: {missing}; they did not run, or had nothing to do")
    if as_json:
        counts = {"jobs": merged.jobs, "journals": merged.journals, "missing": merged.missing}
        console.print_json(**counts, written=[str(path) for path in written])

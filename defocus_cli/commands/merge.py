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
    """Merge the journals of a batch that ran in shards, and write the list of its samples.

    Run it when all shards of 'defocus batch --shard' have ended. It makes one journal of their
    journals in OUT, as if the batch had run as a whole, and writes OUT/metadata.jsonl, the list of
    samples. The list has the samples of all batches in OUT; 'defocus batch' without --shard lists
    only the samples of its jobs file.

    \b
    Examples:
      defocus merge out
      defocus merge out --shards-size 1GB
    """  # noqa: D301  click reads the backspace
    named = {record.sample_id: record.split for record in Ledger(out).records()}
    packed = None if shards_size is None else list(named)
    update.refuse_foreign(out, {*named.values()}, packed)
    jobs, journals, missing = progress.merge(out)
    written = [str(path) for path in update.index(out, shards_size)]
    of_shards = f"from {counted(journals, 'journal')} of shards"
    console.stderr(f"{out}: {counted(jobs, 'job')}, {of_shards}")
    if missing:
        lacking = f"no journal of shards {', '.join(missing)}"
        console.stderr(f"{out}: warning: {lacking}; they did not run, or had nothing to do")
    if as_json:
        console.print_json(jobs=jobs, journals=journals, missing=missing, written=written)

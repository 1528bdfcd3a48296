"""``defocus retry``: do the failed jobs of a batch again."""

from __future__ import annotations

from pathlib import Path

import click

from defocus_cli.commands.batch import carry_out
from defocus_cli.options import shared
from defocus_cli.options.batch import crew_options, dataset_options
from defocus_cli.options.types import FilePath, GroupedCommand, option
from defocus_cli.words import console
from defocus_core.batch.datasets import sample_index
from defocus_core.batch.journal.journal import read_all, require_journal
from defocus_core.batch.journal.lock import refuse_held
from defocus_core.batch.journal.records import REASONS
from defocus_core.batch.journal.resume import Ledger, failed_jobs
from defocus_core.batch.workers.plan import Execution
from defocus_core.batch.workers.pool import WorkerConfig, computed_by


@click.command("retry", cls=GroupedCommand)
@click.argument("out", type=FilePath())
@option(
    "--reason REASON",
    "Only those that failed, or were rejected, for this reason; may be given several times.",
    tuple(REASONS),
    into="reasons",
    multiple=True,
)
@dataset_options
@shared.json_option
@shared.verbose_option
@crew_options
def command(
    out: Path,
    reasons: tuple[str, ...],
    shards_size: int | None,
    as_json: bool,
    verbose: bool,
    crew: WorkerConfig,
) -> None:
    """Do the jobs of OUT once more that failed, with the settings that the journal has of them.

    'defocus status OUT' tells the reasons. Rejected jobs are done again only if their reason is
    named.

    \b
    Examples:
      defocus retry out
      defocus retry out --reason worker-died --processes 1
    """  # noqa: D301  click reads the backspace
    require_journal(out)
    refuse_held(out)
    jobs = failed_jobs(Ledger(out, read_all(out)), reasons)
    if not jobs:
        console.stderr(f"{out}: nothing failed{' for that reason' if reasons else ''}")
    execution = Execution(crew.execute(), again=True, spread=crew.spread)
    jobs = computed_by(jobs, crew.machine)
    before = sample_index.listed(out)
    asked = None if before is None else before | {job.sample_id for job in jobs}
    carry_out(jobs, out, execution, shards_size, asked, as_json=as_json, verbose=verbose)

"""``defocus retry``: the failed jobs of a batch once more."""

from __future__ import annotations

from pathlib import Path

import click

from defocus_cli import dataset_index, options, report
from defocus_cli.batch_options import Crew, computed_by, crew_options, shards_size_option
from defocus_cli.commands.batch import carry_out
from defocus_cli.grouped import GroupedCommand
from defocus_cli.how import How
from defocus_cli.journal import read_all, require_journal
from defocus_cli.ledger import Ledger
from defocus_cli.lock import refuse_held
from defocus_cli.option_types import FilePath
from defocus_cli.reasons import REASONS
from defocus_cli.revival import failed_jobs


@click.command("retry", cls=GroupedCommand, short_help="Do the failed jobs of a batch once more.")
@click.argument("out", type=FilePath())
@click.option(
    "--reason",
    "reasons",
    type=click.Choice(tuple(REASONS)),
    multiple=True,
    metavar="REASON",
    help="Only those that failed, or were rejected, for this reason; may be given several times.",
)
@shards_size_option
@options.json_option
@options.verbose_option
@crew_options
def command(
    out: Path,
    reasons: tuple[str, ...],
    shards_size: int | None,
    as_json: bool,
    verbose: bool,
    crew: Crew,
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
    refuse_held(out, say=report.say)
    jobs = failed_jobs(Ledger(out, read_all(out)), reasons)
    if not jobs:
        report.say(f"{out}: nothing failed{' for that reason' if reasons else ''}")
    how = How(crew.execute(), again=True, spread=crew.spread)
    jobs = computed_by(jobs, crew.machine)
    before = dataset_index.listed(out)
    asked = None if before is None else before | {job.sample_id for job in jobs}
    carry_out(jobs, out, how, shards_size, asked, as_json=as_json, verbose=verbose)

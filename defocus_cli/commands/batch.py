"""``defocus batch``: render the jobs of a jobs file, resumable and over several machines."""

from __future__ import annotations

from pathlib import Path

import click

from defocus_cli.options.batch import crew_options, shard_of
from defocus_cli.options.shared import (
    FilePath,
    GroupedCommand,
    check_inputs_option,
    contact_option,
    dataset_options,
    json_option,
    option,
    verbose_option,
)
from defocus_cli.words import batch as batch_report
from defocus_cli.words import console
from defocus_core.batch.journal.journal import Shard
from defocus_core.batch.run_batch import WorkerConfig
from defocus_core.batch.workers import run
from defocus_core.batch.workers.run import Execution
from defocus_core.errors import UsageProblem
from defocus_core.request.job import Outputs
from defocus_core.request.jobs_file import read_batch


@click.command("batch", cls=GroupedCommand)
@click.argument("jobs_file", type=FilePath(), metavar="JOBS.toml")
@option("-o --out OUT", "Directory to write to, with the journal.", FilePath(), required=True)
@option("--shard I/N", "Do only the I-th of N parts.", shard_of)
@option("--limit N", "Do at most N jobs and leave the rest.", click.IntRange(min=1))
@option(
    "--keep-going/--fail-fast",
    "Whether the rest is done if a job fails.",
    default=True,
    show_default=True,
)
@option("--overwrite", "Do all again, whatever was done before.")
@option("--new-only", "Leave what has outputs, whatever changed: do what has none yet.")
@dataset_options
@contact_option
@option("--dry-run", "Say what is to do, why, and in how much memory; stop.")
@json_option
@verbose_option
@crew_options
@check_inputs_option
def command(
    jobs_file: Path,
    out: Path,
    shard: Shard | None,
    limit: int | None,
    keep_going: bool,
    overwrite: bool,
    new_only: bool,
    shards_size: int | None,
    contact: int | None,
    dry_run: bool,
    as_json: bool,
    verbose: bool,
    crew: WorkerConfig,
    check_inputs: str,
) -> None:
    """Do the jobs of JOBS.toml: each picture by each lens, to OUT/<kind>/<sample>.<ext>.

    JOBS.toml says what a batch is made of; see 'defocus help batch'. OUT/journal.jsonl has a line
    for each job that came to an end. Whatever stops a batch, the same command goes on where it was:
    what is done is not done again, unless its inputs, settings or outputs changed, or defocus did;
    what failed is tried again. When the batch has ended, OUT/metadata.jsonl lists its samples;
    those of an earlier batch that this one does not ask for stay in OUT, and out of the list.

    The first Ctrl-C finishes what is being rendered, the second stops at once, as SIGTERM does.

    Many machines that share a file system each do a part: --shard 1/8 to --shard 8/8, then
    'defocus merge OUT'.

    \b
    Examples:
      defocus batch jobs.toml -o out
      defocus batch jobs.toml -o out --dry-run
      defocus batch jobs.toml -o out --contact 12
      defocus batch jobs.toml -o out --shard $SLURM_ARRAY_TASK_ID/8
      defocus batch jobs.toml -o out --scheduler tcp://head:8786
    """  # noqa: D301  click reads the backspace
    if shard is not None and shards_size is not None:
        problem, remedy = "needs the whole batch", "give it to 'defocus merge'"
        raise UsageProblem("whole-batch", problem, remedy, field="shards-size")
    console.name_keys()
    batch = read_batch(jobs_file, Outputs(out, overwrite=overwrite), crew.machine)
    execution = Execution(
        crew.execute(),
        shard=shard,
        limit=limit,
        fail_fast=not keep_going,
        read_inputs=check_inputs == "hash",
        spread=crew.spread,
        new_only=new_only,
        has_index=True,
        shards_size=shards_size,
        source=batch.source,
    )
    jobs = batch.jobs
    if dry_run:
        from defocus_cli.words import dry_run as dry_runs

        plan = run.make_plan(jobs, out, execution)
        dry_runs.report(plan, crew.count, each=verbose, as_json=as_json)
        return
    if contact is not None:
        from defocus_core.reports.sheets import kind_of_sheet, write_contact_sheet

        kind_of_sheet(jobs)
    report = batch_report.BatchReport(each=verbose, keep=as_json, verbose=verbose)
    with report.bar("job"):
        summary = run.run(jobs, out, execution, report)
    for line in batch_report.summary_lines(summary):
        console.stderr(line)
    written = list(summary.written)
    if contact is not None and (sheet := write_contact_sheet(jobs, contact)):
        console.stderr(f"contact sheet -> {sheet}")
        written.append(sheet)
    if as_json:
        record = batch_report.run_record(summary, report, jobs)
        console.print_json(**record, written=[str(path) for path in written])
    batch_report.end(summary)

"""``defocus batch``: render the jobs of a jobs file, in processes or on several machines."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click

from defocus_cli.options.job import given_options, param_option
from defocus_cli.options.shared import (
    Command,
    FilePath,
    GroupedCommand,
    bundle,
    check_inputs_option,
    contact_option,
    dataset_options,
    json_option,
    machine_option,
    option,
    verbose_option,
)
from defocus_cli.words import console
from defocus_cli.words.batch import carry_out
from defocus_core.batch.journal.journal import Shard
from defocus_core.batch.run_batch import WorkerConfig
from defocus_core.batch.workers.run import Execution
from defocus_core.errors import UsageProblem
from defocus_core.request.job import Outputs
from defocus_core.request.job_options import MACHINE_OPTIONS
from defocus_core.request.jobs_file import read_batch
from defocus_core.request.quantities import QuantityError
from defocus_core.request.resolver import fields_of


def crew_options(command: Command) -> Command:
    """Add the options of worker processes to a command, which gets them as ``crew``."""
    options = [
        machine_option(
            "--scheduler local|tcp://…",
            "Where to render: in processes on this machine (local), or on the workers of a Dask "
            "scheduler at this address (pip install 'defocus[dask]').",
            default="local",
            show_default=True,
        ),
        machine_option(
            "--processes N",
            "Number of processes on this machine.  [default: one for each core, or for each 2 GB "
            "of free memory if these are fewer; with --threads, cores / threads; with a GPU, 1]",
            click.IntRange(min=1),
        ),
        param_option(
            MACHINE_OPTIONS["threads"],
            "Number of CPU threads of each process.  [default: cores / processes; 1 on Dask]",
        ),
        *(param_option(MACHINE_OPTIONS[name]) for name in ("device", "memory", "tile")),
    ]

    def make(scheduler: str, processes: int | None, **values: Any) -> WorkerConfig:
        given = fields_of(given_options(values, MACHINE_OPTIONS))
        return WorkerConfig(scheduler, processes, **given)

    return bundle("crew", make, options)(command)


def shard_of(text: str) -> Shard:
    """The part of a batch that a text like ``2/8`` names."""
    match = re.fullmatch(r"\s*(\d{1,6})\s*/\s*(\d{1,6})\s*", text)
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        problem = f"'{text}' is not a part of a batch"
        raise QuantityError(problem, "write it like 2/8, from 1/8 to 8/8")
    return Shard(int(match[1]), int(match[2]))


@click.command("batch", cls=GroupedCommand)
@click.argument("jobs_file", type=FilePath(), metavar="JOBS.toml")
@option(
    "-o --out OUT", "Directory to write to; it holds the journal, too.", FilePath(), required=True
)
@option(
    "--shard I/N",
    "Do only part I of N parts of the batch, like 2/8: on another machine, or in a cluster job.",
    shard_of,
)
@option(
    "--limit N", "Do at most N jobs; the same command later does the rest.", click.IntRange(min=1)
)
@option(
    "--keep-going/--fail-fast",
    "Whether to go on with the other jobs, or to stop, when a job fails.",
    default=True,
    show_default=True,
)
@option("--overwrite", "Do all jobs again, even finished ones, and replace their outputs.")
@option(
    "--new-only",
    "Do only jobs that have no outputs yet; keep existing outputs, even if their settings or "
    "inputs changed.",
)
@dataset_options
@contact_option
@option(
    "--dry-run",
    "Print the jobs to do, why they are to be done, and the memory needed; render nothing.",
)
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
    """Render each picture with each lens that the jobs file JOBS.toml names.

    'defocus help batch' describes the jobs file. A job is one picture with one lens. Its outputs
    are OUT/<kind>/<sample>.<ext>, where <sample> is the name of the picture with that of the lens.

    OUT/journal.jsonl has a line for each job that ended. To go on after an interruption, give the
    same command again: it does the jobs that are left or failed. A finished job is done again only
    if its inputs, settings or outputs, or the renderer, changed. At the end OUT/metadata.jsonl
    lists the outputs of all jobs of JOBS.toml; outputs of an earlier JOBS.toml stay in OUT, but are
    not listed.

    Press Ctrl-C once to finish the pictures being rendered and stop; twice, to stop at once.

    To share a batch among machines with a common file system, run --shard 1/8 to --shard 8/8, then
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
    batch = read_batch(jobs_file, Outputs(out, overwrite=overwrite), crew.machine, shard)
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
    carry_out(
        batch.jobs,
        out,
        execution,
        dry_run=dry_run,
        contact=contact,
        as_json=as_json,
        verbose=verbose,
        processes=crew.count,
    )

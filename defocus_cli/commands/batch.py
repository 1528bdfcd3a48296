"""``defocus batch``: render the jobs of a jobs file, resumable and over several machines."""

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
    """Pass ``crew`` to a command: the processes that compute."""
    options = [
        machine_option(
            "--scheduler local|tcp://…",
            "Who does the jobs: processes of this machine, or a Dask scheduler "
            "(pip install 'defocus[dask]').",
            default="local",
            show_default=True,
        ),
        machine_option(
            "--processes N",
            "Processes on this machine.  [default: cores / threads; without --threads "
            "one for each core and 2 GB that are free; 1 with a GPU]",
            click.IntRange(min=1),
        ),
        param_option(
            MACHINE_OPTIONS["threads"],
            "Threads of each process.  [default: cores / processes; 1 on Dask]",
        ),
        *(param_option(MACHINE_OPTIONS[name]) for name in ("device", "memory", "tile")),
    ]

    def make(scheduler: str, processes: int | None, **values: Any) -> WorkerConfig:
        given = fields_of(given_options(values, MACHINE_OPTIONS))
        return WorkerConfig(scheduler, processes, **given)

    return bundle("crew", make, options)(command)


def shard_of(text: str) -> Shard:
    """A part of a batch, parsed from i/n."""
    match = re.fullmatch(r"\s*(\d{1,6})\s*/\s*(\d{1,6})\s*", text)
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        problem = f"'{text}' is not a part of a batch"
        raise QuantityError(problem, "write it like 2/8, from 1/8 to 8/8")
    return Shard(int(match[1]), int(match[2]))


@click.command("batch", cls=GroupedCommand)
@click.argument("jobs_file", type=FilePath(), metavar="JOBS.toml")
@option("-o --out OUT", "Directory to write to, with the journal.", FilePath(), required=True)
@option("--shard I/N", "Do only the I-th of N parts.", shard_of)
@option("--limit N", "Do at most N jobs and leave the rest.", click.IntRange(min=1))
@option(
    "--keep-going/--fail-fast",
    "Go on with the other jobs when one fails, or stop.",
    default=True,
    show_default=True,
)
@option("--overwrite", "Do all jobs again, also finished ones.")
@option("--new-only", "Do only the jobs without outputs; keep existing outputs, whatever changed.")
@dataset_options
@contact_option
@option("--dry-run", "Show the jobs to do, the reasons and the memory, without rendering.")
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
    """Render each picture with each lens of JOBS.toml to OUT/<kind>/<sample>.<ext>.

    'defocus help batch' describes JOBS.toml. OUT/journal.jsonl has a line for each finished job.
    After an interruption the same command continues: finished jobs are done again only if their
    inputs, settings or outputs changed, or the renderer did; failed jobs are tried again. At the
    end OUT/metadata.jsonl lists the samples. Samples of an earlier batch that are not in JOBS.toml
    stay in OUT, but are not listed.

    The first Ctrl-C finishes the pictures being rendered; the second stops at once, like SIGTERM.

    Machines that share a file system each do a part: --shard 1/8 to --shard 8/8, then 'defocus
    merge OUT'.

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

"""Options of the commands that carry out batches."""

from __future__ import annotations

import re
from typing import Any

import click

from defocus_cli.options.job import given_options, param_option
from defocus_cli.options.shared import Command, bundle, machine_option
from defocus_core.batch.journal.journal import Shard
from defocus_core.batch.run_batch import WorkerConfig
from defocus_core.request.job_options import MACHINE_OPTIONS
from defocus_core.request.quantities import QuantityError
from defocus_core.request.resolver import fields_of


def crew_options(command: Command) -> Command:
    """Hand a command ``crew``: the processes that compute."""
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
    """A part of a batch, written i/n."""
    match = re.fullmatch(r"\s*(\d{1,6})\s*/\s*(\d{1,6})\s*", text)
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        problem = f"'{text}' is not a part of a batch"
        raise QuantityError(problem, "write it like 2/8, from 1/8 to 8/8")
    return Shard(int(match[1]), int(match[2]))

"""Options of the commands that carry out batches."""

from __future__ import annotations

import re
from typing import Any

import click

from defocus_cli.options.shared import device_option, machine_option, memory_options
from defocus_cli.options.types import Command, Quantity, bundle, position_of
from defocus_core.batch.datasets import sample_index
from defocus_core.batch.journal.journal import Shard
from defocus_core.batch.lenses.quantities import byte_count
from defocus_core.batch.workers.pool import WorkerConfig
from defocus_core.errors import UsageProblem


def crew_options(command: Command) -> Command:
    """Hand a command ``crew``: the processes that compute."""
    options = [
        machine_option(
            "--scheduler",
            default="local",
            show_default=True,
            metavar="local|tcp://…",
            help="Who does the jobs: processes of this machine, or a Dask scheduler "
            "(pip install 'defocus[dask]').",
        ),
        machine_option(
            "--processes",
            type=click.IntRange(min=1),
            metavar="N",
            help="Processes on this machine.  [default: cores / threads; without --threads "
            "one for each core and 2 GB that are free; 1 with a GPU]",
        ),
        machine_option(
            "--threads",
            type=click.IntRange(min=1),
            metavar="N",
            help="Threads of each process.  [default: cores / processes; 1 on Dask]",
        ),
        device_option(),
        *memory_options(),
    ]
    return bundle("crew", WorkerConfig, options)(command)


class ShardType(click.ParamType[Shard]):
    """A part of a batch, written i/n."""

    name = "shard"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Shard:
        """Parse ``value``."""
        if isinstance(value, Shard):
            return value
        match = re.fullmatch(r"\s*(\d{1,6})\s*/\s*(\d{1,6})\s*", str(value))
        if not match or not 1 <= int(match[1]) <= int(match[2]):
            problem = f"'{value}' is no part of a batch"
            raise UsageProblem(
                "malformed", problem, "write it like 2/8, from 1/8 to 8/8", path=position_of(param)
            )
        return Shard(int(match[1]), int(match[2]))


def dataset_options(command: Command) -> Command:
    """Hand a command ``shards_size``, bytes or None, and ``parquet``, refused without pyarrow."""
    command = click.option(
        "--parquet",
        is_flag=True,
        callback=_with_pyarrow,
        help="When all is done, write the list of samples as OUT/samples.parquet, too "
        "(pip install 'defocus[parquet]'); one that is there is written again if samples change.",
    )(command)
    return click.option(
        "--shards-size",
        type=Quantity(byte_count, "SIZE"),
        metavar="SIZE",
        help="When all is done, pack the samples into WebDataset tars of this size, like 1GB; "
        "those that are there are packed again if samples change.",
    )(command)


def _with_pyarrow(context: click.Context, param: click.Parameter, value: bool) -> bool:
    if value:
        sample_index.require_pyarrow()
    return value

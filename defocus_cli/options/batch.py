"""Options of the commands that carry out batches."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import click

from defocus_cli.options.shared import cores, device_option, machine_option, memory_options
from defocus_cli.options.types import Command, Quantity, bundle, option_name
from defocus_core.batch.jobs.job import Job, Machine
from defocus_core.batch.journal.journal import Shard
from defocus_core.batch.lenses.quantities import byte_count
from defocus_core.batch.rendering import memory_budget
from defocus_core.batch.workers.plan import Execute
from defocus_core.errors import UsageProblem
from defocus_core.system import memory

# A core more for each process saves more than a thread more in it, for these wait for one another;
# but each should find this much memory.
ROOM_MB = 2000
MANY = 64  # workers of a cluster, whose number may change
_GPUS = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")  # NVIDIA, AMD, Windows' subsystem


@dataclass(frozen=True)
class Crew:
    """The processes that compute.

    Attributes:
        scheduler: ``local``, or the address of a Dask scheduler.
        processes: on this machine; None for as many as suit it.
        threads: of each; None for what makes use of all cores.
        device: auto, cpu or cuda.
        memory: bytes that each process may take; None for its share of what is available.
        tile: px on a side of a tile; None for the usual.
    """

    scheduler: str
    processes: int | None
    threads: int | None
    device: str
    memory: int | None
    tile: int | None

    @property
    def machine(self) -> Machine:
        """The machine settings of each job."""
        return Machine(
            device=self.device,
            threads=self.threads or cores() // self.count or 1,
            memory=self.memory or self._share(),
            tile=self.tile,
        )

    def _share(self) -> int | None:
        """Bytes of memory that one of several processes may take; None for no bound."""
        available = memory.available_mb()
        if self.scheduler != "local" or self.count == 1 or available is None:
            return None
        return int(memory_budget.SHARE * available / self.count * memory.MB)

    @cached_property
    def count(self) -> int:
        """The number of processes, counted once, since free memory changes.

        One for a GPU; else the cores divided by the threads, or without a number of threads one for
        each core, as far as memory goes: a core left over costs less than one process fewer.
        """
        if self.processes is not None:
            return self.processes
        if self.device == "cuda" or (self.device == "auto" and any(map(_is_there, _GPUS))):
            return 1
        if self.threads is not None:
            return max(1, cores() // self.threads)
        available = memory.available_mb()
        most = cores() if available is None else int(available // ROOM_MB)
        return max(1, min(cores(), most))

    @property
    def spread(self) -> int:
        """Over how many workers the jobs of one picture are to be spread."""
        return self.count if self.scheduler == "local" else MANY

    def execute(self) -> Execute:
        """The executor of the jobs.

        Raises:
            UsageProblem: there is no such scheduler.
        """
        if self.scheduler == "local":
            from defocus_core.batch.workers.pool import execute_in

            return execute_in(self.count)
        from defocus_core.batch.workers.dask_pool import execute_at

        return execute_at(self.scheduler, threads=self.threads)


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
    return bundle("crew", Crew, options)(command)


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
                "", problem, "write it like 2/8, from 1/8 to 8/8", path=option_name(param)
            )
        return Shard(int(match[1]), int(match[2]))


def shards_size_option(command: Command) -> Command:
    """Hand a command ``shards_size``: bytes, or None."""
    return click.option(
        "--shards-size",
        type=Quantity(byte_count, "SIZE"),
        metavar="SIZE",
        help="When all is done, pack the samples into WebDataset tars of this size, like 1GB; "
        "those that are there are packed again if samples change.",
    )(command)


def computed_by(jobs: list[Job], machine: Machine) -> list[Job]:
    """The jobs, done by a machine; quality stays, and tiles unless it has its own."""

    def adapted(own: Machine) -> Machine:
        tile = machine.tile or own.tile
        who = replace(own, device=machine.device, threads=machine.threads)
        return replace(who, memory=machine.memory, tile=tile)

    return [replace(job, machine=adapted(job.machine)) for job in jobs]


def _is_there(name: str) -> bool:
    return Path(name).exists()

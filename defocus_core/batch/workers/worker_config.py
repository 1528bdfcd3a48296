"""The processes that do the jobs of a batch: how many, with how many threads and memory each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from defocus_core.batch.jobs.job import Job, Machine
from defocus_core.batch.workers.dask_pool import execute_at
from defocus_core.batch.workers.plan import Execute
from defocus_core.picture import memory_budget
from defocus_core.system import memory
from defocus_core.system.process import cores

# A core more for each process saves more than a thread more in it, for these wait for one another;
# but each should find this much memory.
ROOM_MB = 2000
MANY = 64  # workers of a cluster, whose number may change
_GPUS = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")  # NVIDIA, AMD, Windows' subsystem


@dataclass(frozen=True)
class WorkerConfig:
    """The processes that compute."""

    scheduler: str  # ``local``, or the address of a Dask scheduler
    processes: int | None  # on this machine; None for as many as suit it
    threads: int | None  # of each; None for what makes use of all cores
    device: str  # auto, cpu or cuda
    memory: int | None  # bytes that each process may take; None for its share of what is available
    tile: int | None  # px on a side of a tile; None for the usual

    @property
    def machine(self) -> Machine:
        """The machine settings of each job."""
        return Machine(
            device=self.device,
            threads=self.threads or cores() // self.count or 1,
            memory=self.memory or self._memory_of_each(),
            tile=self.tile,
        )

    def _memory_of_each(self) -> int | None:
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
        maximum = cores() if available is None else int(available // ROOM_MB)
        return max(1, min(cores(), maximum))

    @property
    def spread(self) -> int:
        """Over how many workers the jobs of one picture are to be spread."""
        return self.count if self.scheduler == "local" else MANY

    def execute(self) -> Execute:
        """The executor of the jobs."""
        if self.scheduler == "local":
            from defocus_core.batch.workers.pool import execute_in

            return execute_in(self.count)
        return execute_at(self.scheduler, threads=self.threads)


def computed_by(jobs: Sequence[Job], machine: Machine) -> list[Job]:
    """The jobs, done by a machine; quality stays, and tiles unless it has its own."""

    def adapted(own: Machine) -> Machine:
        tile = machine.tile or own.tile
        who = replace(own, device=machine.device, threads=machine.threads)
        return replace(who, memory=machine.memory, tile=tile)

    return [replace(job, machine=adapted(job.machine)) for job in jobs]


def _is_there(name: str) -> bool:
    return Path(name).exists()

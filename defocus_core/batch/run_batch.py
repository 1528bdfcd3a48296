"""A batch and the processes that do it: run it, and go on where it was stopped."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, islice
from os import PathLike
from pathlib import Path
from typing import Any

from defocus_core.batch.journal.journal import MAX_SHARDS, Shard
from defocus_core.batch.journal.record import Record
from defocus_core.batch.workers import pipeline, run
from defocus_core.batch.workers.dask_pool import execute_at
from defocus_core.batch.workers.pool import Processes, dispatch
from defocus_core.batch.workers.run import Chunk, Done, Execute, Execution, Summary
from defocus_core.errors import UsageProblem
from defocus_core.picture import memory_budget
from defocus_core.request.job import DEVICES, Job, Machine, Outputs
from defocus_core.request.jobs_file import read_batch
from defocus_core.request.origin import JobsSource
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
    threads: int | None = None  # of each; None for what makes use of all cores
    device: str = "auto"  # or cpu, or cuda
    memory: int | None = None  # bytes of each process; None for its share of what is available
    tile: int | None = None  # px on a side of a tile; None for the usual

    @property
    def machine(self) -> Machine:
        """The machine settings of each job."""
        share, available = None, memory.available_mb()
        if self.scheduler == "local" and self.count > 1 and available is not None:
            share = int(memory_budget.SHARE * available / self.count * memory.MB)
        threads = self.threads or cores() // self.count or 1
        return Machine("standard", self.device, threads, self.memory or share, self.tile)

    @cached_property
    def count(self) -> int:
        """The number of processes, counted once, since free memory changes.

        One for a GPU; else the cores divided by the threads, or without a number of threads one for
        each core, as far as memory goes: a core left over costs less than one process fewer.
        """
        if self.processes is not None:
            return self.processes
        if self.device == "cuda" or (self.device == "auto" and any(map(os.path.exists, _GPUS))):
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
        if self.scheduler != "local":
            return execute_at(self.scheduler, threads=self.threads)

        def execute(chunks: Iterator[Chunk], done: Done, stopped: Callable[[], bool]) -> None:
            first = [*islice(chunks, 2)]
            if [len(chunk) for chunk in first] == [1]:  # a process takes longer to start than a job
                pipeline.execute(iter(first), done, stopped)
            elif first:
                dispatch(Processes(self.count), chain(first, chunks), done, stopped)

        return execute


Jobs = str | PathLike[str] | Mapping[str, Any] | Sequence[Job]


def batch_jobs(jobs: Jobs, out: str | PathLike[str], *, overwrite: bool = False) -> list[Job]:
    """The jobs of a batch, to look at, or to choose from before `run_batch` does them.

    Args:
        jobs: A jobs file; its tables, as ``{"inputs": {"color": …, "depth": …}, "lens": {…}}``; or
            jobs, which are to write to ``out``.
        out: Directory to write to.
        overwrite: Whether they are to be done again, whatever was done before.

    Raises:
        InputError: A file cannot be read or is missing, or files do not pair up.
        UsageProblem: A key is unknown, a value makes no sense, or two contradict each other.
    """
    return _asked(jobs, Outputs(Path(out), overwrite=overwrite), Machine(), None)[0]


def _asked(
    jobs: Jobs, outputs: Outputs, machine: Machine, shard: Shard | None
) -> tuple[list[Job], JobsSource | None]:
    """The jobs of a batch, done by a machine, and what of they were made if it can be kept."""
    if isinstance(jobs, str | PathLike | Mapping):
        asked = jobs if isinstance(jobs, Mapping) else Path(jobs)
        return read_batch(asked, outputs, machine, shard)
    if shard is not None:
        jobs = jobs[shard.number - 1 :: shard.of]
    root, overwrite = outputs.root, outputs.overwrite
    return [
        replace(
            job,
            outputs=replace(job.outputs, root=root, overwrite=overwrite),
            machine=replace(machine, quality=job.machine.quality, tile=job.machine.tile),
        )
        for job in jobs
    ], None


def run_batch(
    jobs: Jobs,
    out: str | PathLike[str],
    *,
    processes: int = 1,
    threads: int | None = None,
    device: str = "auto",
    memory: int | None = None,
    shard: tuple[int, int] | None = None,
    limit: int | None = None,
    fail_fast: bool = False,
    overwrite: bool = False,
    new_only: bool = False,
    hash_inputs: bool = False,
    ended: Callable[[Job, Record], None] | None = None,
) -> Summary:
    """Do the jobs of a batch that are not done yet, and write the index of its samples.

    Called again, it goes on where it was stopped: what is done is not done again, unless its
    inputs, settings or outputs changed; what failed is tried again. `samples` reads the result.

    Args:
        jobs: As of `batch_jobs`.
        out: Directory to write to, ``OUT/<kind>/<sample>.<ext>``, with the journal.
        processes: 1 renders in this process. More are faster for many pictures, but start this
            program again: it needs ``if __name__ == "__main__":``.
        threads: Of each process; None for what makes use of all cores.
        device: auto, cpu or cuda.
        memory: Bytes that each process may take; None for most of what is available.
        shard: Do only the k-th of n parts, ``(k, n)``; `defocus merge` makes one of all.
        limit: Do at most so many jobs, and leave the rest.
        fail_fast: Whether the rest is left if a job fails.
        overwrite: Whether all is done again, whatever was done before.
        new_only: Whether what has outputs stays as it is, whatever changed.
        hash_inputs: Whether bytes of inputs are compared with those of before, not only their
            size and time.
        ended: Called with each job that came to its end, and its record of the journal: its
            ``status`` is ok or failed, its ``end`` says why, or what was taken.

    Returns:
        How many ``jobs`` there are; how many were done before (``skipped``) and are ``left``; the
        others by status, ``statuses["ok"]`` and ``["failed"]``, and by
        ``reasons``; ``seconds``.

    Raises:
        InputError: A file cannot be read, or something that must not be touched is in the way.
        UsageProblem: The jobs make no sense.
        KeyboardInterrupt: Ctrl-C; what had been begun was finished first, unless it came twice.
    """
    if device not in DEVICES:
        remedy = f"choose from {', '.join(DEVICES)}"
        raise UsageProblem("unknown-name", f"'{device}' is not known", remedy, field="device")
    config = WorkerConfig("local", processes, threads, device, memory)
    part = None if shard is None else Shard(*shard)
    if part is not None and not 1 <= part.number <= part.of <= MAX_SHARDS:
        problem, remedy = f"{shard} is not a part of a batch", "write (2, 8), from (1, 8) to (8, 8)"
        raise UsageProblem("out-of-range", problem, remedy, field="shard")
    asked, source = _asked(jobs, Outputs(Path(out), overwrite=overwrite), config.machine, part)
    execution = Execution(
        pipeline.execute if processes == 1 else config.execute(),
        shard=part,
        limit=limit,
        fail_fast=fail_fast,
        read_inputs=hash_inputs,
        new_only=new_only,
        spread=config.spread,
        has_index=True,
        source=source,
    )
    summary = run.run(asked, Path(out), execution, run.Listener(ended))
    if summary.interrupted and summary.left:
        raise KeyboardInterrupt
    return summary

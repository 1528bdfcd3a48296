"""The functions that run and resume batches, and the choice of processes for them."""

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

# Another process saves more time than another thread, since threads wait for one another,
# but each process should have this much memory.
ROOM_MB = 2000
MANY = 64  # assumed number of workers of a cluster, which may change
_GPUS = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")  # NVIDIA, AMD, Windows' subsystem


@dataclass(frozen=True)
class WorkerConfig:
    """Where to compute the jobs of a batch: in how many processes, or on a Dask cluster."""

    scheduler: str  # ``local``, or the address of a Dask scheduler
    processes: int | None  # on this machine; None for a suitable number
    threads: int | None = None  # of each process; None to use all cores
    device: str = "auto"  # auto, cpu or cuda
    memory: int | None = None  # bytes of each process; None for its share of the available memory
    tile: int | None = None  # px on a side of a tile; None for the usual

    @property
    def machine(self) -> Machine:
        """The machine settings for each job."""
        share, available = None, memory.available_mb()
        if self.scheduler == "local" and self.count > 1 and available is not None:
            share = int(memory_budget.SHARE * available / self.count * memory.MB)
        threads = self.threads or cores() // self.count or 1
        return Machine("standard", self.device, threads, self.memory or share, self.tile)

    @cached_property
    def count(self) -> int:
        """The number of processes. It is determined once, as free memory changes."""
        if self.processes is not None:
            return self.processes
        if self.device == "cuda" or (self.device == "auto" and any(map(os.path.exists, _GPUS))):
            return 1
        if self.threads is not None:
            return max(1, cores() // self.threads)
        available = memory.available_mb()
        return cores() if available is None else max(1, min(cores(), int(available // ROOM_MB)))

    @property
    def spread(self) -> int:
        """The number of workers among which the jobs of one picture are divided."""
        return self.count if self.scheduler == "local" else MANY

    def execute(self) -> Execute:
        """Return the function that carries out jobs."""
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
    """The jobs of a batch, to inspect or select some of them before `run_batch`.

    Args:
        jobs: The path of a jobs file; or its tables, like ``{"inputs": {…}, "lens": {…}}``; or
            jobs, which are changed to write to ``out``.
        out: Directory to write to.
        overwrite: Whether `run_batch` should do finished jobs again.

    Raises:
        InputError: A file is missing or cannot be read, or colour and depth files do not match.
        UsageProblem: A key is unknown, a value is invalid, or two contradict each other.
    """
    return _asked(jobs, Outputs(Path(out), overwrite=overwrite), Machine())[0]


def _asked(
    jobs: Jobs, outputs: Outputs, machine: Machine, shard: Shard | None = None
) -> tuple[list[Job], JobsSource | None]:
    """The jobs of a batch or of a shard; and the jobs file or tables they come from, if any."""
    if isinstance(jobs, str | PathLike | Mapping):
        asked = jobs if isinstance(jobs, Mapping) else Path(jobs)
        return read_batch(asked, outputs, machine, shard)
    first, of = (0, 1) if shard is None else (shard.number - 1, shard.of)
    root, overwrite = outputs.root, outputs.overwrite
    return [
        replace(
            job,
            outputs=replace(job.outputs, root=root, overwrite=overwrite),
            machine=replace(machine, quality=job.machine.quality, tile=job.machine.tile),
        )
        for job in jobs[first::of]
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
    """Do the unfinished jobs of a batch, and write the index of its samples.

    Call it again to resume a batch. A finished job is done again only if its inputs, settings or
    outputs changed; a failed one is tried again. `samples` reads the result.

    Args:
        jobs: As for `batch_jobs`.
        out: Directory to write to, ``OUT/<kind>/<sample>.<ext>``; it also gets the journal.
        processes: Number of processes; 1 renders in this one. More are faster for many pictures.
            They import the calling script again, which needs ``if __name__ == "__main__":``.
        threads: Threads of each process; None to use all cores.
        device: auto, cpu or cuda.
        memory: Bytes that each process may take; None for most of the available memory.
        shard: (k, n) to do only shard k of n, k from 1; `defocus merge` joins the shards.
        limit: Greatest number of jobs to do now.
        fail_fast: Whether to stop when a job fails.
        overwrite: Whether to do all jobs again, even finished ones.
        new_only: Whether to keep existing outputs even if inputs or settings changed.
        hash_inputs: Whether to find changed inputs by content, not only by size and time.
        ended: Function that is called with each job that ended and its record. The record has a
            ``status``, ok or failed, and in ``end`` the outcome.

    Returns:
        A summary with the numbers of all ``jobs``, of those ``skipped`` as finished before and of
        those ``left``; of ended jobs by ``statuses``, ok and failed, and of failed ones by
        ``reasons``; and the ``seconds`` taken.

    Raises:
        InputError: A file cannot be read, or an output would replace a file of another program.
        UsageProblem: The jobs are invalid.
        KeyboardInterrupt: Ctrl-C was pressed. Pictures in progress are finished first, unless it is
            pressed twice.
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
    summary = run.run(asked, Path(out), execution, ended)
    if summary.interrupted and summary.left:
        raise KeyboardInterrupt
    return summary

"""Jobs of a batch in worker processes on this machine.

A process that dies is replaced when there is work for another; `dispatch` does its jobs again.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, islice
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from defocus_core.batch.journal.record import End
from defocus_core.batch.workers import pipeline
from defocus_core.batch.workers.dask_pool import execute_at
from defocus_core.batch.workers.dispatch import Lost, dispatch
from defocus_core.batch.workers.plan import Chunk, Done, Execute
from defocus_core.errors import InputError
from defocus_core.picture import memory_budget, plain_path
from defocus_core.request.job import Job, Machine
from defocus_core.system import memory
from defocus_core.system.process import cores

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from multiprocessing.context import SpawnProcess


Serve = Callable[[Connection], None]
STRIKES = 3
AT_ONCE = 3  # fewer jobs make a process wait: one is read, one rendered and one written
_FAILED_STARTS = 3  # processes that may die before they are ready
_GRACE = 10.0  # seconds to end in
_GLANCE = 0.1  # seconds between two looks at whether all is to stop
READY = "ready"


def serve(connection: Connection) -> None:
    """Do the jobs that come through the connection."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    stopped = threading.Event()
    jobs = _received(connection, stopped)
    plain_path.load()

    connection.send(READY)
    pipeline.run(jobs, lambda *ended: connection.send(ended), stopped=stopped.is_set)
    connection.close()
    os._exit(0)  # all results are sent; PyTorch would take a second to end


def _received(connection: Connection, stopped: threading.Event) -> Iterator[tuple[int, Job]]:
    """The jobs that are sent; ``stopped`` is set when no further one is to be begun.

    When the coordinator is gone, this process ends, whatever it is at: the next coordinator does
    the same jobs, and writes to the same files.
    """
    queue: SimpleQueue[tuple[int, Job] | None] = SimpleQueue()

    def listen() -> None:  # even while libraries are imported, and while a job waits to be read
        try:
            while (numbered := connection.recv()) is not None:
                queue.put(numbered)
        except (EOFError, OSError):
            os._exit(1)
        stopped.set()
        queue.put(None)

    threading.Thread(target=listen, name="listener", daemon=True).start()
    return iter(queue.get, None)


class Processes:
    """Processes that do jobs, each of which starts with its first chunk."""

    strikes = STRIKES

    def __init__(self, processes: int, serve: Serve = serve) -> None:
        self.serve, self.apart = serve, processes
        self.workers: list[_Worker] = []
        self.failed_starts = 0

    def has_room(self) -> bool:
        """Whether another chunk can be submitted."""
        return len(self.workers) < self.apart or any(each.has_room for each in self.workers)

    def submit(self, chunk: Chunk) -> None:
        """Give a chunk to an idle process, to a new one, or to one that waits soon."""
        ready = [each for each in self.workers if each.has_room]
        least = min(ready, key=lambda each: len(each.flight), default=None)
        if least is None or (least.flight and len(self.workers) < self.apart):
            self.workers.append(least := _Worker(self.serve))
        least.send(chunk)

    def collect(self) -> Iterator[tuple[int, End] | Lost]:
        """Wait a while until a process sends a result or dies."""
        handles: dict[Any, _Worker] = {each.connection: each for each in self.workers}
        handles |= {each.process.sentinel: each for each in self.workers}
        for each in dict.fromkeys(handles[handle] for handle in wait(list(handles), _GLANCE)):
            try:
                while each.connection.poll():
                    message = each.connection.recv()
                    if message == READY:
                        each.ready, self.failed_starts = True, 0
                    else:
                        each.flight.pop(message[0], None)
                        yield message
            except (EOFError, OSError):
                yield self._lost(each)

    def _lost(self, each: _Worker) -> Lost:
        self.workers.remove(each)
        each.kill()
        self.failed_starts += not (each.ready or each.stopping)
        if self.failed_starts >= _FAILED_STARTS:
            problem = f"die when they start (exit code {each.process.exitcode})"
            raise InputError(
                "worker-died", problem, "see if 'defocus render' works", path="worker processes"
            )
        return Lost([*each.flight.items()], _death(each.process.exitcode) if each.ready else "")

    def stop(self) -> None:
        """Begin no further job; a process that is not ready has begun none, and ends."""
        for each in self.workers:
            each.stop()
            if not each.ready:
                each.process.kill()

    def close(self) -> None:
        """End all processes: at once those that have jobs."""
        for each in self.workers:
            if each.ready and not each.flight:
                each.stop()
                each.process.join(_GRACE)
            each.kill()


class _Worker:
    """A process, and the jobs that it has; the first of them wait until it has started."""

    def __init__(self, serve: Serve) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process: SpawnProcess = context.Process(
            target=serve, args=(theirs,), daemon=True, name="defocus-worker"
        )
        with _without_interrupts():
            self.process.start()
        theirs.close()
        self.flight: dict[int, Job] = {}
        self.ready = False
        self.stopping = False

    @property
    def has_room(self) -> bool:
        """Whether it takes another chunk."""
        return self.ready and not self.stopping and len(self.flight) < AT_ONCE

    def send(self, chunk: Chunk) -> None:
        """Give it jobs."""
        self.flight |= dict(chunk)
        with suppress(OSError):  # it is dead, which `collect` sees
            for numbered in chunk:
                self.connection.send(numbered)

    def stop(self) -> None:
        """Let it end after the jobs that it has begun."""
        if not self.stopping:
            self.stopping = True
            with suppress(OSError):
                self.connection.send(None)

    def kill(self) -> None:
        """End it now."""
        self.connection.close()
        self.process.kill()
        self.process.join(_GRACE)


def _death(code: int | None) -> str:
    how = f"with exit code {code}"
    if code is not None and code < 0:
        with suppress(ValueError):
            how = f"by {signal.Signals(-code).name}"
    return f"{{times}} processes that worked on it died, the last {how}"


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Processes started in the block never hear Ctrl-C, which is the coordinator's affair."""
    resource_tracker.ensure_running()  # else the first process starts it, which unblocks SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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

"""Jobs of a batch in worker processes on this machine.

A process that dies (a crash in a decoder, the system short of memory) is replaced. Which of the
jobs it had was to blame is not known, so each of them is done again with a process to itself; one
that has seen `STRIKES` processes die has failed.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, islice
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from defocus_core.batch.journal.record import End, Failed
from defocus_core.batch.workers import pipeline
from defocus_core.batch.workers.dask_pool import execute_at
from defocus_core.batch.workers.plan import Chunk, Done, Execute, sent
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

    def send(number: int, end: End) -> None:
        connection.send((number, sent(end)))

    connection.send(READY)
    pipeline.run(jobs, send, stopped=stopped.is_set)
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


class Pool:
    """Processes that do jobs."""

    def __init__(
        self,
        processes: int,
        chunks: Iterator[Chunk],
        done: Done,
        stopped: Callable[[], bool],
        serve: Serve = serve,
    ) -> None:
        self.serve = serve
        self.processes, self.chunks, self.done, self.stopped = processes, chunks, done, stopped
        self.workers: list[_Worker] = []
        self.returned: deque[Chunk] = deque()  # of workers that died when they started
        self.suspects: deque[tuple[int, Job]] = deque()
        self.strikes: Counter[int] = Counter()
        self.failed_starts = 0

    def run(self) -> None:
        """Do all jobs, or until stopped."""
        try:
            self._start_workers()
            while self.workers:
                for each in self.workers:
                    self._send_jobs(each)
                for each in [each for each in self.workers if self._is_over(each)]:
                    each.finish()
                    self.workers.remove(each)
                self._receive()
                self._start_workers()
        finally:
            for each in self.workers:
                each.kill()

    def _start_workers(self) -> None:
        """Start as many processes as there is work for, each with a chunk of its own."""
        while len(self.workers) < self.processes and not self.stopped():
            without_jobs = sum(not each.flight for each in self.workers)
            chunk = [] if len(self.suspects) > without_jobs else self._next_chunk()
            if chunk is None:
                return
            self.workers.append(_Worker(self.serve, chunk))

    def _next_chunk(self) -> Chunk | None:
        """Jobs that no worker has; None if there are no more."""
        return self.returned.popleft() if self.returned else next(self.chunks, None)

    def _send_jobs(self, each: _Worker) -> None:
        """Send a worker the jobs that it can take."""
        if self.stopped():
            self.suspects.clear()
            each.stop()
        elif self.suspects:
            if each.ready and not each.flight:
                each.alone = True
                each.send([self.suspects.popleft()])
        elif each.ready and not each.alone and len(each.flight) < AT_ONCE:
            each.send(self._next_chunk() or [])

    def _is_over(self, each: _Worker) -> bool:
        """Whether a worker has nothing to do; before it is ready, it has begun nothing."""
        return not each.flight if each.ready else self.stopped()

    def _receive(self) -> None:
        """Wait until a worker sends a result or dies."""
        if not self.workers:
            return
        handles: dict[Any, _Worker] = {each.connection: each for each in self.workers}
        handles |= {each.process.sentinel: each for each in self.workers}
        for each in dict.fromkeys(handles[handle] for handle in wait(list(handles), _GLANCE)):
            try:
                while each.connection.poll():
                    self._handle(each, each.connection.recv())
            except (EOFError, OSError):
                self._replace(each)

    def _handle(self, each: _Worker, message: Any) -> None:
        if message == READY:
            each.ready, self.failed_starts = True, 0
            return
        number, result = message
        if each.flight.pop(number, None) is not None:
            each.alone = False
            self.done(number, result)

    def _replace(self, each: _Worker) -> None:
        """A worker has died: jobs that it may have begun are done again, each by itself."""
        self.workers.remove(each)
        each.kill()
        if each.stopping:  # and let go of what it had not begun
            return
        if not each.ready:
            self.failed_starts += 1
            if self.failed_starts >= _FAILED_STARTS:
                problem = f"die when they start (exit code {each.process.exitcode})"
                raise InputError(
                    "worker-died", problem, "see if 'defocus render' works", path="worker processes"
                )
            if each.flight:
                self.returned.append(list(each.flight.items()))
            return
        for number, job in each.flight.items():
            self.strikes[number] += 1
            if self.strikes[number] < STRIKES:
                self.suspects.append((number, job))
                continue
            message = f"{job.picture.color}: {_death(each.process.exitcode, self.strikes[number])}"
            self.done(number, Failed("failed", "worker-died", message))


class _Worker:
    """A process, and the jobs that it has; the first of them wait until it has started."""

    def __init__(self, serve: Serve, chunk: Chunk) -> None:
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
        self.alone = False
        self.stopping = False
        self.send(chunk)

    def send(self, chunk: Chunk) -> None:
        """Give it jobs."""
        self.flight |= dict(chunk)
        with suppress(OSError):  # it is dead, which `_receive` sees
            for numbered in chunk:
                self.connection.send(numbered)

    def stop(self) -> None:
        """Let it end after the jobs that it has begun."""
        if not self.stopping:
            self.stopping = True
            with suppress(OSError):
                self.connection.send(None)

    def finish(self) -> None:
        """Let it end, as it has nothing to do."""
        if self.ready:
            self.stop()
            self.process.join(_GRACE)
        self.kill()

    def kill(self) -> None:
        """End it now."""
        self.connection.close()
        self.process.kill()
        self.process.join(_GRACE)


def _death(code: int | None, times: int) -> str:
    how = f"with exit code {code}"
    if code is not None and code < 0:
        with suppress(ValueError):
            how = f"by {signal.Signals(-code).name}"
    return f"{times} processes that worked on it died, the last {how}; see if it is damaged"


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
        if self.scheduler != "local":
            return execute_at(self.scheduler, threads=self.threads)

        def execute(chunks: Iterator[Chunk], done: Done, stopped: Callable[[], bool]) -> None:
            first = [*islice(chunks, 2)]
            if [len(chunk) for chunk in first] == [1]:  # a process takes longer to start than a job
                pipeline.execute(iter(first), done, stopped)
            elif first:
                Pool(self.count, chain(first, chunks), done, stopped).run()

        return execute


def computed_by(jobs: Sequence[Job], machine: Machine) -> list[Job]:
    """The jobs, done by a machine; quality stays, and tiles unless it has its own."""

    def adapted(own: Machine) -> Machine:
        tile = machine.tile or own.tile
        who = replace(own, device=machine.device, threads=machine.threads)
        return replace(who, memory=machine.memory, tile=tile)

    return [replace(job, machine=adapted(job.machine)) for job in jobs]


def _is_there(name: str) -> bool:
    return Path(name).exists()

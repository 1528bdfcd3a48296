"""Jobs on workers that may die, like processes on this machine.

Any of the jobs of a worker that dies (a crash in a decoder, lack of memory) may have killed it.
Each of them is done again after the other jobs, alone on its worker; a job fails after the death of
`Workers.strikes` workers. A process that dies is replaced if there is work.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import chain
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from defocus_core.batch.journal.record import End, Failed
from defocus_core.batch.workers import pipeline
from defocus_core.batch.workers.run import Chunk, Done
from defocus_core.errors import InputError
from defocus_core.picture import plain_path
from defocus_core.request.job import Job

if TYPE_CHECKING:
    from multiprocessing.context import SpawnProcess


class Lost(NamedTuple):
    """Jobs of a worker that died."""

    jobs: Chunk
    words: str = ""  # cause of its death; empty if it had begun none of them


class Workers(Protocol):
    """The workers for jobs: processes, or a cluster."""

    strikes: int  # workers that die before a job counts as failed
    apart: int  # jobs at a time that are done alone on a worker

    def has_room(self) -> bool:
        """Whether another chunk can be submitted."""

    def submit(self, chunk: Chunk) -> None:
        """Submit a chunk to a worker."""

    def collect(self) -> Iterator[tuple[int, End] | Lost]:
        """Wait a while for results, and for workers that died."""

    def stop(self) -> None:
        """Begin no further job."""

    def close(self) -> None:
        """End all workers."""


def dispatch(
    workers: Workers, chunks: Iterator[Chunk], done: Done, stopped: Callable[[], bool]
) -> None:
    """Do all jobs, unless stopped."""
    flight: dict[int, Job] = {}
    suspects: deque[tuple[int, Job]] = deque()
    strikes: Counter[int] = Counter()
    alone = False
    try:
        while True:
            while not stopped():
                chunk = next(chunks, None) if workers.has_room() else []
                if chunk is None and suspects and len(flight) < (workers.apart if alone else 1):
                    chunk, alone = [suspects.popleft()], True
                if not chunk:
                    break
                flight |= dict(chunk)
                workers.submit(chunk)
            if stopped():
                workers.stop()
            if not flight:
                return
            for told in workers.collect():
                if not isinstance(told, Lost):
                    number, end = told
                    if flight.pop(number, None) is not None:
                        done(number, end)
                    continue
                for number, _ in told.jobs:
                    del flight[number]
                if stopped():
                    continue
                if not told.words:
                    chunks = chain([told.jobs], chunks)
                for number, job in told.jobs if told.words else ():
                    strikes[number] += 1
                    if strikes[number] < workers.strikes:
                        suspects.append((number, job))
                        continue
                    died = told.words.format(times=strikes[number])
                    message = f"{job.picture.color}: {died}; see if it is damaged"
                    done(number, Failed("worker-died", message))
    finally:
        workers.close()


Serve = Callable[[Connection], None]
STRIKES = 3
AT_ONCE = 3  # jobs of a busy process: one is read, one rendered and one written
_FAILED_STARTS = 3  # processes that may die before they are ready
_GRACE = 10.0  # seconds to wait for the end of a process
_GLANCE = 0.1  # seconds between two checks for a stop
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
    """The received jobs; ``stopped`` is set to begin no further one.

    If the coordinator dies, this process ends at once: the next coordinator does the same jobs, and
    writes to the same files.
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
    """Processes for jobs; each starts with its first chunk."""

    strikes = STRIKES

    def __init__(self, processes: int, serve: Serve = serve) -> None:
        self.serve, self.apart = serve, processes
        self.workers: list[_Worker] = []
        self.failed_starts = 0

    def has_room(self) -> bool:
        """Whether another chunk can be submitted."""
        return len(self.workers) < self.apart or any(each.has_room for each in self.workers)

    def submit(self, chunk: Chunk) -> None:
        """Submit a chunk to an idle process, to a new one, or to one that will soon be idle."""
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
        if not (each.ready or each.stopping):
            self.failed_starts += 1
        if self.failed_starts >= _FAILED_STARTS:
            problem = f"die when they start (exit code {each.process.exitcode})"
            raise InputError(
                "worker-died", problem, "see if 'defocus render' works", path="worker processes"
            )
        return Lost([*each.flight.items()], _death(each.process.exitcode) if each.ready else "")

    def stop(self) -> None:
        """Begin no further job; processes that are not ready end."""
        for each in self.workers:
            each.stop()
            if not each.ready:
                each.process.kill()

    def close(self) -> None:
        """End all processes, at once those with jobs."""
        for each in self.workers:
            if each.ready and not each.flight:
                each.stop()
                each.process.join(_GRACE)
            each.kill()


class _Worker:
    """A process and its jobs, which wait until it has started."""

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
        """Whether it accepts another chunk."""
        return self.ready and not self.stopping and len(self.flight) < AT_ONCE

    def send(self, chunk: Chunk) -> None:
        """Send it jobs."""
        self.flight |= dict(chunk)
        with suppress(OSError):  # it is dead; `collect` handles it
            for numbered in chunk:
                self.connection.send(numbered)

    def stop(self) -> None:
        """End it after the begun jobs."""
        if not self.stopping:
            self.stopping = True
            with suppress(OSError):
                self.connection.send(None)

    def kill(self) -> None:
        """End it at once."""
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
    """Keep Ctrl-C from processes started in the block; the coordinator handles it."""
    resource_tracker.ensure_running()  # else the first process starts it and unblocks SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

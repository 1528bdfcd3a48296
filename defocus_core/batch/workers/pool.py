"""Execution of jobs by workers that may die, such as processes on this machine.

If a worker dies, any of its jobs may be the cause, as by a crash of a decoder or lack of memory.
These jobs are done again one by one, after all others. A job whose worker dies a second time has
failed. Dead processes are replaced if there is work left.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
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
    """The jobs that a worker had when it died."""

    jobs: Chunk
    words: str  # cause of its death


class Workers(Protocol):
    """What carries out jobs: several processes, or a cluster."""

    def has_room(self) -> bool:
        """Whether another chunk can be submitted."""

    def submit(self, chunk: Chunk) -> None:
        """Give a chunk, which is a list of numbered jobs of one picture, to a worker."""

    def collect(self) -> Iterator[tuple[int, End] | Lost]:
        """Wait a short time; yields results as (number, outcome), and jobs of workers that died."""

    def stop(self) -> None:
        """Begin no more jobs."""

    def close(self) -> None:
        """End all workers."""


def dispatch(
    workers: Workers, chunks: Iterator[Chunk], done: Done, stopped: Callable[[], bool]
) -> None:
    """Have workers do all jobs, until `stopped` returns True.

    ``done`` is called with the number and the outcome of each job.
    """
    flight: dict[int, Job] = {}
    suspects: deque[tuple[int, Job]] = deque()
    suspected = set[int]()
    try:
        while True:
            while not stopped():
                chunk = next(chunks, None) if workers.has_room() else []
                if chunk is None and suspects and not flight:
                    chunk = [suspects.popleft()]
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
                for number, job in told.jobs:
                    del flight[number]
                    if stopped():
                        continue
                    if number in suspected:
                        message = f"{job.picture.color}: {told.words}; see if it is damaged"
                        done(number, Failed("worker-died", message))
                    else:
                        suspected.add(number)
                        suspects.append((number, job))
    finally:
        workers.close()


Serve = Callable[[Connection], None]
AT_ONCE = 3  # jobs of a busy process: one is read, one rendered and one written
_GRACE = 10.0  # seconds to wait for the end of a process
_GLANCE = 0.1  # seconds between two checks for a stop
READY = "ready"


def serve(connection: Connection) -> None:
    """Do the jobs that a connection receives, and send their results; never returns."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    stopped = threading.Event()
    jobs = _received(connection, stopped)
    plain_path.load()

    connection.send(READY)
    pipeline.run(jobs, lambda *ended: connection.send(ended), stopped=stopped.is_set)
    connection.close()
    os._exit(0)  # all results are sent; PyTorch would take a second to end


def _received(connection: Connection, stopped: threading.Event) -> Iterator[tuple[int, Job]]:
    """Iterate over numbered jobs that are received; ``stopped`` is set to begin no more of them.

    If the process that sends jobs dies, this process exits, as a later run would do the same jobs
    and write to the same files.
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
    """Worker processes. Each is started when there is a chunk for it, up to a maximum."""

    def __init__(self, processes: int, serve: Serve = serve) -> None:
        self.serve, self.maximum = serve, processes
        self.workers: list[_Worker] = []

    def has_room(self) -> bool:
        """Whether another chunk can be submitted."""
        return len(self.workers) < self.maximum or any(each.has_room for each in self.workers)

    def submit(self, chunk: Chunk) -> None:
        """Give a chunk to an idle process, else to a new one, else to the least busy one."""
        ready = [each for each in self.workers if each.has_room]
        least = min(ready, key=lambda each: len(each.flight), default=None)
        if least is None or (least.flight and len(self.workers) < self.maximum):
            self.workers.append(least := _Worker(self.serve))
        least.send(chunk)

    def collect(self) -> Iterator[tuple[int, End] | Lost]:
        """Wait a short time; yields results as (number, outcome), and jobs of dead processes."""
        handles: dict[Any, _Worker] = {each.connection: each for each in self.workers}
        handles |= {each.process.sentinel: each for each in self.workers}
        for each in dict.fromkeys(handles[handle] for handle in wait(list(handles), _GLANCE)):
            try:
                while each.connection.poll():
                    message = each.connection.recv()
                    if message == READY:
                        each.ready = True
                    else:
                        each.flight.pop(message[0], None)
                        yield message
            except (EOFError, OSError):
                yield self._lost(each)

    def _lost(self, each: _Worker) -> Lost:
        self.workers.remove(each)
        each.kill()
        code = each.process.exitcode
        if not (each.ready or each.stopping):
            problem = f"die when they start (exit code {code})"
            remedy = "see if 'defocus render' works"
            raise InputError("worker-died", problem, remedy, path="worker processes")
        how = f"with exit code {code}"
        if code is not None and code < 0:
            with suppress(ValueError):
                how = f"by {signal.Signals(-code).name}"
        words = f"2 processes that worked on it died, the last {how}"
        return Lost([*each.flight.items()], words)

    def stop(self) -> None:
        """Begin no more jobs; processes that are still starting are killed."""
        for each in self.workers:
            each.stop()
            if not each.ready:
                each.process.kill()

    def close(self) -> None:
        """End all processes; those with jobs are killed."""
        for each in self.workers:
            if each.ready and not each.flight:
                each.stop()
                each.process.join(_GRACE)
            each.kill()


class _Worker:
    """A process with the jobs sent to it, which wait until it has started."""

    def __init__(self, serve: Serve) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process: SpawnProcess = context.Process(
            target=serve, args=(theirs,), daemon=True, name="defocus-worker"
        )
        resource_tracker.ensure_running()  # else the first process starts it and unblocks SIGINT
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # we handle Ctrl-C
        try:
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self.flight: dict[int, Job] = {}
        self.ready = False
        self.stopping = False

    @property
    def has_room(self) -> bool:
        return self.ready and not self.stopping and len(self.flight) < AT_ONCE

    def send(self, chunk: Chunk) -> None:
        self.flight |= dict(chunk)
        with suppress(OSError):  # it is dead; `collect` handles it
            for numbered in chunk:
                self.connection.send(numbered)

    def stop(self) -> None:
        """Let the process end after the jobs that it has begun."""
        if not self.stopping:
            self.stopping = True
            with suppress(OSError):
                self.connection.send(None)

    def kill(self) -> None:
        self.connection.close()
        self.process.kill()
        self.process.join(_GRACE)

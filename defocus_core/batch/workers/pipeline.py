"""Jobs in this process, as a pipeline: read the next picture, render this one, write the last one.

Each picture is computed while the next one is decoded and the one before is encoded, as far as
memory allows. At most one picture waits to be computed and one to be written, whatever the number
of jobs.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, islice
from queue import SimpleQueue
from typing import TYPE_CHECKING

from defocus_core.batch.jobs.job import Job
from defocus_core.batch.journal.journal import Record
from defocus_core.batch.workers import job_result
from defocus_core.batch.workers.job_result import TileCount
from defocus_core.batch.workers.plan import Chunk, Done, Execute
from defocus_core.picture import plain_path
from defocus_core.picture.memory_budget import Gate
from defocus_core.picture.take import Inputs, Take
from defocus_core.system.interrupts import delayed_signals
from defocus_core.system.process import settings_kept

if TYPE_CHECKING:
    _Read = tuple[int, Job, Inputs | Record]


def execute(chunks: Iterator[Chunk], done: Done, stopped: Callable[[], bool]) -> None:
    """Do the jobs of a batch in this process, whose settings stay; one alone without threads."""
    plain_path.load()
    jobs = _jobs(chunks, stopped)
    first = [*islice(jobs, 2)]
    with settings_kept():
        if len(first) > 1:
            run(chain(first, jobs), done, stopped=stopped)
        for number, job in first if len(first) == 1 else ():
            _carry_out(number, job, done)


def execute_alone(progress: TileCount | None) -> Execute:
    """An executor of a lone job, which raises the error that ends the job."""

    def execute(chunks: Iterator[Chunk], done: Done, stopped: Callable[[], bool]) -> None:
        def done_or_raised(number: int, record: Record) -> None:
            if "error" in record:
                raise record["error"]
            done(number, record)

        plain_path.load()
        for number, job in _jobs(chunks, stopped):
            _carry_out(number, job, done_or_raised, progress)

    return execute


def _carry_out(number: int, job: Job, done: Done, progress: TileCount | None = None) -> None:
    """Do a job."""
    take = job_result.compute(job, job_result.Reader().read(job), progress)
    with delayed_signals():  # nothing stays half-written, or written and not told
        done(number, job_result.write(take))


def _jobs(chunks: Iterator[Chunk], stopped: Callable[[], bool]) -> Iterator[tuple[int, Job]]:
    for chunk in chunks:
        for numbered in chunk:
            if stopped():
                return
            yield numbered


def run(
    jobs: Iterable[tuple[int, Job]],
    done: Done,
    stopped: Callable[[], bool] = lambda: False,
) -> None:
    """Do jobs in their order.

    `jobs`: numbered; asked for the next one, on a thread of its own, before the last is done.
    `done`: called with number and record of each as soon as it is durable, on another thread or on
    this one, one at a time.
    """
    gate = Gate()
    ahead, behind = _Ahead(jobs, gate), _Writer(done, gate)
    try:
        for number, job, inputs in ahead:
            if stopped():
                break
            behind.put(number, job_result.compute(job, inputs))
    finally:
        try:
            ahead.stop()
        finally:
            behind.close()
    behind.check()


class _Ahead:
    """Jobs whose inputs are decoded, one of them before it is asked for."""

    def __init__(self, jobs: Iterable[tuple[int, Job]], gate: Gate) -> None:
        self._jobs, self._gate = jobs, gate
        self._room = threading.Semaphore(1)
        self._queue: SimpleQueue[_Read | BaseException | None] = SimpleQueue()
        self._decoding = threading.Lock()
        self._stopped = False
        threading.Thread(target=self._read, name="reader", daemon=True).start()

    def __iter__(self) -> Iterator[_Read]:
        while (item := self._queue.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            self._room.release()
            yield item

    def stop(self) -> None:
        """Read nothing more, and wait for what is being decoded.

        A decoder written in C that outlives Python aborts the process.
        """
        self._stopped = True
        self._room.release()
        self._gate.open()
        with self._decoding:
            pass

    def _read(self) -> None:
        reader = job_result.Reader()
        try:
            for number, job in self._jobs:
                self._room.acquire()
                self._gate.enter(number, job)
                with self._decoding:
                    if self._stopped:
                        return
                    inputs = reader.read(job)
                self._queue.put((number, job, inputs))
                del inputs
        except BaseException as error:
            self._queue.put(error)
        finally:
            self._queue.put(None)


class _Writer:
    """Writes what is computed, on a thread; whoever brings the next waits for it."""

    def __init__(self, done: Done, gate: Gate) -> None:
        self._done, self._gate = done, gate
        self._room = threading.Semaphore(1)
        self._queue: SimpleQueue[tuple[int, Take | Record] | None] = SimpleQueue()
        self._error: BaseException | None = None
        self._ended = threading.Event()  # a join that a signal interrupts cannot be tried again
        threading.Thread(target=self._write, name="writer", daemon=True).start()

    def put(self, number: int, take: Take | Record) -> None:
        self._room.acquire()
        self.check()
        self._queue.put((number, take))

    def check(self) -> None:
        """Raise what ``done`` raised."""
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """Wait until all is written, even if a signal comes meanwhile: nothing stays half-written.

        A second signal ends the waiting.
        """
        self._queue.put(None)
        try:
            self._ended.wait()
        except BaseException:
            self._ended.wait()
            raise

    def _write(self) -> None:
        while (item := self._queue.get()) is not None:
            number, take = item
            try:
                record = job_result.write(take)
                del take, item
                self._done(number, record)
            except BaseException as error:
                self._error = error
            finally:
                self._gate.leave(number)
                self._room.release()
        self._ended.set()

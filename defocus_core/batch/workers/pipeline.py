"""Jobs in this process, as a pipeline: read the next picture, render this one, write the last one.

Each picture is computed while the next one is decoded and the one before is encoded, as far as
memory allows. At most one picture waits to be computed and one to be written, whatever the number
of jobs. Small pictures are read, rendered and written in turn: threads would only wait for each
other.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from itertools import chain, islice
from typing import TYPE_CHECKING

from defocus_core.batch.journal.record import Failed
from defocus_core.batch.workers import job_result
from defocus_core.batch.workers.job_result import TileCount
from defocus_core.batch.workers.plan import Chunk, Done
from defocus_core.picture import plain_path
from defocus_core.picture.memory_budget import Gate
from defocus_core.picture.take import Inputs, Take
from defocus_core.request.job import Job
from defocus_core.system.interrupts import delayed_signals
from defocus_core.system.process import settings_kept

# Pixels up to which a picture is small.
_SMALL = 1 << 16

if TYPE_CHECKING:
    _Read = tuple[int, Job, Inputs | Failed]


def execute(
    chunks: Iterator[Chunk],
    done: Done,
    stopped: Callable[[], bool],
    progress: TileCount | None = None,
) -> None:
    """Do the jobs of a batch in this process, whose settings stay; one alone without threads.

    `progress`: called with the tiles of a lone job that are done, and with all.
    """
    plain_path.load()
    jobs = _jobs(chunks, stopped)
    first = [*islice(jobs, 2)]
    with settings_kept():
        if len(first) > 1:
            run(chain(first, jobs), done, stopped=stopped)
        for number, job in first if len(first) == 1 else ():
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
    `done`: called with number and end of each as soon as it is durable, on another thread or on
    this one, one at a time.
    """
    gate, reader, numbered = Gate(), job_result.Reader(), iter(jobs)
    decoding, ended = threading.Lock(), threading.Event()

    def read() -> _Read | None:
        for number, job in numbered:
            gate.enter(number, job)
            with decoding:
                return None if ended.is_set() else (number, job, reader.read(job))
        return None

    def write(number: int, take: Take | Failed) -> None:
        try:
            done(number, job_result.write(take))
        finally:
            gate.leave(number)

    ahead, behind = ThreadPoolExecutor(1, "reader"), ThreadPoolExecutor(1, "writer")
    behind.submit(int).result()  # a pool loses a thread that a signal interrupts in its start
    following: Callable[[], _Read | None] = ahead.submit(read).result
    last: Future[None] | None = None
    try:
        while (item := following()) is not None:
            number, job, inputs = item
            is_small = isinstance(inputs, Inputs) and math.prod(inputs.color.shape[:2]) <= _SMALL
            following = read if is_small else ahead.submit(read).result
            if stopped():
                break
            take = job_result.compute(job, inputs)
            del item, inputs
            if last is not None:
                last.result()
            if is_small:
                with delayed_signals():
                    write(number, take)
                last = None
            else:
                last = behind.submit(write, number, take)
            del take
    finally:
        ended.set()
        gate.open()
        try:
            with decoding:  # a decoder written in C that outlives Python aborts the process
                ahead.shutdown(wait=False)
        finally:
            _wait_for(behind.submit(int))  # comes after what is being written
            behind.shutdown(wait=False)
    if last is not None:
        last.result()


def _wait_for(end: Future[int]) -> None:
    """Wait even if a signal comes meanwhile: nothing stays half-written; a second one ends it."""
    try:
        wait([end])
    except BaseException:
        wait([end])
        raise

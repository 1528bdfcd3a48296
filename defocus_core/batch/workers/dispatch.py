"""Chunks of jobs given to workers that may die, until all jobs have ended.

A worker that dies (a crash in a decoder, the system short of memory) may have been killed by any of
the jobs that it had. Each of them is done again when the others have ended, with no other job
beside it where it is; one that has seen so many workers die as `Workers.strikes` has failed.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator
from itertools import chain
from typing import NamedTuple, Protocol

from defocus_core.batch.journal.record import End, Failed
from defocus_core.batch.workers.plan import Chunk, Done
from defocus_core.request.job import Job


class Lost(NamedTuple):
    """Jobs of a worker that died."""

    jobs: Chunk
    words: str = ""  # how it died; empty if it had begun none of them


class Workers(Protocol):
    """Those who do jobs: processes, or a cluster."""

    strikes: int  # workers that a job may kill before it has failed
    apart: int  # jobs at a time that have no other job beside them

    def has_room(self) -> bool:
        """Whether another chunk can be submitted."""

    def submit(self, chunk: Chunk) -> None:
        """Give a worker a chunk."""

    def collect(self) -> Iterator[tuple[int, End] | Lost]:
        """Wait a while for results, and for workers that died."""

    def stop(self) -> None:
        """Begin no further job."""

    def close(self) -> None:
        """End all workers."""


def dispatch(
    workers: Workers, chunks: Iterator[Chunk], done: Done, stopped: Callable[[], bool]
) -> None:
    """Do all jobs, or until stopped."""
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
                    done(number, Failed("failed", "worker-died", message))
    finally:
        workers.close()

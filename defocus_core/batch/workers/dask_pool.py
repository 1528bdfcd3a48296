"""Execution of jobs on the workers of a Dask scheduler.

Jobs and results are small, as workers read and write pictures themselves. So all machines must see
the same files at the same paths. A worker therefore checks that OUT has the lock file of this run,
and this process checks that the first file of each worker appears in OUT. Dask may do a job twice,
which is harmless: files are replaced as a whole, and only this process writes the journal.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Any

from defocus_core.batch.journal import resume, runs
from defocus_core.batch.journal.record import Completed, End
from defocus_core.batch.workers import pipeline
from defocus_core.batch.workers.pool import Lost, dispatch
from defocus_core.batch.workers.run import Chunk, Done, Execute
from defocus_core.errors import InputError, UsageProblem, reason
from defocus_core.request.job import Job
from defocus_core.system.text import note

AT_ONCE = 2  # chunks per worker: one computed, one waiting at the worker
CONNECT = "30s"
SEEN = 60.0  # seconds until a file of a worker is seen: NFS refreshes folders that often


def execute_at(address: str, *, threads: int | None) -> Execute:
    """Return a function that does jobs on a Dask scheduler; each job uses `threads`, 1 if None."""
    if "://" not in address:
        problem = f"'{address}' is not a scheduler"
        remedy = "use local, or one like tcp://head:8786"
        raise UsageProblem("malformed", problem, remedy, field="scheduler")
    if find_spec("distributed") is None:
        problem, remedy = "needs Dask, which is not installed", "run: pip install 'defocus[dask]'"
        raise UsageProblem("needs-extra", problem, remedy, field="scheduler")

    def execute(chunks: Iterator[Chunk], done: Done, stopped: Callable[[], bool]) -> None:
        import distributed

        # Its client would log each worker that dies; the journal has the outcome of the jobs.
        logging.getLogger("distributed.client").setLevel(logging.ERROR)
        make_client: Any = distributed.Client  # without types
        make_completed: Any = distributed.as_completed

        try:
            client = make_client(address, timeout=CONNECT)
        except (OSError, TimeoutError, ValueError) as error:
            problem = f"no Dask scheduler answers: {reason(error)}"
            remedy = "start one, or check the address"
            raise InputError("unreachable", problem, remedy, path=address) from None
        with client:
            dispatch(_Cluster(client, make_completed(), threads), chunks, done, stopped)

    return execute


class _Cluster:
    """The workers of a Dask scheduler, which may die.

    When a worker dies, all chunks that it had are reported as lost, even those not begun.
    """

    def __init__(self, client: Any, futures: Any, threads: int | None) -> None:
        self.client, self.futures, self.threads = client, futures, threads
        self.address = client.scheduler.address
        self.flight: dict[Any, Chunk] = {}
        self.serial = count()  # a failed name cannot be used again
        self.trusted = set[str]()  # workers whose files this process has seen

    def has_room(self) -> bool:
        workers = len(self.client.scheduler_info(n_workers=-1)["workers"])
        if not workers and not self.flight:
            note(f"{self.address}: has no workers; waiting for some")
        return len(self.flight) < AT_ONCE * max(1, workers)

    def submit(self, chunk: Chunk) -> None:
        job = chunk[0][1]
        key = f"{job.sample_id}-{resume.recipe(job)}-{next(self.serial)}"
        jobs = [_absolute(job) for _, job in chunk]
        future = self.client.submit(
            do, jobs, self.threads or 1, runs.own_words(), key=key, pure=False
        )
        self.flight[future] = chunk
        self.futures.add(future)

    def collect(self) -> Iterator[tuple[int, End] | Lost]:
        """Wait for a chunk to end; yields its results, or `Lost` if its workers died."""
        future = next(self.futures)
        chunk = self.flight.pop(future)
        if future.cancelled():  # not by us
            problem = "the Dask scheduler went away"
            remedy = "start it again, and run the same command to go on"
            raise InputError("unreachable", problem, remedy, path=self.address)
        error = future.exception()
        if error is None:
            answer, own = future.result(), resume.versions()
            if answer["versions"] != own:
                both = (answer["versions"], own)
                remote, local = ("{version}, renderer {renderer}".format(**it) for it in both)
                raise self._unlike(f"its workers have defocus {remote}, but here is {local}")
            self._require_shared(chunk[0][1].outputs.root, answer)
            yield from zip((number for number, _ in chunk), answer["results"], strict=True)
        elif type(error).__name__ == "KilledWorker":
            yield Lost(chunk, "several Dask workers that worked on it died")
        else:
            words = f"{type(error).__name__}: {reason(error)}"
            raise self._unlike(f"its workers cannot do jobs: {words}")

    def _require_shared(self, root: Path, answer: dict[str, Any]) -> None:
        """Raise InputError if a worker does not write to the same output folder as this process."""
        worker, results = answer["worker"], answer["results"]
        if worker in self.trusted and results:
            return
        written = (end.outputs for end in results if isinstance(end, Completed))
        path = next((stamp.path for outputs in written for stamp in outputs.values()), None)
        if not results or (path and not _is_seen(root / path)):
            problem = f"is another folder on the Dask worker {worker}"
            remedy = "name one that all workers share, under the same path"
            raise InputError("not-found", problem, remedy, path=root)
        if path:
            self.trusted.add(worker)

    def stop(self) -> None:
        """Do nothing, as submitted chunks are finished in any case."""

    def close(self) -> None:
        self.client.cancel(list(self.flight))

    def _unlike(self, problem: str) -> InputError:
        remedy = "install the same defocus on all of them"
        return InputError("other-version", problem, remedy, path=self.address)


def do(jobs: list[Job], threads: int, leader: str) -> dict[str, Any]:
    """Do jobs on a Dask worker; returns versions, results and the name of the worker.

    Without a lock file of the process `leader` in the output folder, there are no results.
    """
    from distributed import get_worker

    here = (replace(each, machine=replace(each.machine, threads=threads)) for each in jobs)
    results = list[End]()
    if runs.is_held_by(jobs[0].outputs.root, leader):
        pipeline.run(enumerate(here), lambda _, end: results.append(end))
    worker: str = get_worker().address
    return {"versions": resume.versions(), "results": results, "worker": worker}


def _is_seen(path: Path) -> bool:
    """Wait until a file that another machine has written appears here; False if it does not."""
    end = time.monotonic() + SEEN
    while path.name not in (os.listdir(path.parent) if path.parent.is_dir() else ()):  # noqa: PTH208
        if time.monotonic() > end:
            return False
        time.sleep(min(1.0, SEEN / 10))
    return True


def _absolute(value: Any) -> Any:
    """A job, or a value in it, with all paths made absolute."""
    if isinstance(value, Path):
        return value.absolute()
    if isinstance(value, tuple) and not hasattr(value, "_fields"):
        return tuple(map(_absolute, value))
    if not is_dataclass(value) or isinstance(value, type):
        return value
    parts = {each.name: getattr(value, each.name) for each in fields(value)}
    changed = {name: new for name, it in parts.items() if (new := _absolute(it)) is not it}
    return replace(value, **changed) if changed else value

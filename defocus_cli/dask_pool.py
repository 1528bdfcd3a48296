"""Does the jobs of a batch on the workers of a Dask scheduler.

Jobs go as plain dictionaries and come back as small ones; pictures are read and written where they
are computed, so every worker has to see the same files under the same names. Dask may do a job
twice, which changes nothing: outputs are written whole, and only this process writes the journal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

from defocus_cli import identity, work
from defocus_cli.errors import InputError, UsageProblem, reason
from defocus_cli.how import Chunk, Done
from defocus_cli.job import Job, Picture
from defocus_cli.plain import plain, typed
from defocus_cli.work import Result, failed

AT_ONCE = 3  # chunks for each worker: one is computed, two wait where it is
_CONNECT = "30s"


def execute_at(address: str, *, threads: int | None) -> Callable[..., None]:
    """What does jobs on a scheduler; a job computes with ``threads``, or those its worker has.

    Raises:
        UsageProblem: Dask is not installed, or the address is none.
    """
    if "://" not in address:
        problem = f"'{address}' is no scheduler"
        raise UsageProblem("--scheduler", problem, "use local, or an address like tcp://head:8786")
    if find_spec("distributed") is None:
        problem = "needs Dask, which is not installed"
        raise UsageProblem("--scheduler", problem, "run: pip install 'defocus[dask]'")

    def execute(chunks: Iterator[Chunk], done: Done, stopped: Callable[[], bool]) -> None:
        import distributed

        make_client: Any = distributed.Client  # without types

        try:
            client = make_client(address, timeout=_CONNECT, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            problem = f"no Dask scheduler answers: {reason(error)}"
            raise InputError(address, problem, "start one, or check the address") from None
        with client:
            _Submitted(client, chunks, done, stopped, threads).run()

    return execute


class _Submitted:
    """Chunks on their way."""

    def __init__(
        self,
        client: Any,
        chunks: Iterator[Chunk],
        done: Done,
        stopped: Callable[[], bool],
        threads: int | None,
    ) -> None:
        self.client, self.chunks, self.done, self.stopped = client, chunks, done, stopped
        self.threads = threads
        self.flight: dict[Any, Chunk] = {}
        self.again: list[Chunk] = []

    def run(self) -> None:
        """Do all jobs, or until stopped."""
        import distributed

        make: Any = distributed.as_completed  # without types
        completed = make()
        try:
            self._submit(completed)
            while self.flight:
                future = next(completed)
                self._take(future, self.flight.pop(future))
                self._submit(completed)
        finally:
            self.client.cancel(list(self.flight))

    def _submit(self, completed: Any) -> None:
        room = AT_ONCE * max(1, len(self.client.scheduler_info(n_workers=-1)["workers"]))
        while len(self.flight) < room and not self.stopped():
            chunk = self.again.pop() if self.again else next(self.chunks, None)
            if chunk is None:
                return
            number, job = chunk[0]
            key = f"{job.sample_id}-{identity.recipe(job)}-{number}-{len(chunk)}"
            sent = [plain(_absolute(job)) for _, job in chunk]
            future = self.client.submit(do, sent, self.threads, key=key, pure=False)
            self.flight[future] = chunk
            completed.add(future)

    def _take(self, future: Any, chunk: Chunk) -> None:
        """Hand on what came of a chunk."""
        error = future.exception()
        if error is None:
            for (number, _), result in zip(chunk, future.result(), strict=True):
                self.done(number, result)
        elif len(chunk) > 1:  # one of them kills workers: see which
            self.again += [[numbered] for numbered in chunk]
        else:
            number, job = chunk[0]
            self.done(number, failed("failed", "worker-died", _death(job, error), {}))


def do(jobs: list[dict[str, Any]], threads: int | None) -> list[Result]:
    """Do jobs of one picture, on a worker."""
    reader, results = work.Reader(), []
    for sent in jobs:
        job = typed(Job, sent)
        job = replace(job, machine=replace(job.machine, threads=threads or _own_threads()))
        ready = reader.read(job)
        computed = ready.result or work.compute(ready)
        result = work.write(computed) if isinstance(computed, work.Computed) else computed
        results.append({key: value for key, value in result.items() if key != "error"})
    return results


def _own_threads() -> int:
    """What a worker may use; it may do several jobs at once, which share the cores."""
    from defocus_cli.options import cores

    try:
        from distributed import get_worker

        return max(1, cores() // max(1, int(get_worker().state.nthreads)))
    except (ImportError, ValueError):
        return cores()


def _absolute(job: Job) -> Job:
    """The job with paths that do not depend on where we are."""
    return replace(
        job,
        picture=_absolute_picture(job.picture),
        outputs=replace(job.outputs, root=job.outputs.root.absolute()),
    )


def _absolute_picture(picture: Picture) -> Picture:
    hidden = picture.hidden and _absolute_picture(picture.hidden)
    return replace(
        picture, color=picture.color.absolute(), depth=picture.depth.absolute(), hidden=hidden
    )


def _death(job: Job, error: BaseException) -> str:
    return (
        f"{job.picture.color}: its Dask workers died: {type(error).__name__}; see if it is damaged"
    )

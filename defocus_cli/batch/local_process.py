"""Jobs of a batch in this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from defocus_cli.batch import pipeline
from defocus_cli.batch.execution import Chunk, Done
from defocus_cli.batch.job_result import Result, TileCount
from defocus_cli.jobs.job import Job
from defocus_cli.rendering import job_steps


def execute_alone(progress: TileCount | None) -> Callable[..., None]:
    """What does a lone job, and raises the error that ends it.

    Args:
        progress: called with (tiles done, tiles in all) while it renders.
    """

    def execute(chunks: Iterator[Chunk], done: Done, stopped: Callable[[], bool]) -> None:
        def done_or_raised(number: int, result: Result) -> None:
            if "error" in result:
                raise result["error"]
            done(number, result)

        job_steps.load()
        pipeline.run(_jobs(chunks, stopped), done_or_raised, progress, stopped)

    return execute


def execute(chunks: Iterator[Chunk], done: Done, stopped: Callable[[], bool]) -> None:
    """Do jobs, each rendered while the next is read and the one before is written."""
    job_steps.load()
    pipeline.run(_jobs(chunks, stopped), done, stopped=stopped)


def _jobs(chunks: Iterator[Chunk], stopped: Callable[[], bool]) -> Iterator[tuple[int, Job]]:
    for chunk in chunks:
        for numbered in chunk:
            if stopped():
                return
            yield numbered

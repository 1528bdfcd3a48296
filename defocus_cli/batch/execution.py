"""Settings of a batch run: the executor, the shard, limits, and when a job counts as done."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from defocus_cli.batch.job_result import Result
from defocus_cli.jobs.job import Job
from defocus_cli.journal.journal import Shard

Chunk = list[tuple[int, Job]]
Done = Callable[[int, Result], None]
Execute = Callable[[Iterator[Chunk], Done, Callable[[], bool]], None]


@dataclass(frozen=True)
class How:
    """How a batch is to be carried out.

    Attributes:
        execute: does jobs; given chunks of them, each of one picture, what to call with the number
            and result of each job, and what tells that no further job is to be begun.
        shard: which part of the batch; None for all of it.
        limit: at most so many jobs.
        fail_fast: stop at the first job that fails.
        read_inputs: compare the bytes of inputs, not only their size and time.
        again: do jobs whatever the journal says of them.
        spread: over how many workers the jobs of one picture are to be spread.
    """

    execute: Execute
    shard: Shard | None = None
    limit: int | None = None
    fail_fast: bool = False
    read_inputs: bool = False
    again: bool = False
    spread: int = 1

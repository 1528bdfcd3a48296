"""The plan of a batch: how its jobs are done, which are done already, and which are left to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from defocus_core.batch.jobs.job import Job
from defocus_core.batch.jobs.splits import with_recorded
from defocus_core.batch.journal import identity, run_file
from defocus_core.batch.journal.journal import Record, Shard, read_all
from defocus_core.batch.journal.ledger import Ledger
from defocus_core.batch.workers.output_checks import (
    own_without_record,
    refuse_misplaced,
    refuse_unknown,
)
from defocus_core.system.memory import without_collections

Chunk = list[tuple[int, Job]]  # jobs of one picture, with their numbers
Done = Callable[[int, Record], None]
Execute = Callable[[Iterator[Chunk], Done, Callable[[], bool]], None]


@dataclass(frozen=True)
class Execution:
    """The way to carry out a batch."""

    # Does jobs; called with chunks of them, with the function to call with the number and
    # record of each job, and with the function that tells that no further job is to be begun
    execute: Execute
    shard: Shard | None = None  # which part of the batch; None for all of it
    limit: int | None = None  # at most so many jobs
    fail_fast: bool = False  # stop at the first job that fails
    read_inputs: bool = False  # compare the bytes of inputs, not only their size and time
    again: bool = False  # do jobs even if the journal has them as done
    keep_lenses: bool = False  # refuse to replace pictures of another lens or view
    spread: int = 1  # over how many workers the jobs of one picture are to be spread


@dataclass(frozen=True)
class Plan:
    """The jobs of a batch, sorted."""

    todo: list[tuple[Job, str]]  # jobs to do, and the recipe of each
    # Jobs that are done, or rejected, each with its record of the journal
    settled: list[tuple[Job, Record]]
    # Records to append anew, since their inputs lie elsewhere now, or their split changed
    moved: list[Record]
    beyond: int  # how many jobs the limit puts off
    # How many of ``todo`` were done, but with other inputs or settings, or have outputs that
    # are no longer as they were
    changed: int
    files: list[list[str]]  # the outputs of each job to do, now or later, relative to OUT
    # By number in ``todo``, path and stamp of previews of the pictures that a job replaces
    # without a preview of its own
    previews: dict[int, dict[str, identity.Stamp]]
    unknown: set[str]  # files that runs which did not end have written, and that no journal knows


@without_collections()
def make_plan(jobs: Sequence[Job], out: Path, execution: Execution) -> Plan:
    """Sort the jobs of a batch into those that are done and those that are to do."""
    refuse_misplaced(jobs)
    ledger = Ledger(out, read_all(out))
    todo: list[tuple[Job, str]] = []
    settled: list[tuple[Job, Record]] = []
    changed = 0
    forced = execution.again or any(job.outputs.overwrite for job in jobs)
    jobs = with_recorded(jobs, {} if forced else ledger.splits())
    for job in jobs if execution.shard is None else _part(jobs, execution.shard):
        recipe = identity.recipe(job)
        record = None
        if not forced:
            record = ledger.settled(job, recipe=recipe, read_inputs=execution.read_inputs)
        if record is not None:
            settled.append((job, record))
            continue
        todo.append((job, recipe))
        changed += not forced and any(name in ledger.files for name in job.names.values())
    moved = [record for _, record in settled if not ledger.has(record)]
    now = todo if execution.limit is None else todo[: execution.limit]
    ledger.refuse_other_pictures(job for job, _ in todo)
    if execution.keep_lenses:
        ledger.refuse_other_lenses(job for job, _ in todo)
    known = ledger.files | run_file.planned_files(out)
    jobs_to_do = [job for job, _ in todo]
    refuse_unknown(jobs_to_do, known | own_without_record(jobs_to_do, out, known))
    planned = run_file.planned_files(out, execution.shard) - ledger.files
    unknown = {name for name in planned if (out / name).exists()}
    previews = {
        number: stamps
        for number, (job, _) in enumerate(now)
        if (stamps := ledger.previews_replaced(job))
    }
    files = [list(job.names.values()) for job, _ in todo]
    return Plan(now, settled, moved, len(todo) - len(now), changed, files, previews, unknown)


def _part(jobs: Sequence[Job], shard: Shard) -> list[Job]:
    """The jobs of a shard: every n-th picture, with all its lenses.

    Where there are fewer pictures than shards, it is every n-th job: a scene that is taken by many
    lenses is shared out, too.
    """
    places: list[int] = []
    picture = None
    for job in jobs:
        places.append((places[-1] + (job.picture != picture)) if places else 0)
        picture = job.picture
    if places and places[-1] + 1 < shard.of:
        places = list(range(len(places)))
    mine = (place % shard.of == shard.number - 1 for place in places)
    return [job for job, is_mine in zip(jobs, mine, strict=True) if is_mine]

"""A batch run: skips finished jobs, does the others, and writes each result to the journal.

This is the one path of `defocus render`, `batch` and `retry`. Only this process writes the journal.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from defocus_core.batch.datasets import update
from defocus_core.batch.journal import identity, run_file
from defocus_core.batch.journal.journal import Journal, Record, input_path, journal_path, read_all
from defocus_core.batch.journal.lock import Check, locked
from defocus_core.batch.journal.run_file import RunPlan
from defocus_core.batch.workers.job_result import TRANSIENT
from defocus_core.batch.workers.plan import (
    Chunk,
    Execute,
    Execution,
    Plan,
    make_plan,
    refuse_misplaced,
    refuse_unknown,
    refuse_unwritable,
)
from defocus_core.errors import InputError, NoteKinds
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import unwritable
from defocus_core.request.job import Job, Outputs
from defocus_core.system.interrupts import Interrupts

MAX_IN_A_CHUNK = 8


class NoSpace(InputError):  # noqa: N818 - no mistake
    """Nothing more can be written."""


class Listener(Protocol):
    """Receives the events of a batch."""

    def planned(self, plan: Plan) -> None:
        """Before the first job is done."""

    def ended(self, job: Job, record: Record) -> None:
        """A job has come to its end, and the journal has it, but for what stands `TRANSIENT`."""


@dataclass
class Summary:
    """The result of a batch: jobs by status, without those that were done before."""

    jobs: int
    skipped: int
    left: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    warned: int = 0
    warnings: NoteKinds = field(default_factory=NoteKinds)
    seconds: float = 0.0
    interrupted: bool = False
    withdrawn: set[str] = field(default_factory=set)  # samples taken out of the index of OUT
    unchanged: set[str] | None = None  # names of all samples, if they were done before


def carry_out(jobs: Sequence[Job], out: Path, execution: Execution, listener: Listener) -> Summary:
    """Do jobs that write to OUT."""
    with (
        _output_folders({job.outputs for job in jobs}, out),
        locked(out, execution.shard) as require_lock,
    ):
        return _carried_out(jobs, out, execution, listener, require_lock)


def write_alone(job: Job, execute: Execute, listener: Listener) -> Summary:
    """Do a job of one file, beside which no journal stands; it may replace one of the same kind."""
    refuse_misplaced([job])
    from defocus_core.io.images.encode import is_own

    own = [name for name in job.names.values() if is_own(job.outputs.root / name)]
    refuse_unknown([job], known=own)
    out, summary = job.outputs.root, Summary(1, 0, 1)

    def done(_: int, record: Record) -> None:
        summary.left = 0
        summary.statuses[record["status"]] += 1
        transient = {key: record[key] for key in TRANSIENT if key in record}
        listener.ended(job, {**completed(record, job, identity.recipe(job), out), **transient})

    with _output_folders({job.outputs}, out), Interrupts(patient=False) as interrupts:
        execute(iter([[(0, job)]]), done, lambda: interrupts.asked)
    summary.interrupted = interrupts.asked
    return summary


@contextmanager
def _output_folders(every: Collection[Outputs], out: Path) -> Iterator[None]:
    """OUT exists in the block; folders that were not there, and are empty at its end, are not."""
    for outputs in every:
        refuse_unwritable(outputs)
    folders = {folder for outputs in every for folder in outputs.folders} - {out}
    new = [f for f in (*folders, out, *out.absolute().parents) if not f.exists()]
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(out, error) from error
    try:
        yield
    finally:
        for folder in new:
            with suppress(OSError):  # it holds a file, or does not exist
                folder.rmdir()


def _carried_out(
    jobs: Sequence[Job], out: Path, execution: Execution, listener: Listener, require_lock: Check
) -> Summary:
    if execution.shard is None:
        run_file.sweep_up(out)
        run_file.gather(out)
    else:  # others of its division write to OUT, too
        run_file.refuse_other_division(out, execution.shard)
    plan = make_plan(jobs, out, execution)
    listener.planned(plan)
    settled = len(plan.settled)
    done = {job.sample_id for job, record in plan.settled if record["status"] == "ok"}
    plan.settled.clear()  # a night is long, and they are many
    left = len(plan.todo) + plan.beyond
    summary = Summary(settled + left, settled, left)
    summary.unchanged = None if plan.todo or plan.moved else done
    path = run_file.run_path(out, execution.shard)
    if plan.moved:
        with Journal(journal_path(out, execution.shard)) as journal:
            for record in plan.moved:
                journal.append(record)
        plan.moved.clear()
    if not plan.todo:
        if not execution.again:
            path.unlink(missing_ok=True)
        return summary
    others = _others_left(plan, out) if execution.again else []
    with Interrupts(patient=len(plan.todo) > 1) as interrupts:
        RunPlan(_now(), plan.names + others).write(path)
        plan.names.clear()
        if execution.shard is None and not execution.again:
            run_file.forget_shards(out)
        changing = {job.sample_id for job, _ in plan.todo}
        summary.withdrawn = update.withdraw(out, changing, alone=execution.shard is None)
        try:
            with Journal(journal_path(out, execution.shard), plan.began) as journal:
                _Batch(
                    plan, out, execution, listener, journal, summary, interrupts, require_lock
                ).do()
            require_lock()
        except BaseException:
            if len(jobs) == 1 and not others:
                path.unlink(missing_ok=True)
            raise
        if execution.shard is None:
            run_file.sweep_up(out)
        if not summary.left and not others:
            path.unlink(missing_ok=True)
    summary.interrupted = interrupts.asked
    return summary


def _others_left(plan: Plan, out: Path) -> list[str]:
    """The jobs that a stopped batch has left, and that are not in the plan."""
    stopped = run_file.plan_of(out)
    left, own = stopped.left(read_all(out)) if stopped else [], {*plan.names}
    return [name for name in left if name not in own]


@dataclass
class _Batch:
    """Jobs being done."""

    plan: Plan
    out: Path
    execution: Execution
    listener: Listener
    journal: Journal
    summary: Summary
    interrupts: Interrupts
    require_lock: Check
    stopping: bool = False

    def do(self) -> None:
        """Do all jobs, or those until the user or a full disk stops the batch."""
        start = time.perf_counter()
        try:
            self.execution.execute(self.chunks(), self.done, self.stopped)
        finally:
            self.summary.seconds = time.perf_counter() - start

    def stopped(self) -> bool:
        """Whether no further job is to be begun."""
        return self.stopping or self.interrupts.asked

    def chunks(self) -> Iterator[Chunk]:
        """Jobs of one picture at a time."""
        for chunk in _chunks(self.plan.todo, self.execution.spread):
            if self.stopped():
                return
            yield chunk

    def done(self, number: int, record: Record) -> None:
        """Complete the record of a job, and write it."""
        self.require_lock()
        job, recipe = self.plan.todo[number]
        if record["reason"] == "no-space":  # no other job will find space
            path, _, problem = record["message"].partition(": ")
            raise NoSpace("no-space", problem, path=path)
        transient = {key: record[key] for key in TRANSIENT if key in record}
        record = completed(record, job, recipe, self.out)
        self.journal.append(record)
        if record["status"] == "ok" and not job.outputs.preview:
            with_previews = replace(job.outputs, preview=True).names(job.sample_id)
            for path in with_previews.values():  # of another lens
                stamp = self.plan.previews.get(path)
                if stamp and identity.unchanged(self.out / path, stamp):
                    Folder(self.out).remove(path)
        self.summary.left -= 1
        self.summary.statuses[record["status"]] += 1
        self.summary.warned += bool(record["warnings"])
        self.summary.warnings.add(*record["warnings"])
        if record["reason"]:
            self.summary.reasons[record["reason"]] += 1
        if record["status"] == "failed" and self.execution.fail_fast:
            self.stopping = True
        self.listener.ended(job, {**record, **transient})


def completed(record: Record, job: Job, recipe: str, out: Path) -> Record:
    """The record of a job for the journal, from what its worker knows of it."""
    places = {role: input_path(path, out) for role, path in job.files.items()}
    inputs = {
        role: {"path": place, **record["inputs"].get(role, {})} for role, place in places.items()
    }
    copied = ("lens", "size", "coc_px", "device", "warnings", "seconds")
    notes = ("color_note", "depth_note", "depth_repair", "measures")
    return {
        "sample_id": job.sample_id,
        **({"split": job.split.name} if job.split.name else {}),
        "job": identity.name(recipe, inputs),
        "recipe": recipe,
        **{key: record[key] for key in ("status", "reason", "message")},
        "settings": identity.settings(job),
        "inputs": inputs,
        "outputs": record["outputs"] or {name: {"path": path} for name, path in job.names.items()},
        **{key: record[key] for key in (*copied, *notes)},
        "quality": record["quality"] or job.machine.quality,
        **identity.versions(),
        "finished": _now(),
    }


def _chunks(todo: Sequence[tuple[Job, str]], spread: int) -> Iterator[Chunk]:
    """Jobs of one picture that follow one another, in chunks that keep all workers busy."""
    maximum = max(1, min(MAX_IN_A_CHUNK, len(todo) // (4 * spread)))
    chunk: Chunk = []
    for number, (job, _) in enumerate(todo):
        if chunk and (len(chunk) == maximum or chunk[-1][1].picture != job.picture):
            yield chunk
            chunk = []
        chunk.append((number, job))
    if chunk:
        yield chunk


def _now() -> str:
    return datetime.fromtimestamp(time.time(), UTC).isoformat(timespec="milliseconds")

"""A run: skips finished jobs, does the others, writes each result to the journal, then the index.

This is the one way of `defocus render` to a folder or a file, of `batch`, goldens and `run_batch`.
Only this process writes the journal.
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
from defocus_core.batch.journal import identity, left
from defocus_core.batch.journal.journal import Journal, Ledger, input_path, journal_path
from defocus_core.batch.journal.left import RunPlan
from defocus_core.batch.journal.lock import locked
from defocus_core.batch.journal.record import End, Failed, Record, Stamp, Taken
from defocus_core.batch.workers.plan import (
    Chunk,
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
from defocus_core.renderer_version import RENDERER_VERSION
from defocus_core.request import origin
from defocus_core.request.job import Job, Outputs
from defocus_core.system.interrupts import Interrupts
from defocus_core.system.text import note

MAX_IN_A_CHUNK = 8


class NoSpace(InputError):  # noqa: N818 - no mistake
    """Nothing more can be written."""


class Listener(Protocol):
    """Receives the events of a batch."""

    def planned(self, plan: Plan) -> None:
        """Before the first job is done."""

    def ended(self, job: Job, record: Record) -> None:
        """A job has come to its end, and the journal has it."""


@dataclass
class Summary:
    """The result of a batch: jobs by status, without those that were done before."""

    jobs: int = 0
    skipped: int = 0
    left: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    again: Counter[str] = field(default_factory=Counter)  # why jobs were done again, in words
    kept: Counter[str] = field(default_factory=Counter)  # why those would be that stay as they are
    warned: int = 0
    warnings: NoteKinds = field(default_factory=NoteKinds)
    seconds: float = 0.0
    interrupted: bool = False
    written: list[Path] = field(default_factory=list)  # the files of the data set
    error: Exception | None = None  # that ended a lone job


def run(jobs: Sequence[Job], out: Path, execution: Execution, listener: Listener) -> Summary:
    """Do jobs that write to OUT, or a lone one of one file, beside which no journal stands."""
    if any(job.outputs.file for job in jobs):
        return _one_file(jobs[0], execution, listener)
    with (
        _output_folders({job.outputs for job in jobs}, out),
        locked(out, execution.shard) as require_lock,
    ):
        _clear(out, execution)
        plan = make_plan(jobs, out, execution)
        listener.planned(plan)
        state = _State(plan, out, execution, listener, len(jobs) == 1)
        _append(plan.moved, out, execution)
        if plan.todo:
            with (
                _planned(state),
                Journal(journal_path(out, execution.shard), plan.began) as journal,
            ):
                start = time.perf_counter()

                def done(number: int, end: End) -> None:
                    require_lock()
                    if record := state.record(number, end):
                        journal.append(record)
                        state.count(number, record)

                try:
                    execution.execute(state.chunks(), done, state.stopped)
                finally:
                    state.summary.seconds = time.perf_counter() - start
                require_lock()
            if execution.shard is None:
                left.sweep_up(out)
        elif execution.shard is None:
            left.run_path(out).unlink(missing_ok=True)
    _index(jobs, state)
    return state.summary


def _clear(out: Path, execution: Execution) -> None:
    """What runs that were killed left half-written goes; the journals of shards become one."""
    if execution.shard is None:
        left.sweep_up(out)
        left.gather(out)
    else:  # others of its division write to OUT, too
        left.refuse_other_division(out, execution.shard)


def _append(moved: Collection[Record], out: Path, execution: Execution) -> None:
    """Append records that were changed without a job being done."""
    if moved:
        with Journal(journal_path(out, execution.shard)) as journal:
            for record in moved:
                journal.append(record)


@contextmanager
def _planned(state: _State) -> Iterator[None]:
    """The plan is in OUT in the block, and stays if jobs are left; the index lists none of them."""
    plan, out, shard = state.plan, state.out, state.execution.shard
    path = left.run_path(out, shard)
    with Interrupts(patient=len(plan.todo) > 1) as interrupts:
        state.interrupts = interrupts
        RunPlan(_now(), plan.names).write(path)
        if shard is None:
            left.forget_shards(out)
        changing = {job.sample_id for job, _ in plan.todo}
        state.withdrawn = update.withdraw(out, changing, alone=shard is None)
        try:
            yield
        except BaseException:
            if state.is_lone:
                path.unlink(missing_ok=True)
            raise
        if not state.summary.left or state.summary.error is not None:
            path.unlink(missing_ok=True)
        state.summary.interrupted = interrupts.asked


def _index(jobs: Sequence[Job], state: _State) -> None:
    """Write the index of the samples that are asked for, or one that lists some of them."""
    out, summary, wanted = state.out, state.summary, state.execution.data_set
    if wanted is not None and wanted.source is not None:
        origin.keep(out, wanted.source)
    asked = {job.sample_id for job in jobs}
    if wanted is None:
        if summary.statuses["ok"]:
            update.refresh(out, asked, state.withdrawn)
    elif state.execution.shard is None and not summary.interrupted:
        untouched = None if state.plan.todo or state.plan.moved else state.done_before()
        summary.written = update.index(out, wanted.shards_size, asked, untouched)
    if not summary.error:
        _tell_mix(state.plan.ledger, state)


def _tell_mix(ledger: Ledger, state: _State) -> None:
    """Say that pictures of another renderer stay beside those of this one."""
    counts = Counter(
        ledger.kind(number).renderer
        for number in ledger.live()
        if number not in state.replaced
        if ledger.kind(number).status == "ok"
    )
    counts[RENDERER_VERSION] += state.summary.statuses["ok"]
    versions = {version: count for version, count in counts.items() if count}
    if len(versions) > 1:
        words = ", ".join(f"{count} by {v}" for v, count in sorted(versions.items(), key=str))
        note(f"{state.out}: warning: pictures of several renderers: {words}")


def _one_file(job: Job, execution: Execution, listener: Listener) -> Summary:
    """Do a job of one file; it may replace one of the same kind."""
    refuse_misplaced([job])
    from defocus_core.io.images.encode import is_own

    out, own = job.outputs.root, [n for n in job.names.values() if is_own(job.outputs.root / n)]
    refuse_unknown([job], own.__contains__)
    plan = Plan(Ledger(out / "none"), [(job, identity.recipe(job))], [], [], 0, [])
    state = _State(plan, out, execution, listener, is_lone=True)

    def done(number: int, end: End) -> None:
        if record := state.record(number, end):
            state.count(number, record)

    with _output_folders({job.outputs}, out), Interrupts(patient=False) as interrupts:
        state.interrupts = interrupts
        execution.execute(state.chunks(), done, state.stopped)
    state.summary.interrupted = interrupts.asked
    return state.summary


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


class _State:
    """Jobs being done, and what came of them."""

    def __init__(
        self, plan: Plan, out: Path, execution: Execution, listener: Listener, is_lone: bool
    ) -> None:
        self.plan, self.out, self.execution, self.listener = plan, out, execution, listener
        self.is_lone = is_lone
        settled, to_do = len(plan.settled), len(plan.todo) + plan.beyond
        self.summary = Summary(settled + to_do, settled, to_do, again=plan.again, kept=plan.kept)
        self.interrupts: Interrupts | None = None
        self.withdrawn: set[str] = set()  # samples that were taken out of the index
        self.replaced: set[int] = set()  # numbers of records whose pictures were made again
        self.stopping = False

    def stopped(self) -> bool:
        """Whether no further job is to be begun."""
        return self.stopping or (self.interrupts is not None and self.interrupts.asked)

    def done_before(self) -> set[str]:
        """The samples that were done before."""
        numbers = (
            (job, self.plan.ledger.last(name))
            for job in self.plan.settled
            for name in job.names.values()
        )
        return {
            j.sample_id
            for j, n in numbers
            if n is not None and self.plan.ledger.kind(n).status == "ok"
        }

    def chunks(self) -> Iterator[Chunk]:
        """Jobs of one picture that follow one another, in chunks that keep all workers busy."""
        todo = self.plan.todo
        maximum = max(1, min(MAX_IN_A_CHUNK, len(todo) // (4 * self.execution.spread)))
        chunk: Chunk = []
        for number, (job, _) in enumerate(todo):
            if chunk and (len(chunk) == maximum or chunk[-1][1].picture != job.picture):
                if self.stopped():
                    return
                yield chunk
                chunk = []
            chunk.append((number, job))
        if chunk and not self.stopped():
            yield chunk

    def record(self, number: int, end: End) -> Record | None:
        """The record of a job that ended; None of a lone one whose error ends the run."""
        job, recipe = self.plan.todo[number]
        if isinstance(end, Failed):
            if end.reason == "no-space" and not self.execution.raises:
                path, _, problem = end.message.partition(": ")
                raise NoSpace("no-space", problem, path=path)  # no other job will find space
            if self.execution.raises:
                self.summary.error = end.error
                self.count(number, completed(end, job, recipe, self.out))
                return None
        return completed(end, job, recipe, self.out)

    def count(self, number: int, record: Record) -> None:
        """Count a job whose record is kept, and tell of it."""
        job, summary, end = self.plan.todo[number][0], self.summary, record.end
        if isinstance(end, Taken):
            self._remove_previews(job)
            names = job.names.values()
            self.replaced |= {n for n in map(self.plan.ledger.last, names) if n is not None}
        summary.left -= 1
        summary.statuses[end.status] += 1
        summary.warned += bool(end.warnings)
        summary.warnings.add(*end.warnings)
        if end.reason:
            summary.reasons[end.reason] += 1
        if end.status == "failed" and self.execution.fail_fast:
            self.stopping = True
        self.listener.ended(job, record)

    def _remove_previews(self, job: Job) -> None:
        """Remove the previews of a job that were made of another lens."""
        if job.outputs.preview or job.outputs.file:
            return
        for path in replace(job.outputs, preview=True).names(job.sample_id).values():
            number = None if path in job.names.values() else self.plan.ledger.last(path)
            if number is None:
                continue
            stamps = self.plan.ledger.record(number).outputs.values()
            stamp = next((s for s in stamps if s.path == path), Stamp())
            if identity.unchanged(self.out / path, stamp):
                Folder(self.out).remove(path)


def completed(end: End, job: Job, recipe: str, out: Path) -> Record:
    """The record of a job for the journal, from what its worker knows of it."""
    places = {role: input_path(path, out) for role, path in job.files.items()}
    inputs = {r: end.inputs.get(r, Stamp())._replace(path=place) for r, place in places.items()}
    outputs = end.outputs or {name: Stamp(path) for name, path in job.names.items()}
    return Record(
        sample_id=job.sample_id,
        split=job.split.name,
        recipe=recipe,
        settings=identity.settings(job),
        quality=job.machine.quality,
        **identity.versions(),
        finished=_now(),
        end=replace(end, inputs=inputs, outputs=outputs),
    )


def _now() -> str:
    return datetime.fromtimestamp(time.time(), UTC).isoformat(timespec="milliseconds")

"""A run: skips finished jobs, does the others, writes each result to the journal, then the index.

This is the one way of `defocus render` to a folder or a file, of `batch`, goldens and `run_batch`.
Only this process writes the journal.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from defocus_core.batch.journal import resume, runs
from defocus_core.batch.journal.journal import Journal, input_path, journal_path
from defocus_core.batch.journal.record import End, Failed, Record, Stamp, Taken, now
from defocus_core.batch.journal.resume import moved_record
from defocus_core.batch.workers.plan import (
    Chunk,
    Execution,
    Plan,
    make_plan,
    refuse_unwritable,
    writes_file,
)
from defocus_core.errors import InputError, NoteKinds
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import unwritable
from defocus_core.renderer_version import RENDERER_VERSION
from defocus_core.request.job import Job, Outputs
from defocus_core.system.interrupts import Interrupts
from defocus_core.system.text import note

MAX_IN_A_CHUNK = 8


class Listener:
    """Receives the events of a batch."""

    def __init__(self, tell: Callable[[Job, Record], None] | None = None) -> None:
        self._tell = tell

    def planned(self, plan: Plan) -> None:
        """Before the first job is done."""

    def ended(self, job: Job, record: Record) -> None:
        """A job has come to its end, and the journal has it."""
        if self._tell is not None:
            self._tell(job, record)


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
    """Do jobs that write to OUT. A lone one of one file takes no lock, and leaves no journal."""
    has_journal = not writes_file(jobs)
    lock = runs.locked(out, execution.shard) if has_journal else nullcontext(lambda: None)
    with _output_folders({job.outputs for job in jobs}, out), lock as require_lock:
        if has_journal and execution.shard is None:
            runs.sweep_up(out)  # what runs that were killed left half-written
            runs.gather(out)
        elif execution.shard is not None:  # others of its division write to OUT, too
            runs.refuse_other_division(out, execution.shard)
        plan = make_plan(jobs, out, execution)
        listener.planned(plan)
        state = _State(plan, execution, listener)
        if plan.due or plan.moved:
            with _recording(state) if has_journal else nullcontext(lambda _: None) as append:
                for number, stamps in plan.moved.items():
                    append(moved_record(plan.jobs[number], plan.ledger, stamps))

                def done(number: int, end: End) -> None:
                    require_lock()
                    if record := state.record(number, end):
                        append(record)
                        state.count(plan.jobs[number], record)

                with state.interruptible():
                    if plan.due:
                        execution.execute(state.chunks(), done, state.stopped)
                require_lock()
            if has_journal and execution.shard is None:
                runs.sweep_up(out)
        elif has_journal and execution.shard is None:
            runs.run_path(out).unlink(missing_ok=True)
    if has_journal:
        _index({job.sample_id for job in jobs}, state)
    return state.summary


@contextmanager
def _recording(state: _State) -> Iterator[Callable[[Record], None]]:
    """Append records; the run is noted in OUT in the block, and after it if jobs are left."""
    plan, shard = state.plan, state.execution.shard
    out = plan.ledger.out
    path = runs.note_run(out, shard, (job.sample_id for job in plan.unfinished))
    changing = {job.sample_id for _, job in plan.todo}
    if (out / runs.INDEX).exists():
        from defocus_core.batch.datasets import update

        state.withdrawn = update.withdraw(out, changing, alone=shard is None)
    try:
        with Journal(journal_path(out, shard), plan.began) as journal:
            yield journal.append
    except BaseException:
        if len(plan.jobs) == 1:
            path.unlink(missing_ok=True)
        raise
    if not state.summary.left or state.summary.error is not None:
        path.unlink(missing_ok=True)


def _index(asked: Collection[str], state: _State) -> None:
    """Write the index of the samples that are asked for, or one that lists some of them."""
    plan, summary, execution = state.plan, state.summary, state.execution
    out = plan.ledger.out
    if execution.source is not None:
        from defocus_core.request import origin

        origin.keep(out, execution.source)
    if execution.has_index or (out / runs.INDEX).exists():
        from defocus_core.batch.datasets import update
    if not execution.has_index:
        if summary.statuses["ok"] and (out / runs.INDEX).exists():
            update.refresh(out, asked, state.withdrawn)
    elif execution.shard is None and not summary.interrupted:
        untouched = None if plan.due or plan.moved else state.done_before()
        summary.written = update.index(out, execution.shards_size, asked, untouched)
    if not summary.error:
        _tell_mix(state)


def _tell_mix(state: _State) -> None:
    """Say that pictures of another renderer stay beside those of this one."""
    ledger = state.plan.ledger
    counts = Counter(
        ledger.outcomes[number].renderer
        for number in ledger.live()
        if number not in state.replaced and ledger.is_ok(number)
    )
    counts[RENDERER_VERSION] += state.summary.statuses["ok"]
    versions = {version: count for version, count in counts.items() if count}
    if len(versions) > 1:
        words = ", ".join(f"{count} by {v}" for v, count in sorted(versions.items(), key=str))
        note(f"{ledger.out}: warning: pictures of several renderers: {words}")


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

    def __init__(self, plan: Plan, execution: Execution, listener: Listener) -> None:
        self.plan, self.execution, self.listener = plan, execution, listener
        unfinished = plan.due + plan.later
        settled = len(plan.jobs) - unfinished
        self.summary = Summary(
            len(plan.jobs), settled, unfinished, again=plan.again, kept=plan.kept
        )
        self.interrupts = Interrupts(patient=plan.due > 1)
        self.withdrawn: set[str] = set()  # samples that were taken out of the index
        self.replaced: set[int] = set()  # numbers of records whose pictures were made again
        self.stopping = False

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Do jobs in the block, or until stopped."""
        start = time.perf_counter()
        try:
            with self.interrupts:
                yield
        finally:
            self.summary.seconds = time.perf_counter() - start
        self.summary.interrupted = self.interrupts.asked

    def stopped(self) -> bool:
        """Whether no further job is to be begun."""
        return self.stopping or self.interrupts.asked

    def done_before(self) -> set[str]:
        """The samples that were done before."""
        ledger = self.plan.ledger
        return {
            job.sample_id
            for job in self.plan.settled
            if any(ledger.is_ok(ledger.last.get(name)) for name in job.names.values())
        }

    def chunks(self) -> Iterator[Chunk]:
        """Jobs of one picture that follow one another, in chunks that keep all workers busy."""
        maximum = max(1, min(MAX_IN_A_CHUNK, self.plan.due // (4 * self.execution.spread)))
        chunk: Chunk = []
        for number, job in self.plan.todo:
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
        job, out = self.plan.jobs[number], self.plan.ledger.out
        places = {role: input_path(path, out) for role, path in job.files.items()}
        inputs = {r: end.inputs.get(r, Stamp())._replace(path=place) for r, place in places.items()}
        outputs = end.outputs or {name: Stamp(path) for name, path in job.names.items()}
        record = Record(
            sample_id=job.sample_id,
            split=job.split.name,
            recipe=resume.recipe(job),
            settings=resume.settings(job),
            quality=job.machine.quality,
            **resume.versions(),
            finished=now(),
            end=replace(end, inputs=inputs, outputs=outputs),
        )
        if isinstance(end, Failed):
            if end.reason == "no-space" and not self.execution.raises:
                path, _, problem = end.message.partition(": ")
                raise InputError("no-space", problem, path=path)  # no other job will find space
            if self.execution.raises:
                self.summary.error = end.error
                self.count(job, record)
                return None
        return record

    def count(self, job: Job, record: Record) -> None:
        """Count a job whose record is kept, and tell of it."""
        summary, end = self.summary, record.end
        if isinstance(end, Taken):
            self._remove_previews(job)
            names = job.names.values()
            self.replaced |= {n for n in map(self.plan.ledger.last.get, names) if n is not None}
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
        ledger = self.plan.ledger
        for path in replace(job.outputs, preview=True).names(job.sample_id).values():
            number = None if path in job.names.values() else ledger.last.get(path)
            if number is None:
                continue
            stamps = ledger.record(number).outputs.values()
            stamp = next((s for s in stamps if s.path == path), Stamp())
            if resume.unchanged(ledger.out / path, stamp):
                Folder(ledger.out).remove(path)

"""A run does the unfinished jobs, writes each result to the journal, then the index.

Its plan has the jobs to do. `defocus render`, `batch` and `run_batch` all use it. Only this process
writes the journal.
"""

from __future__ import annotations

import os
import time
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace as copy

from defocus_core.batch.journal import resume, runs
from defocus_core.batch.journal.journal import Journal, Ledger, Shard, input_path, journal_path
from defocus_core.batch.journal.record import Completed, End, Failed, Record, Stamp, Stamps, now
from defocus_core.errors import InputError, NoteKinds
from defocus_core.io.replacing import replaces_input
from defocus_core.io.safe_files import missing, require_utf_8, unwritable
from defocus_core.request.job import Job, Outputs
from defocus_core.system.memory import without_collections
from defocus_core.system.process import Interrupts
from defocus_core.system.text import note

if TYPE_CHECKING:
    from defocus_core.request.origin import JobsSource


Chunk = list[tuple[int, Job]]  # jobs of one picture, with their numbers
Done = Callable[[int, End], None]
Execute = Callable[[Iterator[Chunk], Done, Callable[[], bool]], None]


@dataclass(frozen=True)
class Execution:
    """The way to carry out a batch."""

    # Does jobs; called with chunks of them, with a function to call with the number and end of each
    # job, and with a function that tells whether to stop
    execute: Execute
    shard: Shard | None = None  # the part of the batch; None for the whole
    limit: int | None = None  # greatest number of jobs
    fail_fast: bool = False  # stop at the first failed job
    read_inputs: bool = False  # compare inputs by content, not only by size and time
    new_only: bool = False  # keep existing outputs, whatever changed
    keep_lenses: bool = False  # refuse to replace pictures of another lens or view
    raises: bool = False  # a failed lone job leaves no record, and its error ends the run
    spread: int = 1  # number of workers that share the jobs of one picture
    has_index: bool = False  # write an index of the requested jobs; else update an existing one
    shards_size: int | None = None  # bytes of a tar; None to pack only if tars exist
    source: JobsSource | None = None  # the jobs file to keep, if any


_DUE, _LATER = 1, 2  # marks of jobs to do, now or beyond the limit; others have 0


@dataclass
class Plan:
    """The jobs of a run to do, as a mark for each; jobs are made on access."""

    jobs: Sequence[Job]
    ledger: Ledger
    marks: bytearray = field(default_factory=bytearray)
    # of finished jobs, by number: inputs that have moved, or empty if the split changed
    moved: dict[int, Stamps] = field(default_factory=dict)
    again: Counter[str] = field(default_factory=Counter)  # reasons to do jobs again, in words
    kept: Counter[str] = field(default_factory=Counter)  # reasons of changed jobs that are kept

    @property
    def due(self) -> int:
        """The number of jobs to do now."""
        return self.marks.count(_DUE)

    @property
    def later(self) -> int:
        """The number of jobs beyond the limit."""
        return self.marks.count(_LATER)

    @property
    def todo(self) -> Iterator[tuple[int, Job]]:
        """The jobs to do now, with their numbers."""
        return ((n, self.jobs[n]) for n, mark in enumerate(self.marks) if mark == _DUE)

    @property
    def unfinished(self) -> Iterator[Job]:
        """The jobs to do, now or later."""
        return (job for job, mark in zip(self.jobs, self.marks, strict=True) if mark)

    @property
    def settled(self) -> Iterator[Job]:
        """The jobs that are done."""
        return (job for job, mark in zip(self.jobs, self.marks, strict=True) if not mark)

    def began(self) -> bool:
        """Whether an output of the jobs to do exists."""
        return any(os.path.lexists(path) for _, job in self.todo for path in job.written)


@without_collections()
def make_plan(jobs: Sequence[Job], out: Path, execution: Execution) -> Plan:
    """The plan of a batch; refuses jobs that would replace foreign files."""
    refuse_misplaced(jobs)
    if execution.has_index:
        from defocus_core.batch.datasets import update

        packed = None if execution.shards_size is None else [job.sample_id for job in jobs]
        update.refuse_foreign(out, {job.split.name for job in jobs}, packed)
    is_file, forced = writes_file(jobs), any(job.outputs.overwrite for job in jobs)
    ledger = Ledger(out, is_empty=is_file)
    plan = _assigned(jobs, ledger, execution.shard, forced=forced)
    _decide(plan, execution, forced=forced)
    resume.refuse_others(plan.unfinished, ledger, keep_lenses=execution.keep_lenses)
    begun = set() if is_file else runs.begun_samples(out, execution.shard)
    refuse_unknown((job for job in plan.unfinished if job.sample_id not in begun), ledger.is_known)
    return plan


def _assigned(jobs: Sequence[Job], ledger: Ledger, shard: Shard | None, *, forced: bool) -> Plan:
    """The plan of jobs, with the recorded splits of samples unless it is forced."""
    if any(job.split.choices for job in jobs):
        from defocus_core.request.splits import with_recorded

        recorded = {} if forced else ledger.splits
        jobs = with_recorded(jobs, recorded, all_scenes=shard is None)
    return Plan(jobs, ledger)


def _decide(plan: Plan, execution: Execution, *, forced: bool) -> None:
    """Mark the jobs of a plan to do, now or beyond the limit; all if it is forced."""
    left = len(plan.jobs) if execution.limit is None else execution.limit
    for number, job in enumerate(plan.jobs):
        found = resume.Decision(False)
        if not forced:
            found = resume.decided(job, plan.ledger, read_inputs=execution.read_inputs)
        is_kept = execution.new_only and found.again and _has_outputs(job, plan.ledger)
        if is_kept:
            plan.kept[found.again] += 1
        elif found.again and found.again != resume.AGAIN["failed"]:
            plan.again[found.again] += 1
        if found.moved is not None:
            plan.moved[number] = found.moved
        if found.is_done or is_kept:
            plan.marks.append(0)
        elif left:
            plan.marks.append(_DUE)
            left -= 1
        else:
            plan.marks.append(_LATER)


def writes_file(jobs: Sequence[Job]) -> bool:
    """Whether a lone picture is written to a named file, without a journal."""
    return any(job.outputs.file for job in jobs)


def _has_outputs(job: Job, ledger: Ledger) -> bool:
    """Whether a record has all files of a job, and they exist."""
    number = ledger.number_of(job.names.values())
    return ledger.is_ok(number) and all(map(os.path.exists, job.written))


_NAME_BYTES = 255  # the longest name of a file on Linux


def refuse_misplaced(jobs: Sequence[Job]) -> None:
    """Refuse jobs that would replace outputs of one another or their inputs."""
    _refuse_clashes(jobs)
    every = {id(job.outputs): job.outputs for job in jobs}.values()  # hashing each would take long
    for outputs in {*every}:
        list(_places_of(outputs))
    folders = {folder.resolve() for outputs in every for folder in outputs.folders}
    # values shared by many jobs are checked once
    parts = {id(part): part for job in jobs for part in (job.picture, job.lens, job.shot) if part}
    named = [str(path) for part in parts.values() for path in part.files.values()]
    for text in named:
        require_utf_8(text)
    # Path.resolve raises for circular links; the reader reports them.
    named += [os.path.realpath(path) for path in named if os.path.islink(path)]  # noqa: PTH114
    split = [os.path.split(path) for path in named]
    places = {folder: Path(folder).resolve() for folder in {folder for folder, _ in split}}
    if folders.isdisjoint(places.values()):  # a batch has many outputs, but rarely such inputs
        return
    inputs = {places[folder] / name for folder, name in split}
    for path in (path for job in jobs for path in job.written):
        if path.parent.resolve() / path.name in inputs:
            raise replaces_input(path)


def _refuse_clashes(jobs: Sequence[Job]) -> None:
    import numpy as np

    hashes = array("q")  # a table of all names takes 200 MB for a million
    for job in jobs:
        for name in job.names.values():
            hashes.append(hash((job.outputs.root, name)))
            if len(name) > _NAME_BYTES // 4 or not name.isascii():
                require_utf_8(name)
                length = len(name.rpartition("/")[2].encode())
                if length > _NAME_BYTES:
                    problem = f"has a name of {length} bytes, more than {_NAME_BYTES}"
                    remedy = "give the picture a shorter name or stem"
                    raise InputError("too-large", problem, remedy, path=job.outputs.root / name)
    if len(np.unique(hashes)) == len(hashes):
        return
    count = Counter((job.outputs.root, name) for job in jobs for name in job.names.values())
    ((root, name), times), *_ = count.most_common(1)
    if times > 1:
        problem, remedy = "would be written twice", "rename one of the colour files"
        raise InputError("duplicate", problem, remedy, path=root / name)


def refuse_unknown(jobs: Iterable[Job], is_known: Callable[[str], bool]) -> None:
    """Refuse to replace files that the journal does not know."""
    existing, journal = list[Path](), ""
    for job in jobs:
        root, overwrite = job.outputs.root, job.outputs.overwrite
        for name in job.names.values():
            if not os.path.lexists(f"{root}/{name}"):  # making paths takes long for a million jobs
                continue
            path = root / name
            if path.is_dir():
                problem = "is a directory where a file is to be written"
                raise InputError("wrong-type", problem, "choose another -o", path=path)
            if not overwrite and not is_known(name):
                existing.append(path)
                journal = "" if job.outputs.file else ", and the journal does not know it"
    if existing:
        others = f" (and {len(existing) - 1} more)" if len(existing) > 1 else ""
        raise InputError(
            "exists",
            f"exists already{others}{journal}",
            "move it away, choose another -o, or add ‹overwrite› to render all again",
            path=existing[0],
        )


def refuse_unwritable(outputs: Outputs) -> None:
    """Refuse a directory that cannot be written to."""
    for place in _places_of(outputs):
        if not os.access(place, os.W_OK | os.X_OK):
            raise InputError("unwritable", "cannot be written to", "choose another -o", path=place)


def _places_of(outputs: Outputs) -> Iterator[Path]:
    """The folders of outputs, or the nearest existing one above each."""
    for folder in (outputs.root, *outputs.folders):
        if folder.is_symlink() and not folder.exists():
            raise missing(folder)
        if folder != outputs.root and folder.is_symlink():
            problem = "is a symbolic link below the output directory"
            remedy = "make it a directory, or name another -o"
            raise InputError("link", problem, remedy, path=folder)
        existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        if not existing.is_dir():
            raise InputError(
                "wrong-type",
                "is a file where a directory is needed",
                "choose another -o",
                path=existing,
            )
        yield existing


MAX_IN_A_CHUNK = 8


class Listener:
    """Receives the events of a batch."""

    def __init__(self, tell: Callable[[Job, Record], None] | None = None) -> None:
        self._tell = tell

    def planned(self, plan: Plan) -> None:
        """Called before the first job."""

    def ended(self, job: Job, record: Record) -> None:
        """Called when a job has ended, and is in the journal."""
        if self._tell is not None:
            self._tell(job, record)


@dataclass
class Summary:
    """The result of a batch: jobs by status, without those finished before."""

    jobs: int = 0
    skipped: int = 0
    left: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    again: Counter[str] = field(default_factory=Counter)  # reasons to do jobs again, in words
    kept: Counter[str] = field(default_factory=Counter)  # reasons of changed jobs that are kept
    warned: int = 0
    warnings: NoteKinds = field(default_factory=NoteKinds)
    seconds: float = 0.0
    interrupted: bool = False
    written: list[Path] = field(default_factory=list)  # the files of the data set
    error: Exception | None = None  # the error of a lone job


def run(jobs: Sequence[Job], out: Path, execution: Execution, listener: Listener) -> Summary:
    """Do jobs that write to OUT. A lone job of one file needs no lock and no journal."""
    has_journal = not writes_file(jobs)
    lock = runs.locked(out, execution.shard) if has_journal else nullcontext(lambda: None)
    labels = {label for job in jobs for label in job.outputs.labels}
    with _output_folders({job.outputs for job in jobs}, out), lock as require_lock:
        if has_journal and execution.shard is None:
            runs.sweep_up(out, labels)  # half-written files of killed runs
            runs.gather(out)
        elif execution.shard is not None:  # other shards write to OUT, too
            runs.refuse_other_division(out, execution.shard)
        plan = make_plan(jobs, out, execution)
        listener.planned(plan)
        state = _State(plan, execution, listener)
        if plan.due or plan.moved:
            with _recording(state) if has_journal else nullcontext(lambda _: None) as append:
                for number, stamps in plan.moved.items():
                    append(resume.moved_record(plan.jobs[number], plan.ledger, stamps))

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
                runs.sweep_up(out, labels)
        elif has_journal and execution.shard is None:
            runs.run_path(out).unlink(missing_ok=True)
        if has_journal:
            _index({job.sample_id for job in jobs}, state)
    return state.summary


@contextmanager
def _recording(state: _State) -> Iterator[Callable[[Record], None]]:
    """Yield the function that appends records; the run is noted in OUT while jobs are left."""
    plan, shard = state.plan, state.execution.shard
    out = plan.ledger.out
    records = plan.ledger.counts()
    path = runs.note_run(out, shard, {j.sample_id: records[j.sample_id] for j in plan.unfinished})
    if (out / runs.INDEX).exists():
        from defocus_core.batch.datasets import update

        state.withdrawn = update.withdraw(out)
    try:
        with Journal(journal_path(out, shard), plan.began) as journal:
            yield journal.append
    except BaseException:
        if len(plan.jobs) == 1 and not plan.began():
            path.unlink(missing_ok=True)
        raise
    if not state.summary.left or state.summary.error is not None:
        path.unlink(missing_ok=True)


def _index(asked: Collection[str], state: _State) -> None:
    """Write the index of the requested samples, or of those that it listed before."""
    plan, summary, execution = state.plan, state.summary, state.execution
    out, is_other = plan.ledger.out, bool(plan.due or plan.moved)
    if execution.source is not None:
        from defocus_core.request import origin

        is_other |= origin.keep(out, execution.source)
    names = asked if execution.has_index else state.withdrawn
    if names is not None and execution.shard is None and not summary.interrupted:
        from defocus_core.batch.datasets import sample_index, update

        is_other |= execution.shards_size is not None
        if is_other or sample_index.listed(out) != state.done_before():
            summary.written = update.index(out, execution.shards_size, names)
    _tell_backs(state)


def _tell_backs(state: _State) -> None:
    """Warn that pictures of another back stay beside those of this run."""
    before, made = state.backs_before(), state.backs
    if before and made and before != made:
        earlier, later = (" and ".join(sorted(backs)) for backs in (before, made))
        out = state.plan.ledger.out
        note(f"{out}: earlier pictures are by {earlier}, those of this run by {later}")


@contextmanager
def _output_folders(every: Collection[Outputs], out: Path) -> Iterator[None]:
    """Make OUT for the block, and remove new folders that are empty at its end."""
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
    """The state of a run: its jobs and their results."""

    def __init__(self, plan: Plan, execution: Execution, listener: Listener) -> None:
        self.plan, self.execution, self.listener = plan, execution, listener
        unfinished = plan.due + plan.later
        settled = len(plan.jobs) - unfinished
        self.summary = Summary(
            len(plan.jobs), settled, unfinished, again=plan.again, kept=plan.kept
        )
        self.interrupts = Interrupts(patient=plan.due > 1)
        self.withdrawn: set[str] | None = None  # samples of the removed index
        self.backs: set[str] = set()  # backs of the new pictures
        self.stopping = False

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Do jobs in the block, unless stopped."""
        start = time.perf_counter()
        try:
            with self.interrupts:
                yield
        finally:
            self.summary.seconds = time.perf_counter() - start
        self.summary.interrupted = self.interrupts.asked

    def stopped(self) -> bool:
        """Whether to begin no further job."""
        return self.stopping or self.interrupts.asked

    def done_before(self) -> set[str]:
        """The samples finished before."""
        ledger = self.plan.ledger
        return {
            job.sample_id
            for job in self.plan.settled
            if any(ledger.is_ok(ledger.last.get(name)) for name in job.names.values())
        }

    def backs_before(self) -> set[str]:
        """The backs of pictures finished before, which stay."""
        ledger = self.plan.ledger
        numbers = (ledger.last.get(n) for job in self.plan.settled for n in job.names.values())
        return {ledger.outcomes[n].back for n in numbers if n is not None and ledger.is_ok(n)}

    def chunks(self) -> Iterator[Chunk]:
        """Consecutive jobs of one picture, in chunks that keep all workers busy."""
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
        """The record of an ended job; None for a lone job whose error ends the run."""
        job, out = self.plan.jobs[number], self.plan.ledger.out
        places = {role: input_path(path, out) for role, path in job.files.items()}
        inputs = {r: copy(end.inputs.get(r, Stamp()), path=place) for r, place in places.items()}
        outputs = end.outputs or {name: Stamp(path) for name, path in job.names.items()}
        record = Record(
            sample_id=job.sample_id,
            split=job.split.name,
            recipe=resume.recipe(job),
            status=end.status,
            settings=resume.settings(job),
            quality=job.machine.quality,
            **resume.versions(),
            finished=now(),
            end=copy(end, inputs=inputs, outputs=outputs),
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
        """Count a recorded job, and tell the listener."""
        summary, end = self.summary, record.end
        if isinstance(end, Completed):
            self.backs.add(end.back)
        summary.left -= 1
        summary.statuses[end.status] += 1
        summary.warned += bool(end.warnings)
        summary.warnings.add(*end.warnings)
        if end.reason:
            summary.reasons[end.reason] += 1
        if end.status == "failed" and self.execution.fail_fast:
            self.stopping = True
        self.listener.ended(job, record)

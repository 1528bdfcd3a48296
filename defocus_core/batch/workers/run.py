"""A run of a batch: find the unfinished jobs, carry them out, and write journal and index.

The commands `defocus render` and `defocus batch` and the function `run_batch` all use this module.
Only the process that calls it writes the journal.
"""

from __future__ import annotations

import os
import time
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import chain, groupby, islice
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace as copy

from defocus_core.batch.journal import resume, runs
from defocus_core.batch.journal.journal import Journal, Ledger, Shard, input_path, journal_path
from defocus_core.batch.journal.record import Completed, End, Failed, Record, Stamp, Stamps, now
from defocus_core.errors import InputError, NoteKinds
from defocus_core.io.read_files import missing, require_utf_8
from defocus_core.io.write_files import replaces_input, unwritable
from defocus_core.request.job import Job, Outputs
from defocus_core.system.memory import without_collections
from defocus_core.system.process import Interrupts
from defocus_core.system.text import note

if TYPE_CHECKING:
    from defocus_core.request.origin import JobsSource


Chunk = list[tuple[int, Job]]  # jobs of one picture, with their numbers
Done = Callable[[int, End], None]
Execute = Callable[[Iterator[Chunk], Done, Callable[[], bool]], None]
MAX_IN_A_CHUNK = 8


@dataclass(frozen=True)
class Execution:
    """How to carry out a batch."""

    # execute(chunks, done, stopped) does jobs: it calls done(number, end) after each job, and
    # begins no more when stopped() is true
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


_numbers = partial(array, "I")


@dataclass
class Plan:
    """The jobs of a run, and which of them to do.

    Jobs are `settled` (finished or kept), `due` (to be done now) or `later` (beyond the limit of
    the run); these arrays hold indices in `jobs`.
    """

    jobs: Sequence[Job]
    ledger: Ledger
    settled: array[int] = field(default_factory=_numbers)
    due: array[int] = field(default_factory=_numbers)
    later: array[int] = field(default_factory=_numbers)
    # inputs of settled jobs that have moved, by number of the job; empty if the split changed
    moved: dict[int, Stamps] = field(default_factory=dict)
    again: Counter[str] = field(default_factory=Counter)  # reasons to do jobs again, in words
    kept: Counter[str] = field(default_factory=Counter)  # reasons of changed jobs that are kept

    def jobs_of(self, *numbers: Iterable[int]) -> Iterator[Job]:
        """Iterate over the jobs with the given indices."""
        return (self.jobs[number] for number in chain(*numbers))

    def recorded(self, number: int) -> Record:
        """The record of a settled job."""
        found = self.ledger.number_of(self.jobs[number].names.values())
        assert found is not None
        return self.ledger.record(found)

    def began(self) -> bool:
        """Whether any output of a job to be done exists."""
        return any(os.path.lexists(path) for job in self.jobs_of(self.due) for path in job.written)


@without_collections()
def make_plan(jobs: Sequence[Job], out: Path, execution: Execution) -> Plan:
    """Find out which jobs to do; refuses jobs that would replace files other than older outputs."""
    refuse_misplaced(jobs)
    if execution.has_index:
        from defocus_core.batch.datasets import update

        packed = None if execution.shards_size is None else [job.sample_id for job in jobs]
        update.refuse_foreign(out, {job.split.name for job in jobs}, packed)
    is_file, forced = writes_file(jobs), any(job.outputs.overwrite for job in jobs)
    ledger = Ledger(out, is_empty=is_file)
    if any(job.split.choices for job in jobs):
        from defocus_core.request.splits import with_recorded

        recorded = {} if forced else ledger.splits
        jobs = with_recorded(jobs, recorded, all_scenes=execution.shard is None)
    plan = Plan(jobs, ledger)
    _decide(plan, execution, forced=forced)
    begun = set() if is_file else runs.begun_samples(out, execution.shard)
    _refuse_to_replace(plan, begun, keep_lenses=execution.keep_lenses)
    return plan


def _decide(plan: Plan, execution: Execution, *, forced: bool) -> None:
    """Sort the jobs of a plan into settled, due and later ones; none is settled if `forced`."""
    ledger = plan.ledger
    decided = partial(resume.decided, ledger=ledger, read_inputs=execution.read_inputs)
    for number, job in enumerate(plan.jobs):
        again, moved = ("", None) if forced else decided(job)
        is_kept = (
            execution.new_only
            and bool(again)
            and ledger.is_ok(ledger.number_of(job.names.values()))
            and all(map(os.path.exists, job.written))
        )
        if again and (is_kept or again != resume.AGAIN["failed"]):
            (plan.kept if is_kept else plan.again)[again] += 1
        if moved is not None:
            plan.moved[number] = moved
        if again is None or is_kept:
            plan.settled.append(number)
        elif execution.limit is None or len(plan.due) < execution.limit:
            plan.due.append(number)
        else:
            plan.later.append(number)


def writes_file(jobs: Sequence[Job]) -> bool:
    """Whether a job writes a single file of a given path; a run then writes no journal."""
    return any(job.outputs.file for job in jobs)


def _outputs_of(jobs: Sequence[Job]) -> set[Outputs]:
    """The distinct `outputs` of jobs. Most jobs share the same object, so few need to be hashed."""
    return {*{id(job.outputs): job.outputs for job in jobs}.values()}


def refuse_misplaced(jobs: Sequence[Job]) -> None:
    """Raise InputError if a job would replace an input, or an output of another job."""
    _refuse_clashes(jobs)
    every = _outputs_of(jobs)
    for outputs in every:
        _check_folders(outputs, os.F_OK)
    # values shared by many jobs are checked once
    parts = {id(part): part for job in jobs for part in (job.picture, job.lens, job.shot) if part}
    inputs = [str(path) for part in parts.values() for path in part.files.values()]
    for text in inputs:
        require_utf_8(text)
    inputs += list(map(os.path.realpath, filter(os.path.islink, inputs)))
    real = cache(os.path.realpath)  # a batch has many outputs, but few folders
    folders = {real(folder) for outputs in every for folder in outputs.folders}
    split = ((real(folder), name) for folder, name in map(os.path.split, inputs))
    there = {(folder, name) for folder, name in split if folder in folders}
    for path in (path for job in jobs for path in job.written) if there else ():
        if (real(path.parent), path.name) in there:
            raise replaces_input(path)


def _refuse_clashes(jobs: Sequence[Job]) -> None:
    import numpy as np

    # A table of all names takes 200 MB for a million.
    names = ((job.outputs.root, name) for job in jobs for name in job.names.values())
    hashes = np.fromiter(map(hash, names), np.int64)
    if len(np.unique(hashes)) == len(hashes):
        return
    count = Counter((job.outputs.root, name) for job in jobs for name in job.names.values())
    ((root, name), times), *_ = count.most_common(1)
    if times > 1:
        problem, remedy = "would be written twice", "rename one of the colour files"
        raise InputError("duplicate", problem, remedy, path=root / name)


def _refuse_to_replace(plan: Plan, begun: Collection[str], *, keep_lenses: bool) -> None:
    """Raise InputError if a job to be done would replace a file other than its own older output.

    `begun`: samples of interrupted runs, whose files are replaced without a record; `keep_lenses`:
    refuse to replace outputs of another lens, too.
    """
    ledger, unknown, journal = plan.ledger, list[Path](), ""
    for job in plan.jobs_of(plan.due, plan.later):
        root = job.outputs.root
        for name in () if job.outputs.overwrite else job.names.values():
            if not os.path.lexists(f"{root}/{name}"):  # a path for each would take long
                continue
            if (number := ledger.last.get(name)) is not None:
                record = ledger.record(number)
                if words := resume.other_words(job, record, ledger.out, keep_lenses=keep_lenses):
                    remedy = "choose another -o, or add ‹overwrite› to replace it"
                    raise InputError("exists", f"exists already, {words}", remedy, path=root / name)
            if job.sample_id not in begun and not ledger.is_known(name):
                unknown.append(root / name)
                journal = "" if job.outputs.file else ", and the journal does not know it"
    if unknown:
        others = f" (and {len(unknown) - 1} more)" if len(unknown) > 1 else ""
        remedy = "move it away, choose another -o, or add ‹overwrite› to render all again"
        raise InputError("exists", f"exists already{others}{journal}", remedy, path=unknown[0])


def _check_folders(outputs: Outputs, mode: int) -> None:
    """Raise InputError if an output folder is a link or a file, or `os.access` denies `mode`."""
    for folder in (outputs.root, *outputs.folders):
        if folder.is_symlink() and not folder.exists():
            raise missing(folder)
        if folder != outputs.root and folder.is_symlink():
            problem = "is a symbolic link below the output directory"
            remedy = "make it a directory, or name another -o"
            raise InputError("link", problem, remedy, path=folder)
        place = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        remedy = "choose another -o"
        if not place.is_dir():
            problem = "is a file where a directory is needed"
            raise InputError("wrong-type", problem, remedy, path=place)
        if not os.access(place, mode):
            raise InputError("unwritable", "cannot be written to", remedy, path=place)


@dataclass
class Summary:
    """The result of a run: numbers of jobs, by status and reason, and warnings.

    ``statuses`` and ``reasons`` do not count jobs that were finished before.
    """

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


def run(
    jobs: Sequence[Job],
    out: Path,
    execution: Execution,
    ended: Callable[[Job, Record], None] | None = None,
    planned: Callable[[Plan], None] | None = None,
) -> Summary:
    """Do the jobs that are not finished, and write journal and index.

    Args:
        jobs: The jobs of a batch; or one job that writes a single file, without lock and journal.
        out: The output folder of all jobs.
        execution: How to carry them out.
        ended: Function that is called with each job that ended, and its record in the journal.
        planned: Function that is called with the plan before the first job.
    """
    has_journal, every = not writes_file(jobs), _outputs_of(jobs)
    lock = runs.locked(out, execution.shard) if has_journal else nullcontext(lambda: None)
    labels = {label for outputs in every for label in outputs.labels}
    with _output_folders(every, out), lock as require_lock:
        if has_journal and execution.shard is None:
            runs.sweep_up(out, labels)  # half-written files of killed runs
            runs.gather(out)
        elif execution.shard is not None:  # other shards write to OUT, too
            runs.refuse_other_division(out, execution.shard)
        plan = make_plan(jobs, out, execution)
        if planned is not None:
            planned(plan)
        state = _State(plan, execution)
        if plan.due or plan.moved:
            with _recording(state) if has_journal else nullcontext(lambda _: None) as append:
                for number, stamps in plan.moved.items():
                    job, record = plan.jobs[number], plan.recorded(number)
                    record = record.with_files(inputs={**record.inputs, **stamps})
                    append(copy(record, split=job.split.name))

                def done(number: int, end: End) -> None:
                    require_lock()
                    record = state.done(number, end, append)
                    if ended is not None:
                        ended(plan.jobs[number], record)

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
            _tell_backs(state)
    return state.summary


@contextmanager
def _recording(state: _State) -> Iterator[Callable[[Record], None]]:
    """Open the journal during the block; yields the function that appends records.

    The index is removed before. A note of the run stays in the output folder if jobs are left.
    """
    plan, shard = state.plan, state.execution.shard
    out, records = plan.ledger.out, plan.ledger.counts()
    names = (job.sample_id for job in plan.jobs_of(plan.due, plan.later))
    path = runs.note_run(out, shard, {name: records[name] for name in names})
    if (out / runs.INDEX).exists():
        from defocus_core.batch.datasets import update

        state.withdrawn = update.withdraw(out)
    try:
        own = journal_path(out, shard)
        with Journal(own, plan.ledger.end_of(own), plan.began) as journal:
            yield journal.append
    except BaseException:
        if len(plan.jobs) == 1 and not plan.began():
            path.unlink(missing_ok=True)
        raise
    if not state.summary.left or state.summary.error is not None:
        path.unlink(missing_ok=True)


def _index(asked: Collection[str], state: _State) -> None:
    """If anything changed, write the index of the `asked` samples, or of those listed before."""
    plan, summary, execution = state.plan, state.summary, state.execution
    out, is_other = plan.ledger.out, bool(plan.due or plan.moved)
    if execution.source is not None:
        from defocus_core.request import origin

        is_other |= origin.keep(out, execution.source)
    names = asked if execution.has_index else state.withdrawn
    if names is not None and execution.shard is None and not summary.interrupted:
        from defocus_core.batch.datasets import sample_index, update

        is_other |= execution.shards_size is not None
        is_ok, last = plan.ledger.is_ok, plan.ledger.last.get
        settled = plan.jobs_of(() if is_other else plan.settled)
        there = {j.sample_id for j in settled if any(is_ok(last(n)) for n in j.names.values())}
        if is_other or sample_index.listed(out) != there:
            summary.written = update.index(out, execution.shards_size, names)


def _tell_backs(state: _State) -> None:
    """Warn if older pictures were rendered by another back, torch or compiled, than new ones."""
    ledger, made = state.plan.ledger, state.backs
    stay = ledger.live() if state.plan.settled and made else ()
    before = {ledger.outcomes[number].back for number in stay} - {""}
    if before and before != made:
        earlier, later = (" and ".join(sorted(backs)) for backs in (before, made))
        note(f"{ledger.out}: earlier pictures are by {earlier}, those of this run by {later}")


@contextmanager
def _output_folders(every: Collection[Outputs], out: Path) -> Iterator[None]:
    """Create `out` for the block; at its end, remove new folders that are empty."""
    for outputs in every:
        _check_folders(outputs, os.W_OK | os.X_OK)
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
    """The progress of a run: counts of ended jobs, and whether to stop."""

    def __init__(self, plan: Plan, execution: Execution) -> None:
        self.plan, self.execution = plan, execution
        jobs, settled = len(plan.jobs), len(plan.settled)
        self.summary = Summary(jobs, settled, jobs - settled, again=plan.again, kept=plan.kept)
        self.interrupts = Interrupts(patient=len(plan.due) > 1)
        self.withdrawn: set[str] | None = None  # samples of the removed index
        self.backs: set[str] = set()  # backs of the new pictures
        self.stopping = False

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Measure the time of the block, and note whether Ctrl-C was pressed in it."""
        start = time.perf_counter()
        try:
            with self.interrupts:
                yield
        finally:
            self.summary.seconds = time.perf_counter() - start
        self.summary.interrupted = self.interrupts.asked

    def stopped(self) -> bool:
        return self.stopping or self.interrupts.asked

    def chunks(self) -> Iterator[Chunk]:
        """Yield the due jobs in chunks, small enough to keep all workers busy.

        A chunk has consecutive jobs of one picture.
        """
        due = self.plan.due
        size = max(1, min(MAX_IN_A_CHUNK, len(due) // (4 * self.execution.spread)))
        numbered = zip(due, self.plan.jobs_of(due), strict=True)
        for _, of_picture in groupby(numbered, key=lambda each: each[1].picture):
            while chunk := [*islice(of_picture, size)]:
                if self.stopped():
                    return
                yield chunk

    def done(self, number: int, end: End, append: Callable[[Record], None]) -> Record:
        """Count an ended job and append its record to the journal; returns the record.

        With `Execution.raises`, a failed job is not recorded, but its error is kept. InputError is
        raised if no space is left on the disk.
        """
        record, summary = self.record(number, end), self.summary
        if isinstance(end, Failed) and self.execution.raises:
            summary.error = end.error
        elif end.reason == "no-space":
            path, _, problem = end.message.partition(": ")
            raise InputError("no-space", problem, path=path)  # no other job will find space
        else:
            append(record)
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
        return record

    def record(self, number: int, end: End) -> Record:
        job, out = self.plan.jobs[number], self.plan.ledger.out
        places = {role: input_path(path, out) for role, path in job.files.items()}
        inputs = {r: copy(end.inputs.get(r, Stamp()), path=place) for r, place in places.items()}
        outputs = end.outputs or {name: Stamp(path) for name, path in job.names.items()}
        return Record(
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

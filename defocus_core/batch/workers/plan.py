"""The plan of a batch: how its jobs are done, which are done already, and which are left to do."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from defocus_core.batch.journal.journal import Ledger, Shard
from defocus_core.batch.journal.record import End, Stamps
from defocus_core.batch.journal.resume import AGAIN, Decision, decided, refuse_others
from defocus_core.errors import InputError
from defocus_core.io.safe_files import missing
from defocus_core.request.job import Job, Outputs
from defocus_core.system.memory import without_collections
from defocus_core.system.text import counted, note

if TYPE_CHECKING:
    from defocus_core.request.origin import JobsSource

Chunk = list[tuple[int, Job]]  # jobs of one picture, with their numbers
Done = Callable[[int, End], None]
Execute = Callable[[Iterator[Chunk], Done, Callable[[], bool]], None]


@dataclass(frozen=True)
class Execution:
    """The way to carry out a batch."""

    # Does jobs; called with chunks of them, with the function to call with the number and
    # end of each job, and with the function that tells that no further job is to be begun
    execute: Execute
    shard: Shard | None = None  # which part of the batch; None for all of it
    limit: int | None = None  # at most so many jobs
    fail_fast: bool = False  # stop at the first job that fails
    read_inputs: bool = False  # compare the bytes of inputs, not only their size and time
    new_only: bool = False  # leave what has outputs, whatever changed
    keep_lenses: bool = False  # refuse to replace pictures of another lens or view
    raises: bool = False  # a lone job that fails leaves nothing, and its error ends the run
    spread: int = 1  # over how many workers the jobs of one picture are to be spread
    has_index: bool = False  # an index of what is asked for is left; else one that is there is true
    shards_size: int | None = None  # bytes of a tar beside it; None to pack only where some are
    source: JobsSource | None = None  # what is kept of the jobs file; None if there is none


_DUE, _LATER = 1, 2  # marks of jobs that are to do, now or beyond the limit; 0 of the others


@dataclass
class Plan:
    """Which jobs of a run are to do: a mark for each, of which the jobs are made when asked for."""

    jobs: Sequence[Job]
    ledger: Ledger
    marks: bytearray = field(default_factory=bytearray)
    # Of jobs that are done, by number: inputs that lie elsewhere now, or none if the split changed
    moved: dict[int, Stamps] = field(default_factory=dict)
    again: Counter[str] = field(default_factory=Counter)  # why jobs are done again, in words
    kept: Counter[str] = field(default_factory=Counter)  # why those would be that are left

    @property
    def due(self) -> int:
        """How many jobs are to be done now."""
        return self.marks.count(_DUE)

    @property
    def later(self) -> int:
        """How many jobs the limit puts off."""
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
        """The jobs that are done, or rejected."""
        return (job for job, mark in zip(self.jobs, self.marks, strict=True) if not mark)

    def began(self) -> bool:
        """Whether an output of the jobs to do is there."""
        return any(os.path.lexists(path) for _, job in self.todo for path in job.written)


@without_collections()
def make_plan(jobs: Sequence[Job], out: Path, execution: Execution) -> Plan:
    """Find which jobs of a batch are to do; what must not be touched is refused."""
    refuse_misplaced(jobs)
    if execution.has_index:
        from defocus_core.batch.datasets import update

        named = {job.sample_id: job.split.name for job in jobs}
        update.refuse_foreign(out, named, packs=execution.shards_size is not None)
    is_file, forced = writes_file(jobs), any(job.outputs.overwrite for job in jobs)
    ledger = Ledger(out, is_empty=is_file)
    if any(job.split.choices for job in jobs):
        from defocus_core.request.splits import with_recorded

        jobs = with_recorded(jobs, {} if forced else ledger.splits)
    plan = Plan(jobs if execution.shard is None else _part(jobs, execution.shard), ledger)
    left = len(plan.jobs) if execution.limit is None else execution.limit
    for number, job in enumerate(plan.jobs):
        found = Decision(False)
        if not forced:
            found = decided(job, ledger, read_inputs=execution.read_inputs)
        is_kept = execution.new_only and found.again and _has_outputs(job, ledger)
        if is_kept:
            plan.kept[found.again] += 1
        elif found.again and found.again != AGAIN["failed"]:
            plan.again[found.again] += 1
        if found.moved is not None:
            plan.moved[number] = found.moved
        is_settled = found.is_done or is_kept
        plan.marks.append(0 if is_settled else _DUE if left else _LATER)
        left -= bool(left) and not is_settled
    refuse_others(plan.unfinished, ledger, keep_lenses=execution.keep_lenses)
    own = _own_without_record(plan.unfinished, ledger, is_file=is_file)
    refuse_unknown(plan.unfinished, lambda name: name in own or ledger.is_known(name))
    return plan


def writes_file(jobs: Sequence[Job]) -> bool:
    """Whether a lone picture is written to a file of a name, beside which no journal stands."""
    return any(job.outputs.file for job in jobs)


def _has_outputs(job: Job, ledger: Ledger) -> bool:
    """Whether a record has all files of a job as written, and they are there."""
    number = ledger.number_of(job.names.values())
    return ledger.is_ok(number) and all(map(os.path.exists, job.written))


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


_NAME_BYTES = 255  # the longest name of a file on Linux


def refuse_misplaced(jobs: Sequence[Job]) -> None:
    """Refuse jobs that get in the way of one another or of their inputs."""
    _refuse_clashes(jobs)
    every = {id(job.outputs): job.outputs for job in jobs}.values()  # a hash of each takes long
    for outputs in {*every}:
        list(_places_of(outputs))
    folders = {folder.resolve() for outputs in every for folder in outputs.folders}
    pictures = {id(job.picture): job.picture for job in jobs}.values()
    named = [str(path) for picture in pictures for path in picture.files.values()]
    # Path.resolve raises where a link leads in a circle; its reader names that.
    named += [os.path.realpath(path) for path in named if os.path.islink(path)]  # noqa: PTH114
    split = [os.path.split(path) for path in named]
    places = {folder: Path(folder).resolve() for folder in {folder for folder, _ in split}}
    if folders.isdisjoint(places.values()):  # a batch has many outputs, and hardly ever such inputs
        return
    inputs = {places[folder] / name for folder, name in split}
    for path in (path for job in jobs for path in job.written):
        if path.parent.resolve() / path.name in inputs:
            problem = "is an input and would be overwritten"
            raise InputError("replaces-input", problem, "choose another -o", path=path)


def _refuse_clashes(jobs: Sequence[Job]) -> None:
    count = Counter((str(job.outputs.root), name) for job in jobs for name in job.names.values())
    for (root, name), times in count.items():
        length = len(os.fsencode(name.rpartition("/")[2]))
        if times > 1:
            problem, remedy = "would be written twice", "rename one of the colour files"
            raise InputError("duplicate", problem, remedy, path=Path(root, name))
        if length > _NAME_BYTES:
            problem = f"has a name of {length} bytes, more than {_NAME_BYTES}"
            remedy = "give the picture a shorter name or stem"
            raise InputError("too-large", problem, remedy, path=Path(root, name))


def refuse_unknown(jobs: Iterable[Job], is_known: Callable[[str], bool]) -> None:
    """Refuse to replace files that no job is known to have written."""
    existing, journal = list[Path](), ""
    for job in jobs:
        root, overwrite = job.outputs.root, job.outputs.overwrite
        for name in job.names.values():
            path = root / name
            if path.is_dir():
                problem = "is a directory where a file is to be written"
                raise InputError("wrong-type", problem, "choose another -o", path=path)
            if not overwrite and os.path.lexists(path) and not is_known(name):
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


def _own_without_record(jobs: Iterable[Job], ledger: Ledger, *, is_file: bool) -> set[str]:
    """The files of jobs, relative to OUT, that this program wrote and no journal knows.

    Beside a journal nothing tells how they were done: their jobs are done again, as a line says.
    """
    out = ledger.out
    if not is_file and not any(out.glob("journal*.jsonl")):
        return set()
    from defocus_core.io.images.encode import is_own

    names = {name for job in jobs for name in job.names.values() if not ledger.is_known(name)}
    own = {name for name in names if os.path.lexists(out / name) and is_own(out / name)}
    if own and not is_file:
        note(f"{out}: the journal no longer knows {counted(len(own), 'output')}, done again")
    return own


def refuse_unwritable(outputs: Outputs) -> None:
    """Refuse a place where nothing can be written."""
    for place in _places_of(outputs):
        if not os.access(place, os.W_OK | os.X_OK):
            raise InputError("unwritable", "cannot be written to", "choose another -o", path=place)


def _places_of(outputs: Outputs) -> Iterator[Path]:
    """The folders of outputs, or the nearest above each that there is."""
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

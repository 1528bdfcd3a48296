"""Output paths checked by name before any work: collisions, and files that must not be replaced."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from defocus_core.batch.jobs.job import Job, Outputs
from defocus_core.errors import InputError
from defocus_core.io.safe_files import missing
from defocus_core.system.text import counted, note

_NAME_BYTES = 255  # the longest name of a file on Linux


def refuse_misplaced(jobs: Sequence[Job]) -> None:
    """Refuse jobs that get in the way of one another or of their inputs."""
    _refuse_clashes(jobs)
    for outputs in _outputs_of(jobs):
        list(_places_of(outputs))


def _outputs_of(jobs: Sequence[Job]) -> Collection[Outputs]:
    """The outputs of jobs, most of which share theirs, without a hash of each."""
    return set({id(job.outputs): job.outputs for job in jobs}.values())


def refuse_unknown(jobs: Sequence[Job], known: Collection[str]) -> None:
    """Refuse to replace files that no job is known to have written."""
    existing = []
    for job in jobs:
        root, overwrite = job.outputs.root, job.outputs.overwrite
        for name in job.names.values():
            path = root / name
            if path.is_dir():
                problem = "is a directory where a file is to be written"
                raise InputError("wrong-type", problem, "choose another -o", path=path)
            if not overwrite and name not in known and os.path.lexists(path):
                existing.append(path)
    if existing:
        is_lone = bool(jobs[0].outputs.file)
        others = f" (and {len(existing) - 1} more)" if len(existing) > 1 else ""
        raise InputError(
            "exists",
            f"exists already{others}{'' if is_lone else ', and the journal does not know it'}",
            "move it away, choose another -o, or add ‹overwrite› to render all again",
            path=existing[0],
        )


def own_without_record(jobs: Sequence[Job], out: Path, known: Collection[str]) -> set[str]:
    """The files of jobs, relative to OUT, that this program wrote and no journal knows.

    Their jobs are done again, for nothing tells how they were done; a line says it.
    """
    if not any(out.glob("journal*.jsonl")):
        return set()
    from defocus_core.io.images.encode import is_own

    names = {name for job in jobs for name in job.names.values() if name not in known}
    own = {name for name in names if os.path.lexists(out / name) and is_own(out / name)}
    if own:
        note(f"{out}: the journal no longer knows {counted(len(own), 'output')}, done again")
    return own


def refuse_names(stems: Sequence[str], outputs: Outputs) -> None:
    """Refuse names of samples that two have, or that are too long for a file."""
    count = Counter(stems)
    twice = next((stem for stem, times in count.items() if times > 1), None)
    if twice is not None:
        raise _written_twice(outputs.root / next(iter(outputs.names(twice).values())))
    for name in outputs.names(max(count, key=lambda stem: len(os.fsencode(stem)))).values():
        _refuse_long(outputs.root, name)


def _written_twice(path: Path) -> InputError:
    return InputError(
        "duplicate", "would be written twice", "rename one of the colour files", path=path
    )


def _refuse_long(root: Path, name: str) -> None:
    length = len(os.fsencode(name.rpartition("/")[2]))
    if length > _NAME_BYTES:
        problem = f"has a name of {length} bytes, more than {_NAME_BYTES}"
        raise InputError(
            "too-large", problem, "give the picture a shorter name or stem", path=root / name
        )


def _refuse_clashes(jobs: Sequence[Job]) -> None:
    count = Counter((job.outputs.root, name) for job in jobs for name in job.names.values())
    twice = next((root / name for (root, name), times in count.items() if times > 1), None)
    if twice is not None:
        raise _written_twice(twice)
    for root, name in count:
        _refuse_long(root, name)
    pictures = set({id(job.picture): job.picture for job in jobs}.values())
    pictures |= {other for picture in pictures for other in picture.others.values()}
    named = {path for one in pictures for path in (one.color, one.depth)}
    # Path.resolve raises where a link leads in a circle; its reader names that.
    named |= {Path(os.path.realpath(path)) for path in named if path.is_symlink()}
    places = {folder: folder.resolve() for folder in {path.parent for path in named}}
    own = {folder.resolve() for outputs in _outputs_of(jobs) for folder in outputs.folders}
    inputs = {place / path.name for path in named if (place := places[path.parent]) in own}
    if not inputs:  # a batch has many outputs, and hardly ever such inputs
        return
    for path in (path for job in jobs for path in job.written):
        if path.parent.resolve() / path.name in inputs:
            raise InputError(
                "replaces-input",
                "is an input and would be overwritten",
                "choose another -o",
                path=path,
            )


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

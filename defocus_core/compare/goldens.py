"""A folder of goldens: pictures, beside them a file a sample of how it was made; and made anew.

``SAMPLE.golden.json`` names the files of a sample, and the settings, bytes of inputs, versions and
machine that made them: a file each, so that branches that add samples merge. A golden.json of all
samples, as version 0.1.0 wrote it, is read, too; what is accepted takes its place.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from defocus_core.batch.journal import resume
from defocus_core.batch.journal.journal import Ledger
from defocus_core.batch.journal.record import output_fault
from defocus_core.batch.workers import run
from defocus_core.batch.workers.run import Execution, Listener, Summary
from defocus_core.compare.pairing import FilePair
from defocus_core.compare.record import EXTRA, MISSING, Comparison
from defocus_core.compare.run import Task, compare_all
from defocus_core.compare.thresholds import matches
from defocus_core.errors import InputError, UsageProblem, did_you_mean, reason
from defocus_core.io.arrays import scratch_folder
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import (
    MALFORMED,
    unwritable,
    written_together,
    written_whole,
)
from defocus_core.request.job import Job, Machine, Outputs
from defocus_core.request.jobs_file import read_jobs

SUFFIX = ".golden.json"  # of the file of a sample
_LIST = "golden.json"  # of all samples, as it was once
_LARGEST = 2**28  # bytes of either
_CONFLICT = (b"<<<<<<<", b"=======", b">>>>>>>")  # how git begins lines that it could not merge
Samples = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Store:
    """What a folder of goldens holds."""

    folder: Path
    # By sample, how its pictures were made: settings, inputs, versions, machine, files
    samples: Samples
    listed: Samples = field(default_factory=dict)  # those of an old golden.json

    def only(self, names: Collection[str]) -> Store:
        """The samples of these names; the others are neither looked at nor changed."""
        chosen = {name: sample for name, sample in self.samples.items() if name in names}
        return replace(self, samples=chosen)

    def changes(self, fresh: FreshPictures) -> dict[str, list[str]]:
        """Inputs of other bytes, and settings other than those of the goldens, a line each."""
        inputs, settings = [], []
        for job in fresh.jobs:
            name, stored = job.sample_id, self.samples.get(job.sample_id, {})
            was, now = stored.get("inputs", {}), fresh.inputs.get(name, {})
            inputs += [
                f"{name}: {role} has other bytes than when its golden was accepted"
                for role in sorted(was.keys() & now.keys())
                if was[role] != now[role]
            ]
            old, new = stored.get("settings", {}), resume.settings(job)
            settings += [
                f"{name}: {key:.200} {now} instead of {was!s:.200}"
                for key, was, now in (resume.changed_settings(old, new) if stored else ())
            ]
        return {"inputs": inputs, "settings": settings}

    def place(self, name: str) -> Path | None:
        """The path of a golden, None if it is missing."""
        try:
            path = Folder(self.folder).path(name)
        except OSError as error:
            problem, remedy = f"cannot be read: {reason(error)}", "put the picture itself there"
            raise InputError("link", problem, remedy, path=self.folder / name) from None
        return path if path.exists() else None

    @property
    def files(self) -> set[str]:
        """Files of all samples, relative to the folder."""
        return {file for sample in self.samples.values() for file in sample.get("files", ())}


def read_store(folder: Path, *, anew: bool = False) -> Store:
    """The goldens of a folder; nothing is changed.

    `anew`: whether there may be none yet.
    """
    names = Folder(folder).names() if folder.is_dir() else []
    old = _read(folder, _LIST) if _LIST in names else {"samples": {}}
    listed = old.get("samples") if isinstance(old, dict) else None
    if not isinstance(listed, dict):
        raise _damaged(folder / _LIST, "cannot be read: it has no table of samples")
    own = {n.removesuffix(SUFFIX): _read(folder, n) for n in names if n.endswith(SUFFIX)}
    listed = {name: sample for name, sample in listed.items() if name not in own}
    samples = {**listed, **own}
    for name, sample in samples.items():
        if fault := _sample_fault(sample):
            raise _damaged(folder / (_LIST if name in listed else f"{name}{SUFFIX}"), fault)
    if not samples and not anew:
        remedy = "make them with 'defocus golden update ‹accept›'"
        raise InputError("not-found", "holds no goldens", remedy, path=folder)
    return Store(folder, samples, listed)


def _read(folder: Path, name: str) -> Any:
    data = b""
    try:
        with Folder(folder).open(name) as opened:
            data = opened.read(_LARGEST)
        return json.loads(data)
    except (OSError, *MALFORMED) as error:
        fault = f"cannot be read: {reason(error)}"
        if any(line.startswith(_CONFLICT) for line in data.splitlines()):
            problem, remedy = "has conflict markers of a merge", "take one side, then accept anew"
            raise InputError("damaged", problem, remedy, path=folder / name) from None
        raise _damaged(folder / name, fault) from None


def _damaged(path: Path, fault: str) -> InputError:
    return InputError("damaged", fault, "restore it from your version control", path=path)


def _sample_fault(sample: object) -> str | None:
    """What is wrong with a sample; None if nothing is. Its names are foreign."""
    if not isinstance(sample, dict):
        return "cannot be read: it has a sample that is not a table"
    if not isinstance(sample.get("files"), list):
        return "has no list of files"
    for name in ("settings", "inputs"):
        if not isinstance(sample.get(name, {}), dict):
            return f"has {name} that are not tables"
    for name in sample["files"]:
        if fault := output_fault(name):
            return f"names the golden {name!r:.80}, which {fault}"
    return None


def accept(store: Store, fresh: FreshPictures, records: Sequence[Comparison]) -> None:
    """Make new pictures goldens, and remove the goldens that no job asks for.

    What is new appears together, or nothing of it.
    """
    folder, jobs = Folder(store.folder), fresh.jobs
    new = {record.name for record in records if not record.passes and record.status != MISSING}
    samples = {name: sample for name, sample in store.listed.items() if name not in store.samples}
    for job in jobs:
        name, stored = job.sample_id, store.samples.get(job.sample_id, {})
        asked = resume.settings(job), sorted(job.names.values()), fresh.inputs.get(name, {})
        made = dict(zip(("settings", "files", "inputs"), asked, strict=True))
        if new & set(made["files"]) or any(stored.get(key) != made[key] for key in made):
            samples[name] = {**made, **_made_by()}
        elif name in store.listed:
            samples[name] = stored
    try:
        gone = store.files - {name for job in jobs for name in job.names.values()}
        lost = {f"{name}{SUFFIX}" for name in store.samples.keys() - {j.sample_id for j in jobs}}
        for name in (*new, *gone, *lost, _LIST):
            folder.path(name)  # refused before anything is replaced
        with written_together(store.folder):
            for name in sorted(new):
                source = Folder(fresh.root).open(name)
                with source, written_whole(store.folder / name) as file:
                    shutil.copyfileobj(source, file)
            for name, sample in samples.items():
                with written_whole(store.folder / f"{name}{SUFFIX}") as file:
                    file.write(json.dumps(sample, indent=1, sort_keys=True).encode() + b"\n")
        for name in (*sorted(gone), *sorted(lost), _LIST):
            folder.remove(name)
    except OSError as error:
        raise unwritable(store.folder, error) from error


def compared(
    store: Store, fresh: FreshPictures, task: Task, processes: int
) -> Iterator[Comparison]:
    """The new pictures by the goldens; other files in the folder are not looked at."""
    there = {name: path for name in store.files if (path := store.place(name))}
    names = sorted({*store.files, *fresh.files})
    pairs = [FilePair(name, there.get(name), fresh.files.get(name)) for name in names]
    asked = {name for job in fresh.jobs for name in job.names.values()}
    for record in compare_all(pairs, task, processes):
        if record.status == EXTRA:
            deleted = "its golden was deleted; restore it from your version control, or accept anew"
            error = deleted if record.name in store.files else "a new case, without a golden yet"
        elif record.status == MISSING:
            error = "no picture was made" if record.name in asked else "no job asks for it any more"
        else:
            error = record.error
        yield replace(record, error=error)


def change_words(record: Comparison) -> str:
    """What accepting a picture does: ``new``, ``removed`` or ``changed``."""
    return {EXTRA: "new", MISSING: "removed"}.get(record.status, "changed")


def _made_by() -> dict[str, Any]:
    import torch

    machine = {
        "system": platform.system(),
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "torch": torch.__version__,
    }
    return {**resume.versions(), "machine": machine}


@dataclass(frozen=True)
class FreshPictures:
    """Pictures that were rendered: their jobs, the folder they are in, and how the batch ended."""

    jobs: Sequence[Job]
    root: Path
    summary: Summary

    @cached_property
    def inputs(self) -> dict[str, dict[str, str | None]]:
        """By sample that was made, the hash of the bytes of each of its inputs by role."""
        return {
            record.sample_id: {role: stamp.blake2b for role, stamp in record.inputs.items()}
            for record in Ledger(self.root).records()
            if record.taken is not None
        }

    @property
    def files(self) -> dict[str, Path]:
        """The files that are there, by their path relative to the folder."""
        names = (name for job in self.jobs for name in job.names.values())
        return {name: self.root / name for name in names if (self.root / name).is_file()}

    @property
    def complete(self) -> bool:
        """Whether every job made its pictures."""
        return self.summary.statuses["ok"] == len(self.jobs)


@contextmanager
def rendered(
    jobs_file: Path,
    machine: Machine,
    execution: Execution,
    listener: Listener,
    only: Sequence[str] = (),
) -> Iterator[FreshPictures]:
    """Render the jobs of a jobs file to a folder that is there in the block."""
    try:
        root = Path(tempfile.mkdtemp(prefix="defocus-golden-", dir=scratch_folder()))
    except OSError as error:
        raise unwritable(scratch_folder(), error) from error
    try:
        jobs = _chosen(read_jobs(jobs_file, Outputs(root), machine), only)
        yield FreshPictures(jobs, root, run.run(jobs, root, execution, listener))
    finally:
        shutil.rmtree(root, ignore_errors=True)


def _chosen(jobs: Sequence[Job], only: Sequence[str]) -> Sequence[Job]:
    """The jobs that write a picture whose name matches one of the patterns, if there are any."""
    for pattern in only:
        if not any(matches(name, pattern) for job in jobs for name in job.names.values()):
            names = sorted(name for job in jobs for name in job.names.values())
            remedy = f"name one like {names[0]}, or '{Path(names[0]).parent.as_posix()}/*'"
            problem = f"'{pattern}' matches no picture of the jobs"
            raise UsageProblem("empty", problem, did_you_mean(pattern, names, remedy), field="only")
    wanted = [
        job
        for job in jobs
        if any(matches(name, pattern) for name in job.names.values() for pattern in only)
    ]
    return wanted if only else jobs

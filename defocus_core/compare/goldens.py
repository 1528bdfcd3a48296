"""A folder of goldens: pictures, golden.json with how each was made; and the same rendered anew."""

from __future__ import annotations

import json
import os
import platform
import shutil
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from defocus_core.batch.journal import identity
from defocus_core.batch.journal.record import output_fault
from defocus_core.batch.workers import run
from defocus_core.batch.workers.plan import Execution
from defocus_core.batch.workers.run import Listener, Summary
from defocus_core.compare.record import EXTRA, MISSING, Comparison
from defocus_core.compare.thresholds import matches
from defocus_core.errors import InputError, UsageProblem, did_you_mean, reason
from defocus_core.io.arrays import scratch_folder
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import MALFORMED, missing, unwritable, written_whole
from defocus_core.request.job import Job, Machine, Outputs
from defocus_core.request.jobs_file import read_jobs

MANIFEST = "golden.json"
_ASIDE = ".accepting"  # folder of what is being accepted; complete once it has golden.json
_LARGEST = 2**28  # bytes of golden.json


@dataclass(frozen=True)
class Store:
    """What a folder of goldens holds."""

    folder: Path
    # By sample, how its pictures were made: settings, versions, machine, files
    samples: Mapping[str, Mapping[str, Any]]
    # Samples that are neither looked at nor changed
    aside: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def only(self, names: Collection[str]) -> Store:
        """The samples of these names; the others are put aside."""
        chosen = {name: sample for name, sample in self.samples.items() if name in names}
        others = {name: sample for name, sample in self.samples.items() if name not in names}
        return Store(self.folder, chosen, others)

    def changed_settings(self, jobs: Sequence[Job]) -> list[str]:
        """The settings of jobs that differ from those of their goldens, a line for each."""
        lines = []
        for job in jobs:
            stored = self.samples.get(job.sample_id)
            if stored is None:
                continue
            changes = identity.changed_settings(stored.get("settings", {}), identity.settings(job))
            lines += [
                f"{job.sample_id}: {key:.200} {now} instead of {was!s:.200}"
                for key, was, now in changes
            ]
        return lines

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


def read_store(folder: Path) -> Store:
    """Read golden.json of a folder; nothing is changed."""
    if (folder / _ASIDE / MANIFEST).is_file():
        problem = "has an accepted update that was interrupted"
        remedy = "end it with 'defocus golden update'"
        raise InputError("damaged", problem, remedy, path=folder)
    store = _read(folder)
    if store is None:
        remedy = "make goldens with 'defocus golden update ‹accept›'"
        raise missing(folder / MANIFEST, remedy=remedy)
    return store


def store_to_update(folder: Path) -> Store:
    """The goldens of a folder, or none yet; an accepted update that was interrupted is ended."""
    _finish(folder)
    return _read(folder) or Store(folder, {})


def _read(folder: Path) -> Store | None:
    """The goldens that a golden.json lists; None if there is none. Its names are foreign."""
    fault, samples = "", dict[str, Any]()
    try:
        with Folder(folder).open(MANIFEST) as opened:
            samples = json.loads(opened.read(_LARGEST))["samples"]
        fault = next(filter(None, map(_sample_fault, samples.values())), "")
    except FileNotFoundError:
        return None
    except (OSError, *MALFORMED) as error:
        fault = f"cannot be read: {reason(error)}"
    if fault:
        restore = "restore it from your version control"
        raise InputError("damaged", fault, restore, path=folder / MANIFEST)
    return Store(folder, samples)


def _sample_fault(sample: object) -> str | None:
    """What is wrong with a sample of golden.json; None if nothing is. Its names are foreign."""
    if not isinstance(sample, dict):
        return "cannot be read: it has a sample that is no table"
    if not isinstance(sample.get("files"), list):
        return "has no list of files"
    if not isinstance(sample.get("settings", {}), dict):
        return "has settings that are no table"
    for name in sample["files"]:
        if fault := output_fault(name):
            return f"names the golden {name!r:.80}, which {fault}"
    return None


def accept(store: Store, jobs: Sequence[Job], root: Path, records: Sequence[Comparison]) -> int:
    """Make new pictures goldens, and remove the goldens that no job asks for; their number.

    Pictures and golden.json change together: all are written aside first, golden.json last, and
    then take their places. Where that is interrupted, `store_to_update` ends it.
    """
    changed = [record for record in records if not record.passes]
    aside = store.folder / _ASIDE
    try:
        shutil.rmtree(aside, ignore_errors=True)
        for record in changed:
            Folder(store.folder).path(record.name)  # refused before anything is replaced
            if record.status != MISSING:
                path = aside / record.name
                with Folder(root).open(record.name) as source, written_whole(path, aside) as file:
                    shutil.copyfileobj(source, file)
        written = {record.name for record in changed if record.status != MISSING}
        samples = {name: dict(sample) for name, sample in store.aside.items()}
        for job in jobs:
            files = sorted(job.names.values())
            stored = store.samples.get(job.sample_id)
            if stored is None or written & set(files) or stored["files"] != files:
                stored = {"settings": identity.settings(job), "files": files, **_made_by()}
            samples[job.sample_id] = dict(stored)
        with written_whole(aside / MANIFEST) as file:
            file.write(json.dumps({"samples": samples}, indent=1, sort_keys=True).encode())
    except (OSError, InputError) as error:
        shutil.rmtree(aside, ignore_errors=True)
        if isinstance(error, InputError):
            raise
        raise unwritable(store.folder, error) from error
    _finish(store.folder)
    return len(changed)


def _finish(folder: Path) -> None:
    """End an acceptance whose files are all there, and clear one away that is not.

    Only goldens that one of the two lists has are moved or removed.
    """
    aside = folder / _ASIDE
    if aside.is_symlink() or not aside.is_dir():
        return
    if (accepted := _read(aside)) is not None:
        before = _read(folder) or Store(folder, {})
        try:
            gone = sorted(before.files - accepted.files)
            new = [name for name in sorted(accepted.files) if Folder(aside).path(name).exists()]
            for name in (*gone, *new, MANIFEST):  # all are vetted before the first is touched
                Folder(folder).path(name)
            for name in gone:
                Folder(folder).remove(name)
            for name in (*new, MANIFEST):  # golden.json last
                (folder / name).parent.mkdir(exist_ok=True)
                (aside / name).replace(folder / name)
        except OSError as error:
            problem = f"cannot be put into its place: {reason(error)}"
            remedy = f"mend that, or remove {aside}"
            raise InputError("unwritable", problem, remedy, path=aside) from error
    shutil.rmtree(aside, ignore_errors=True)


def change_words(record: Comparison) -> str:
    """What accepting a picture does: ``new``, ``removed`` or ``changed``."""
    return {EXTRA: "new", MISSING: "removed"}.get(record.status, "changed")


def _made_by() -> dict[str, Any]:
    """Versions and machine."""
    import torch

    machine = {
        "system": platform.system(),
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "torch": torch.__version__,
    }
    return {**identity.versions(), "machine": machine}


@dataclass(frozen=True)
class FreshPictures:
    """Pictures that were rendered: their jobs, the folder they are in, and how the batch ended."""

    jobs: Sequence[Job]
    root: Path
    summary: Summary

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

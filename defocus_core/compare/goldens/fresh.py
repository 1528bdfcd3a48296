"""Pictures of a jobs file rendered anew, in a folder that is removed afterwards."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from defocus_core.batch.jobs.job import Job, Machine, Outputs
from defocus_core.batch.jobs.jobs_file import read_jobs
from defocus_core.batch.workers import run
from defocus_core.batch.workers.plan import Execution
from defocus_core.batch.workers.run import Listener, Summary
from defocus_core.compare.thresholds import matches
from defocus_core.errors import InputError, UsageProblem, did_you_mean, reason
from defocus_core.io.arrays import scratch_folder

_ROOM = 2**20  # bytes that a folder has free if it is not full


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
        raise _no_room(scratch_folder(), reason(error)) from error
    try:
        jobs = _chosen(read_jobs(jobs_file, Outputs(root), machine), only)
        try:
            made = FreshPictures(jobs, root, run.carry_out(jobs, root, execution, listener))
        except (OSError, InputError) as error:
            if _is_full(root):
                raise _no_room(root.parent, "it is full") from error
            raise
        if not made.complete and _is_full(root):
            raise _no_room(root.parent, "it is full")
        yield made
    finally:
        shutil.rmtree(root, ignore_errors=True)


def _is_full(folder: Path) -> bool:
    return shutil.disk_usage(folder).free < _ROOM


def _no_room(folder: Path, why: str) -> InputError:
    problem = f"has no room for the pictures that are rendered there: {why}"
    remedy = "free some, or let TMPDIR name another directory"
    return InputError("no-space", problem, remedy, path=folder)


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

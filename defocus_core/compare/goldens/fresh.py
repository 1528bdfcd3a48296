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
from defocus_core.errors import UsageProblem
from defocus_core.io.arrays import scratch_folder


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
    """Render the jobs of a jobs file to a folder that is there in the block.

    Args:
        jobs_file: the jobs file.
        machine: how to compute.
        execution: how the batch is carried out.
        listener: receives its events.
        only: patterns of pictures; jobs that write none of them are left out. Empty for all.

    Raises:
        InputError: the jobs file or a picture cannot be read, or there is no room.
        UsageProblem: the jobs file makes no sense, or no picture matches a pattern.
    """
    root = Path(tempfile.mkdtemp(prefix="defocus-golden-", dir=scratch_folder()))
    try:
        jobs = _chosen(read_jobs(jobs_file, Outputs(root), machine), only)
        summary = run.carry_out(jobs, root, execution, listener)
        yield FreshPictures(jobs, root, summary)
    finally:
        shutil.rmtree(root, ignore_errors=True)


def _chosen(jobs: Sequence[Job], only: Sequence[str]) -> Sequence[Job]:
    """The jobs that write a picture whose name matches one of the patterns, if there are any."""
    for pattern in only:
        if not any(matches(name, pattern) for job in jobs for name in job.names.values()):
            problem = f"'{pattern}' matches no picture of the jobs"
            raise UsageProblem(
                "empty", problem, "name one like render/spheres.exr, or 'render/*'", field="only"
            )
    wanted = [
        job
        for job in jobs
        if any(matches(name, pattern) for name in job.names.values() for pattern in only)
    ]
    return wanted if only else jobs

"""The report of a dry run: the jobs to do and the reasons, their files, and memory."""

from __future__ import annotations

import click

from defocus_cli.words import console
from defocus_cli.words.batch import job_line, job_record, reasons_lines
from defocus_core.batch.workers.run import Plan
from defocus_core.picture.forecast import forecasts
from defocus_core.system.text import counted


def report(plan: Plan, processes: int, *, each: bool, as_json: bool) -> None:
    """Report the jobs to do, ``each`` in a line, and on stderr those that would fail."""
    todo = [job for _, job in plan.todo]
    found, unusable = forecasts(todo) if todo else ({}, [])
    if each and len(plan.jobs) == len(unusable) == 1:
        raise unusable[0]  # as the command would
    for error in unusable:
        console.stderr(f"defocus: {error!s}")
    looked_at, files = len(found) + len(unusable), sum(len(job.names) for job in todo)
    done_before = len(plan.jobs) - plan.due - plan.later
    peak_mb = max((forecast.peak_mb for forecast in found.values()), default=None)
    if as_json:
        told = ({"forecast": found[k].record} if k in found else {} for k in range(len(todo)))
        pictures = [{**job_record(job), **more} for job, more in zip(todo, told, strict=True)]
        console.print_json(
            dry_run=True,
            jobs=len(plan.jobs),
            done_before=done_before,
            todo=len(todo),
            beyond_limit=plan.later,
            files=files,
            looked_at=looked_at,
            unusable=len(unusable),
            processes=processes,
            peak_mb=peak_mb,
            again=dict(plan.again),
            kept=dict(plan.kept),
            pictures=pictures,
        )
    else:
        for number, job in enumerate(todo if each else ()):
            console.stdout(job_line(job), *(str(found[k]) for k in (number,) if k in found))
        beyond = f", {plan.later} beyond the limit" if plan.later else ""
        done = f"{counted(done_before, 'job')} done before"
        console.stdout(f"{done}, {len(todo)} to do{beyond}, {counted(files, 'file')} to write")
        if peak_mb is not None:
            of_each = f" in each of {processes} processes" if processes > 1 else ""
            few = f", going by {len(found)} of them" if len(found) < len(todo) else ""
            console.stdout(f"at most {peak_mb:.0f} MB of memory{of_each}{few}")
        console.stdout(*reasons_lines(plan))
    if unusable:
        problem = f"{len(unusable)} of {looked_at} that were looked at would fail"
        raise click.ClickException(problem)

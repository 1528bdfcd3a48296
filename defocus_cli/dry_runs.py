"""What a dry run tells: what would be read and written, how long it takes and how much space."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import click

from defocus_cli import report
from defocus_cli.job import Job
from defocus_cli.plan import Plan


def tell(jobs: Sequence[Job], plan: Plan, *, as_json: bool) -> None:
    """Say it of each job; of those that are to do, some are looked at.

    Raises:
        InputError: an input cannot be used.
        UsageProblem: the options make no sense for a picture or this machine.
    """
    from defocus_cli import forecast

    todo = [job for job, _ in plan.todo]
    done = {job for job, _ in plan.settled}
    found = forecast.forecasts(todo) if todo else {}
    by_job = {todo[number]: each for number, each in found.items()}
    looked_at = list(found.values())
    if as_json:
        records = []
        for job in jobs:
            told = {"forecast": forecast.record(by_job[job])} if job in by_job else {}
            records.append({**report.plan_record(job), "done_before": job in done, **told})
        whole = forecast.total(looked_at, len(todo)) if todo else None
        report.print_json(dry_run=True, pictures=records, forecast=whole)
        return
    for job in jobs:
        click.echo(report.done_before_line(job) if job in done else report.plan_line(job))
        if job in by_job:
            click.echo(forecast.line(by_job[job]))
    for line in forecast.total_lines(looked_at, len(todo)) if todo else ():
        click.echo(line)

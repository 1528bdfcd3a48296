"""The report of a dry run: inputs, outputs, seconds, memory and disk space."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from defocus_cli.words import console
from defocus_cli.words.batch import done_before_line, job_line, job_record, reasons_lines
from defocus_core.batch.workers.run import Execution, Plan, make_plan
from defocus_core.errors import DefocusError, Rejected
from defocus_core.picture import forecast
from defocus_core.picture.forecast import Forecast
from defocus_core.request.job import Job, Outputs
from defocus_core.system.text import counted, duration

# Bytes of a pixel of three channels, of pictures that are neither flat nor noise.
_PIXEL_BYTES = {"half": 3.6, "float": 9.6, "png": 1.8, "png16": 4.5, "tiff": 4.5, "jpg": 0.5}
_PIXEL_BYTES |= {"webp": 0.4, "preview": 1.5, "map": 2.4}


def report_pictures(jobs: Sequence[Job], plan: Plan, *, as_json: bool) -> None:
    """Report each picture: what would be read and written, and the forecasts."""
    todo = [job for _, job in plan.todo]
    done = set(plan.settled)
    samples, unusable = _forecasts(todo, alone=len(jobs) == 1)
    by_job = {todo[number]: each for number, each in samples.items()}
    sampled = list(samples.values())
    if as_json:
        records = []
        for job in jobs:
            more = {"forecast": forecast.record(by_job[job])} if job in by_job else {}
            records.append({**job_record(job), "done_before": job in done, **more})
        whole = forecast.total(sampled, len(todo)) if sampled else None
        console.print_json(dry_run=True, pictures=records, forecast=whole, unusable=len(unusable))
    else:
        for job in jobs:
            line = done_before_line if job in done else job_line
            console.stdout(line(job))
            if job in by_job:
                console.stdout(forecast.line(by_job[job]))
        if sampled and len(todo) > 1:
            console.stdout(forecast.total_line(sampled, len(todo)))
        console.stdout(*reasons_lines(plan))
    _end(unusable, len(samples), "pictures")


def report_batch(
    jobs: Sequence[Job],
    out: Path,
    execution: Execution,
    processes: int,
    *,
    as_json: bool,
    verbose: bool,
) -> None:
    """Report a batch in a few lines, and each job if ``verbose``.

    Jobs that would fail or be rejected are named on stderr.
    """
    plan = make_plan(jobs, out, execution)
    todo = [job for _, job in plan.todo]
    done_before = len(plan.jobs) - plan.due - plan.later
    by_number, unusable = _forecasts(todo)
    samples = list(by_number.values())
    whole = forecast.total(samples, len(todo)) if samples else None
    totals = {
        "jobs": len(plan.jobs),
        "done_before": done_before,
        "todo": len(todo),
        "beyond_limit": plan.later,
        "looked_at": len(samples) + len(unusable),
        "processes": processes,
        "forecast": whole,
        "seconds": whole["seconds"] / processes if whole else 0.0,
        "bytes": round(_bytes(todo[0].outputs, samples, len(todo))) if samples else 0,
        "unusable": len(unusable),
        "again": dict(plan.again),
        "kept": dict(plan.kept),
    }
    if as_json:
        plans = [job_record(job) for job in todo]
        console.print_json(dry_run=True, **totals, pictures=plans)
    else:
        console.stdout(*(job_line(job) for job in todo if verbose))
        console.stdout(*_batch_lines(totals, len(samples)), *reasons_lines(plan))
    _end(unusable, len(samples), "jobs")


def _forecasts(
    todo: Sequence[Job], *, alone: bool = False
) -> tuple[Mapping[int, Forecast], Sequence[DefocusError]]:
    """Forecasts by number, and the errors of the other jobs, said or, of a lone job, raised."""
    if not todo:
        return {}, []
    samples, unusable = forecast.forecasts(todo)
    if alone and unusable:
        raise unusable[0]
    for error in unusable:
        console.stderr(f"defocus: {error!s}")
    return samples, unusable


def _batch_lines(totals: Mapping[str, Any], samples: int) -> Iterator[str]:
    todo, processes, whole = totals["todo"], totals["processes"], totals["forecast"]
    beyond = f", {totals['beyond_limit']} beyond the limit" if totals["beyond_limit"] else ""
    yield f"{counted(totals['done_before'], 'job')} done before, {todo} to do{beyond}"
    if unusable := totals["unusable"]:
        yield f"{unusable} of {samples + unusable} that were looked at would not be done"
    if whole is not None:
        few = f", going by {samples} of them" if samples < todo else ""
        crew = counted(processes, "process", "processes")
        yield (
            f"about {duration(totals['seconds'])} in {crew}, {totals['bytes'] / 10**9:.2g} GB "
            f"of files, {processes * whole['peak_mb']:.0f} MB of memory{few}"
        )


def _end(unusable: Sequence[DefocusError], usable: int, what: str) -> None:
    """Fail if a job would fail; one that would be rejected is no failure."""
    failing = sum(not isinstance(error, Rejected) for error in unusable)
    if failing:
        tried = usable + len(unusable)
        raise click.ClickException(f"{failing} of {tried} {what} that were looked at would fail")


def _bytes(outputs: Outputs, samples: Sequence[Forecast], count: int) -> float:
    """Bytes that so many jobs will write, to a factor of two."""
    pixels = sum(math.prod(each.size) for each in samples) / len(samples) * count
    image = _PIXEL_BYTES[outputs.exr_type if outputs.format == "exr" else outputs.format]
    each = sum(image if kind.image else _PIXEL_BYTES["map"] for kind in outputs.rows)
    return pixels * (each + outputs.preview * len(outputs.kinds) * _PIXEL_BYTES["preview"])

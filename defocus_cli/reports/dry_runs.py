"""The report of a dry run: inputs, outputs, seconds, memory and disk space."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from defocus_cli.batch.plan import Plan
from defocus_cli.jobs.job import Job
from defocus_cli.reports import job_report
from defocus_cli.system import console
from defocus_cli.system.console import counted
from defocus_cli.system.errors import Rejected, SomeFailed, UserError

if TYPE_CHECKING:
    from defocus_cli.rendering.forecast import Forecast

# Bytes of a pixel of three channels, of pictures that are neither flat nor noise.
_PIXEL_BYTES = {"half": 3.6, "float": 9.6, "png": 1.8, "png16": 4.5, "tiff": 4.5, "jpg": 0.5}
_PREVIEW_BYTES = 1.5
_MAP_BYTES = 2.4


def tell(jobs: Sequence[Job], plan: Plan, *, as_json: bool) -> None:
    """Say it of each job; of those that are to do, some are looked at.

    Raises:
        SomeFailed: some of several would fail; why each would is said on stderr.
        InputError: the input of the only one cannot be used.
        UsageProblem: the options make no sense for it or for this machine.
    """
    from defocus_cli.rendering import forecast

    todo = [job for job, _ in plan.todo]
    done = {job for job, _ in plan.settled}
    unusable: list[UserError] = []
    found = forecast.forecasts(todo, unusable.append if len(jobs) > 1 else None) if todo else {}
    for error in unusable:
        console.say(f"defocus: {error.format_message()}")
    by_job = {todo[number]: each for number, each in found.items()}
    looked_at = list(found.values())
    if as_json:
        records = []
        for job in jobs:
            told = {"forecast": forecast.record(by_job[job])} if job in by_job else {}
            records.append({**job_report.plan_record(job), "done_before": job in done, **told})
        whole = forecast.total(looked_at, len(todo)) if looked_at else None
        console.print_json(dry_run=True, pictures=records, forecast=whole, unusable=len(unusable))
    for job in () if as_json else jobs:
        console.tell(job_report.done_before_line(job) if job in done else job_report.plan_line(job))
        if job in by_job:
            console.tell(forecast.line(by_job[job]))
    for line in forecast.total_lines(looked_at, len(todo)) if looked_at and not as_json else ():
        console.tell(line)
    _end(unusable, len(found), "pictures")


def tell_batch(plan: Plan, processes: int, *, as_json: bool, verbose: bool) -> None:
    """Say it of a batch, in few lines; of each job if ``verbose``.

    What would fail or be rejected is said on stderr.

    Raises:
        SomeFailed: some would fail; the batch would go on without them, and end like this.
        UsageProblem: this machine has not got the device.
    """
    from defocus_cli.rendering import forecast

    todo = [job for job, _ in plan.todo]
    unusable: list[UserError] = []
    found = list(forecast.forecasts(todo, unusable.append).values()) if todo else []
    for error in unusable:
        console.say(f"defocus: {error.format_message()}")
    whole = forecast.total(found, len(todo)) if found else None
    told = {
        "jobs": len(plan.settled) + len(todo) + plan.beyond,
        "done_before": len(plan.settled),
        "todo": len(todo),
        "beyond_limit": plan.beyond,
        "processes": processes,
        "forecast": whole,
        "seconds": _seconds(todo, whole) / processes if whole else 0.0,
        "bytes": round(_bytes(plan, found)) if found else 0,
        "unusable": len(unusable),
    }
    if as_json:
        console.print_json(
            dry_run=True, **told, samples=[job_report.plan_record(job) for job in todo]
        )
    for job in todo if verbose and not as_json else ():
        console.tell(job_report.plan_line(job))
    for line in () if as_json else _batch_lines(told, len(found)):
        console.tell(line)
    _end(unusable, len(found), "jobs")


def _batch_lines(told: Mapping[str, Any], found: int) -> Iterator[str]:
    from defocus_cli.system.console import duration

    todo, processes, whole = told["todo"], told["processes"], told["forecast"]
    beyond = f", {told['beyond_limit']} beyond the limit" if told["beyond_limit"] else ""
    yield f"{counted(told['done_before'], 'job')} done before, {todo} to do{beyond}"
    if unusable := told["unusable"]:
        yield f"{unusable} of {found + unusable} that were looked at would not be done"
    if whole is not None:
        few = f", going by {found} of them" if found < todo else ""
        crew = counted(processes, "process", "processes")
        yield (
            f"about {duration(told['seconds'])} in {crew}, {told['bytes'] / 10**9:.2f} GB "
            f"of files, {processes * whole['peak_mb']:.0f} MB of memory{few}"
        )


def _end(unusable: Sequence[UserError], usable: int, what: str) -> None:
    """End as the run would: what is rejected is no failure."""
    failing = sum(not isinstance(error, Rejected) for error in unusable)
    if failing:
        tried = usable + len(unusable)
        raise SomeFailed(f"{failing} of {tried} {what} that were looked at would fail")


def _seconds(todo: Sequence[Job], whole: Mapping[str, Any]) -> float:
    """Of one process: decoding overlaps with rendering, but takes the cores that it needs.

    Lenses share the picture that they take.
    """
    share = len({(job.picture, job.reading) for job in todo}) / len(todo)
    return float(whole["render_seconds"] + share * whole["read_seconds"])


def _bytes(plan: Plan, found: Sequence[Forecast]) -> float:
    """What the jobs to do will write, going by what those done before have written, if any."""
    pixels = sum(each.size[0] * each.size[1] for each in found) / len(found) * len(plan.todo)
    done = [record for _, record in plan.settled if record["status"] == "ok"]
    if done:
        written = sum(output["size"] for one in done for output in one["outputs"].values())
        pixels_done = sum(one["size"][0] * one["size"][1] for one in done)
        return float(pixels * written / pixels_done)
    outputs = plan.todo[0][0].outputs
    image = _PIXEL_BYTES[outputs.exr_type if outputs.format == "exr" else outputs.format]
    each = (image if kind.image else _MAP_BYTES for kind in outputs.rows)
    return pixels * (sum(each) + outputs.preview * len(outputs.kinds) * _PREVIEW_BYTES)

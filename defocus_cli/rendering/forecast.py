"""Forecast of a job: work, seconds and memory, before it is rendered."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from defocus_cli.jobs.job import Job
from defocus_cli.rendering.calibration import work_per_second
from defocus_cli.rendering.memory_budget import base_mb
from defocus_cli.rendering.memory_fit import peak_mb
from defocus_cli.rendering.outcome import repair_words
from defocus_cli.system.arrays import scratch_folder
from defocus_cli.system.console import duration
from defocus_cli.system.errors import UserError

if TYPE_CHECKING:
    from defocus_core import Cost

# Pictures of a batch that are looked at; the others are taken for alike.
MOST_READ = 16


@dataclass(frozen=True)
class Forecast:
    """Of one job.

    Attributes:
        job: what it is about.
        size: (width, height) in px.
        coc_px: smallest and largest signed radius.
        read_seconds: that reading took.
        cost: the work; None where only maps are written, which takes none.
        seconds: of the rendering, as `render_seconds` will tell, within a factor of two.
        peak_mb: a bound of the memory that the process, or the GPU, will hold.
        scratch_mb: that its arrays take in scratch files; 0 if they are held in memory.
        color_note: how its colour is read.
        depth_note: how its depth is read.
        repair_note: what would be done to it before it is rendered; empty if nothing.
    """

    job: Job
    size: tuple[int, int]
    coc_px: tuple[float, float]
    read_seconds: float
    cost: Cost | None
    seconds: float
    peak_mb: float
    scratch_mb: float = 0.0
    color_note: str = ""
    depth_note: str = ""
    repair_note: str = ""


def forecasts(
    jobs: Sequence[Job], unusable: Callable[[UserError], object] | None = None
) -> dict[int, Forecast]:
    """Of all jobs by number, or of some spread evenly over many; inputs are read as to render.

    Args:
        jobs: one or more.
        unusable: told what would end a job, which then is none of those returned.

    Raises:
        InputError: an input cannot be used, or does not fit into memory, if nobody is told.
        UsageProblem: the options make no sense for a picture or this machine.
    """
    from defocus_cli.rendering import job_steps

    job_steps.load()
    device = job_steps.choose_device(jobs[0].machine.device)
    rate = 0.0
    if any(job.outputs.need_rendering for job in jobs):
        rate = work_per_second(device, jobs[0].machine.threads)
    found = {}
    for number in _some(len(jobs)):
        try:
            found[number] = _forecast(jobs[number], device, rate)
        except UserError as error:
            if unusable is None:
                raise
            unusable(error)
    return found


def _some(jobs: int) -> Sequence[int]:
    if jobs <= MOST_READ:
        return range(jobs)
    return [k * (jobs - 1) // (MOST_READ - 1) for k in range(MOST_READ)]


def _forecast(job: Job, device: str, rate: float) -> Forecast:
    from defocus_cli.rendering import job_steps
    from defocus_cli.rendering.render_picture import stream_of
    from defocus_core import cost

    start = time.perf_counter()
    loaded = job_steps.load_inputs(job)
    read_seconds = time.perf_counter() - start
    outcome, radius = job_steps.looked_at(job, loaded)
    held = loaded.holding
    found, seconds, repair_note = None, 0.0, ""
    peak = base_mb() + held.files_mb if device == "cpu" else 0.0
    if job.outputs.need_rendering:
        stream = stream_of(loaded, radius, outcome)
        found = cost(stream)
        seconds, peak = found.work / rate, peak_mb(job, stream, held, device)
        repair_note = repair_words(stream.repair)
    return Forecast(
        job=job,
        size=outcome.size,
        coc_px=outcome.coc_px,
        read_seconds=read_seconds,
        cost=found,
        seconds=seconds,
        peak_mb=peak,
        scratch_mb=held.arrays_mb if held.scratch else 0.0,
        color_note=loaded.color.note,
        depth_note=loaded.depth.note,
        repair_note=repair_note,
    )


def record(forecast: Forecast) -> dict[str, Any]:
    """A forecast in plain numbers."""
    found: dict[str, Any] = {
        "size": list(forecast.size),
        "coc_px": list(forecast.coc_px),
        "read_seconds": forecast.read_seconds,
        "render_seconds": forecast.seconds,
        "peak_mb": forecast.peak_mb,
        "color_note": forecast.color_note,
        "depth_note": "; ".join(filter(None, (forecast.depth_note, forecast.repair_note))),
    }
    if forecast.scratch_mb:
        found["scratch_mb"] = forecast.scratch_mb
        found["scratch_folder"] = str(scratch_folder())
    if (cost := forecast.cost) is not None:
        names = ("slices", "tiles", "slice_tiles", "slice_tiles_seen")
        found["stats"] = {name: getattr(cost, name) for name in names}
    return found


def line(forecast: Forecast) -> str:
    """A forecast in words."""
    width, height = forecast.size
    near, far = forecast.coc_px
    told = f"  {width}x{height}, CoC {near:.2f} to {far:.2f} px: "
    scratch = ""
    if forecast.scratch_mb:
        scratch = f", and {forecast.scratch_mb:.0f} MB of scratch in {scratch_folder()}"
    if (cost := forecast.cost) is None:
        return f"{told}maps alone, nothing is rendered{scratch}"
    share = 100 * cost.slice_tiles_seen / cost.slice_tiles
    repair_note = f"; depth: {forecast.repair_note}" if forecast.repair_note else ""
    return (
        f"{told}{cost.slices} slices, {cost.slice_tiles_seen} of {cost.slice_tiles} steps of "
        f"slice x tile ({share:.0f} %) and what is hidden; about {duration(forecast.seconds)}, "
        f"at most {forecast.peak_mb:.0f} MB{scratch}{repair_note}"
    )


def total(found: Sequence[Forecast], jobs: int) -> dict[str, Any]:
    """All jobs together: those that were not looked at are taken for alike."""
    share = jobs / len(found)
    return {
        "pictures": jobs,
        "pictures_read": len(found),
        "read_seconds": share * sum(each.read_seconds for each in found),
        "render_seconds": share * sum(each.seconds for each in found),
        "peak_mb": max(each.peak_mb for each in found),
    }


def total_lines(found: Sequence[Forecast], jobs: int) -> Iterator[str]:
    """The same in words, where there are several."""
    if jobs < 2:
        return
    every = total(found, jobs)
    few = f", from {len(found)} of them" if len(found) < jobs else ""
    yield (
        f"{jobs} pictures: about {duration(every['render_seconds'])} to render and "
        f"{duration(every['read_seconds'])} to read{few}; {every['peak_mb']:.0f} MB"
    )

"""Forecast of a job: work, seconds and memory, before it is taken."""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

from defocus_core.errors import DefocusError
from defocus_core.io.arrays import scratch_folder
from defocus_core.picture import plain_path
from defocus_core.picture.memory_budget import base_mb, regions_at_once
from defocus_core.picture.scene import passes_of, surfaces_of
from defocus_core.picture.take import Take, repair_record, repair_words
from defocus_core.request.job import Job
from defocus_core.system import memory
from defocus_core.system.process import set_to_render
from defocus_core.system.text import duration

if TYPE_CHECKING:
    from defocus_core.depth.diagnosis import DepthRepair

# Most pictures of a batch to decode for a forecast; the others count as their average.
MAX_READ = 16
# Kind, height, width and largest CoC radius in px of a scene that needs every step of rendering.
SCENE = ("thin", 540, 960, 16.0)
_REPAIRED_PIXELS = 1 << 21  # of pictures whose depth is repaired
_RADIUS_BYTES = 4  # of the repaired radius of a pixel
_OPENED_PIXELS = 1 << 24  # of pictures that are opened
_REPEATS = 2  # the fastest counts: a machine is never faster than it is


@dataclass(frozen=True)
class Forecast:
    """Work, time and memory of one job."""

    size: tuple[int, int]  # (width, height) of the picture in px
    coc_px: tuple[float, float]  # its least and greatest signed radius
    color_note: str  # how the colour is read, for people
    depth_note: str  # how the depth is read and repaired
    repair: DepthRepair | None  # of the depth; None if nothing is looked for
    seconds: float  # time to read, render and write it, right within a factor of two
    peak_mb: float  # upper bound of the memory of the process, or of the GPU
    scratch_mb: float  # size of its arrays in scratch files; 0 if they are held in memory
    # How many times it is rendered, for colours apart, and for up and down; 0 if only maps are
    # written
    renderings: int


@cache
def work_per_second(device: str, threads: int) -> float:
    """Units of work that this machine does in a second, measured in a second or two."""
    import torch

    from defocus_core.evaluation.cost import cost
    from defocus_core.evaluation.synthetic_scenes import scenery
    from defocus_core.renderer.engine.renderer import Renderer
    from defocus_core.renderer.engine.scene import Scene
    from defocus_core.renderer.engine.settings import Settings

    set_to_render()
    image, radius = (part.to(device) for part in scenery(*SCENE)[:2])
    seconds = []
    for _ in range(_REPEATS + 1):  # the first is for what a process does once
        start = time.perf_counter()
        renderer = Renderer(Scene(image, radius), Settings(threads=threads))
        for _ in renderer.tiles():
            pass
        if device == "cuda":
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - start)
    return cost(renderer) / min(seconds[1:])


@cache
def _durable_seconds() -> float:
    """Seconds until a small file is on the disk of scratch files."""
    seconds = []
    for _ in range(_REPEATS + 1):
        with tempfile.TemporaryFile(dir=scratch_folder()) as file:
            start = time.perf_counter()
            file.write(bytes(4096))
            file.flush()
            os.fsync(file.fileno())
            seconds.append(time.perf_counter() - start)
    return min(seconds)


def forecasts(jobs: Sequence[Job]) -> tuple[dict[int, Forecast], list[DefocusError]]:
    """Forecasts of jobs, or of a few spread evenly over more, whose inputs are opened."""
    plain_path.load()
    device = plain_path.choose_device(jobs[0].machine.device)
    rate = 0.0
    if any(job.outputs.need_rendering for job in jobs):
        rate = work_per_second(device, jobs[0].machine.threads)
    count = min(len(jobs), MAX_READ)
    by_number, unusable, looked_at = {}, [], 0
    for number in (k * (len(jobs) - 1) // max(count - 1, 1) for k in range(count)):
        if looked_at > _OPENED_PIXELS:
            break
        try:
            found = _forecast(jobs[number], device, rate, left=_REPAIRED_PIXELS - looked_at)
            looked_at += math.prod(found.size)
            by_number[number] = found
        except DefocusError as error:
            unusable.append(error)
    return by_number, unusable


def _forecast(job: Job, device: str, rate: float, left: int) -> Forecast:
    """The forecast of a job; to write a file takes about as long as to read the inputs.

    `left`: pixels whose depth may be repaired; that of a larger picture is counted as it is.
    """
    start = time.perf_counter()
    inputs = plain_path.read(job)
    files = len(job.names)
    write_seconds = len(job.outputs.kinds) * (time.perf_counter() - start)
    write_seconds += (files + 1) * _durable_seconds()
    take, held = plain_path.prepare(job, inputs), inputs.holding
    peak = base_mb() + held.files_mb if device == "cpu" else 0.0
    work, maximum, renders = 0.0, 0.0, 0
    if job.outputs.need_rendering:
        repairs = math.prod(take.size) <= left
        take, work, maximum, renders = _counted(take, device, repairs=repairs)
    return Forecast(
        size=take.size,
        coc_px=take.limits,
        color_note=take.color_note,
        depth_note=take.depth_words(),
        repair=take.repair,
        seconds=time.perf_counter() - start + (work and work / rate) + write_seconds,
        peak_mb=peak + maximum,
        scratch_mb=held.arrays_mb if held.scratch else 0.0,
        renderings=renders,
    )


def _counted(take: Take, device: str, *, repairs: bool) -> tuple[Take, float, float, int]:
    """A take with its repair; its work, the memory of its regions in MB, and its renderings."""
    from defocus_core.evaluation.cost import cost

    reading = take.job.reading if repairs else replace(take.job.reading, depth_repair="off")
    counted = replace(take, job=replace(take.job, reading=reading))
    passes = passes_of(surfaces_of(counted))
    work, maximum = 0.0, 0.0
    for _, renderer in plain_path.renderers(take, passes):
        work += cost(renderer)
        memory_mb = regions_at_once(take.job, renderer, take.inputs.holding, device)[1]
        maximum = max(maximum, memory_mb)
    if repairs:
        return replace(take, repair=renderer.repair), work, maximum, len(passes)
    repaired = math.prod(take.shown.shape) * _RADIUS_BYTES / memory.MB  # as it may be
    return take, work, maximum + repaired, len(passes)


def record(forecast: Forecast) -> dict[str, Any]:
    """A forecast in plain numbers."""
    values: dict[str, Any] = {
        "size": list(forecast.size),
        "coc_px": list(forecast.coc_px),
        "seconds": forecast.seconds,
        "peak_mb": forecast.peak_mb,
        "color_note": forecast.color_note,
        "depth_note": forecast.depth_note,
        "depth_repair": repair_record(forecast.repair),
    }
    if forecast.scratch_mb:
        values["scratch_mb"] = forecast.scratch_mb
        values["scratch_folder"] = str(scratch_folder())
    if forecast.renderings:
        values["renderings"] = forecast.renderings
    return values


def line(forecast: Forecast) -> str:
    """A forecast in words."""
    (width, height), (near, far) = forecast.size, forecast.coc_px
    start = f"  {width}x{height}, CoC {near:.2f} to {far:.2f} px: "
    scratch = ""
    if forecast.scratch_mb:
        scratch = f", and {forecast.scratch_mb:.0f} MB of scratch in {scratch_folder()}"
    if not forecast.renderings:
        return f"{start}maps alone, nothing is rendered{scratch}"
    note = repair_words(forecast.repair)
    repair_note = f"; depth: {note}" if note else ""
    times = f"{forecast.renderings} renderings, " if forecast.renderings > 1 else ""
    seconds = duration(forecast.seconds)
    return f"{start}{times}about {seconds}, at most {forecast.peak_mb:.0f} MB{scratch}{repair_note}"


def total(samples: Sequence[Forecast], jobs: int) -> dict[str, Any]:
    """Totals of all jobs, in proportion to the forecasts of a sample of them."""
    return {
        "pictures": jobs,
        "pictures_read": len(samples),
        "seconds": jobs / len(samples) * sum(each.seconds for each in samples),
        "peak_mb": max(each.peak_mb for each in samples),
    }


def total_line(samples: Sequence[Forecast], jobs: int) -> str:
    """Totals of all jobs, in words."""
    every = total(samples, jobs)
    few = f", from {len(samples)} of them" if len(samples) < jobs else ""
    seconds = duration(every["seconds"])
    return f"{jobs} pictures: about {seconds}{few}, at most {every['peak_mb']:.0f} MB"

"""Forecast of a job: work, seconds and memory, before it is taken."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.batch.jobs.job import Job, Outputs
from defocus_core.errors import DefocusError
from defocus_core.io.arrays import scratch_folder
from defocus_core.picture import plain_path
from defocus_core.picture.memory_budget import base_mb, image_type, regions_at_once
from defocus_core.picture.render import renderers
from defocus_core.picture.repair_words import repair_record, repair_words
from defocus_core.picture.scene import passes_of, surfaces_of
from defocus_core.picture.take import Take
from defocus_core.system.process import set_to_render
from defocus_core.system.text import duration

if TYPE_CHECKING:
    from defocus_core.depth.diagnosis import DepthRepair

# Most pictures of a batch to decode for a forecast; the others count as their average.
MAX_READ = 16
# Kind, height, width and largest CoC radius in px of a scene that needs every step of rendering.
_SCENE = ("thin", 540, 960, 16.0)
_REPEATS = 2  # the fastest counts: a machine is never faster than it is


@dataclass(frozen=True)
class Forecast:
    """Work, time and memory of one job."""

    size: tuple[int, int]  # (width, height) of the picture in px
    coc_px: tuple[float, float]  # its least and greatest signed radius
    color_note: str  # how the colour is read, for people
    depth_note: str  # how the depth is read and repaired
    repair: DepthRepair | None  # of the depth; None if nothing is rendered
    read_seconds: float  # time to decode the inputs, measured
    prepare_seconds: float  # time before rendering, measured: repair of depth, search of lights
    seconds: float  # time to render, right within a factor of two
    write_seconds: float  # time to write, measured on a picture of the same outputs
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
    image, radius = (part.to(device) for part in scenery(*_SCENE)[:2])
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


def forecasts(jobs: Sequence[Job]) -> tuple[dict[int, Forecast], list[DefocusError]]:
    """Forecasts of jobs, or of `MAX_READ` spread evenly over more; their inputs are decoded."""
    plain_path.load()
    device = plain_path.choose_device(jobs[0].machine.device)
    rate = 0.0
    if any(job.outputs.need_rendering for job in jobs):
        rate = work_per_second(device, jobs[0].machine.threads)
    count = min(len(jobs), MAX_READ)
    by_number, unusable = {}, []
    written: dict[Outputs, float] = {}
    for number in (k * (len(jobs) - 1) // max(count - 1, 1) for k in range(count)):
        try:
            by_number[number] = _forecast(jobs[number], device, rate, written)
        except DefocusError as error:
            unusable.append(error)
    return by_number, unusable


def _forecast(job: Job, device: str, rate: float, written: dict[Outputs, float]) -> Forecast:
    """The forecast of a job; ``written`` has seconds to write a pixel of outputs, or gets them."""
    from defocus_core.evaluation.cost import cost

    start = time.perf_counter()
    inputs = plain_path.read(job)
    read_seconds, start = time.perf_counter() - start, time.perf_counter()
    take, held = plain_path.prepare(job, inputs), inputs.holding
    peak = base_mb() + held.files_mb if device == "cpu" else 0.0
    work, maximum, renders = 0.0, 0.0, 0
    if job.outputs.need_rendering:
        passes = passes_of(take, surfaces_of(take).scene())
        renders = len(passes)
        for _, renderer in renderers(take, passes):
            work += cost(renderer)
            maximum = max(maximum, regions_at_once(job, renderer, held, device)[1])
        take = replace(take, repair=renderer.repair)
    prepare_seconds = time.perf_counter() - start
    if job.outputs not in written:
        written[job.outputs] = _write_seconds(take) / math.prod(take.size)
    return Forecast(
        size=take.size,
        coc_px=take.limits,
        color_note=take.color_note,
        depth_note=take.depth_words(),
        repair=take.repair,
        read_seconds=read_seconds,
        prepare_seconds=prepare_seconds,
        seconds=work / rate if work else 0.0,
        write_seconds=written[job.outputs] * math.prod(take.size),
        peak_mb=peak + maximum,
        scratch_mb=held.arrays_mb if held.scratch else 0.0,
        renderings=renders,
    )


def _write_seconds(take: Take) -> float:
    """Time to write the outputs of a job, with the picture in focus in place of what is blurred."""
    outputs, color = take.job.outputs, take.inputs.color
    dtype = image_type(take.job)
    sharp = [np.asarray(plane[:]).astype(dtype) for plane in color.planes]
    images = {
        kind.name: tuple(sharp * len(kind.rendered_as) if kind.image else sharp[:1])
        for kind in outputs.rows
        if kind.rendered
    }
    with TemporaryDirectory(dir=scratch_folder()) as folder:
        job = replace(take.job, outputs=replace(outputs, root=Path(folder)))
        start = time.perf_counter()
        plain_path.write(replace(take, job=job, images=images))
        return time.perf_counter() - start


def record(forecast: Forecast) -> dict[str, Any]:
    """A forecast in plain numbers."""
    values: dict[str, Any] = {
        "size": list(forecast.size),
        "coc_px": list(forecast.coc_px),
        "read_seconds": forecast.read_seconds,
        "prepare_seconds": forecast.prepare_seconds,
        "render_seconds": forecast.seconds,
        "write_seconds": forecast.write_seconds,
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
    seconds = duration(forecast.prepare_seconds + forecast.seconds + forecast.write_seconds)
    return f"{start}{times}about {seconds}, at most {forecast.peak_mb:.0f} MB{scratch}{repair_note}"


def total(samples: Sequence[Forecast], jobs: int) -> dict[str, Any]:
    """Totals of all jobs, in proportion to the forecasts of a sample of them."""
    fraction = jobs / len(samples)
    return {
        "pictures": jobs,
        "pictures_read": len(samples),
        "read_seconds": fraction * sum(each.read_seconds for each in samples),
        "prepare_seconds": fraction * sum(each.prepare_seconds for each in samples),
        "render_seconds": fraction * sum(each.seconds for each in samples),
        "write_seconds": fraction * sum(each.write_seconds for each in samples),
        "peak_mb": max(each.peak_mb for each in samples),
    }


def total_line(samples: Sequence[Forecast], jobs: int) -> str:
    """Totals of all jobs, in words."""
    every = total(samples, jobs)
    rendering = duration(every["prepare_seconds"] + every["render_seconds"])
    few = f", from {len(samples)} of them" if len(samples) < jobs else ""
    return (
        f"{jobs} pictures: about {rendering} to render, "
        f"{duration(every['read_seconds'])} to read and {duration(every['write_seconds'])} to "
        f"write{few}; {every['peak_mb']:.0f} MB"
    )

"""What rendering will take: work, seconds and memory, from the inputs and from this machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from defocus_cli import memory
from defocus_cli.calibration import Calibration, calibrated, kept, usual
from defocus_cli.errors import TooLarge, UserError
from defocus_cli.focusing import focused, signed_radius
from defocus_cli.job import RENDERED_KINDS, Job, Lens

if TYPE_CHECKING:
    from torch import Tensor

    from defocus_core.planning import Plan

# Pictures of a batch that are looked at; the others are taken for alike.
MOST_READ = 16
# A frame that is sure to take less than this share of what there is is not planned before.
_EASY = 0.25
# What might help a frame that is too large, in the order in which it costs least.
_REMEDIES = (
    ("--threads 1", {"threads": 1}),
    ("--quality standard", {"quality": "standard"}),
    ("--quality draft", {"quality": "draft"}),
    ("--quality draft --threads 1", {"quality": "draft", "threads": 1}),
)
_FLOAT = 4  # bytes


@dataclass(frozen=True)
class Forecast:
    """Of one job.

    Attributes:
        job: what it is about.
        size: (width, height) in px.
        coc_px: smallest and largest signed radius.
        read_seconds: that reading took.
        plan: the work; None where only maps are written, which takes none.
        seconds: of the rendering, as `render_seconds` will tell.
        peak_mb: most memory that the process, or the GPU, will hold.
    """

    job: Job
    size: tuple[int, int]
    coc_px: tuple[float, float]
    read_seconds: float
    plan: Plan | None
    seconds: float
    peak_mb: float


def forecasts(
    jobs: Sequence[Job], unusable: Callable[[UserError], object] | None = None
) -> dict[int, Forecast]:
    """Of all jobs by number, or of some spread evenly over many; inputs are read as to render.

    Args:
        jobs: one or more.
        unusable: told what would end a job, which then is none of those returned.

    Raises:
        InputError: an input cannot be used, if nobody is told.
        UsageProblem: the options make no sense for a picture or this machine.
    """
    from defocus_cli import engine

    engine.load()
    device = engine.choose_device(jobs[0].machine.device)
    base = memory.held_mb(device)
    calibration = None
    if any(_renders(job) for job in jobs):
        calibration = calibrated(device, jobs[0].machine.threads)
    found = {}
    for number in _some(len(jobs)):
        try:
            found[number] = _forecast(jobs[number], device, base, calibration)
        except UserError as error:
            if unusable is None:
                raise
            unusable(error)
    return found


def _some(jobs: int) -> Sequence[int]:
    if jobs <= MOST_READ:
        return range(jobs)
    return [k * (jobs - 1) // (MOST_READ - 1) for k in range(MOST_READ)]


def _renders(job: Job) -> bool:
    return bool(set(job.outputs.kinds) & set(RENDERED_KINDS))


def _forecast(job: Job, device: str, base: float, calibration: Calibration | None) -> Forecast:
    import torch

    from defocus_cli import engine

    start = time.perf_counter()
    color, depth = engine.read(job.picture, job.reading)
    read_seconds = time.perf_counter() - start
    height, width, channels = color.pixels.shape
    lens = focused(job.lens, depth)
    radius = signed_radius(lens, depth.metres, (width, height))
    reach = (float(radius.min()), float(radius.max()))
    inputs = height * width * _FLOAT * (channels + 1) / memory.MB
    if device == "cpu":
        inputs *= 2  # as read, and as rendered
    planned, seconds, peak = None, 0.0, base + inputs
    if calibration is not None and _renders(job):
        image = torch.from_numpy(color.pixels).permute(2, 0, 1)
        planned = _planned(job, lens, image, torch.from_numpy(radius))
        seconds = calibration.predicted_seconds(planned)
        peak += calibration.predicted_mb(planned)
    return Forecast(job, (width, height), reach, read_seconds, planned, seconds, peak)


def _planned(job: Job, lens: Lens, image: Tensor, signed_radius: Tensor) -> Plan:
    """The work on a picture [C, H, W] whose pixels have the given radii [H, W] px."""
    from defocus_core import Aperture
    from defocus_core.planning import plan

    return plan(
        signed_radius,
        image=image,
        aperture=Aperture(lens.blades, lens.blade_rotation),
        quality=job.machine.quality,
        left_right=bool({"left", "right"} & set(job.outputs.kinds)),
    )


def refuse_too_large(
    job: Job,
    lens: Lens,
    image: Tensor,
    signed_radius: Tensor,
    *,
    device: str,
    limit_mb: float | None = None,
) -> None:
    """Refuse a frame whose rendering would not fit into memory, before any of it is done.

    Args:
        job: what is to be rendered.
        lens: that takes it.
        image: [C, H, W], already in memory.
        signed_radius: [H, W] px.
        device: that will render it.
        limit_mb: for the whole process; None is what this machine has to give.

    Raises:
        TooLarge: it would not fit; the remedy is the option with which it would.
    """
    available = memory.available_mb(device)
    if limit_mb is not None:
        left = limit_mb - memory.held_mb(device)
        available = left if available is None else min(left, available)
    if available is None or _most_mb(image, signed_radius) < _EASY * available:
        return

    def needed(changed: Job) -> float:
        threads = changed.machine.threads
        calibration = kept(device, threads) or usual(threads)
        return calibration.predicted_mb(_planned(changed, lens, image, signed_radius))

    wanted = needed(job)
    if wanted <= available:
        return
    problem = f"needs about {wanted:.0f} MB to render, but {max(available, 0):.0f} MB are left"
    for remedy, settings in _REMEDIES:
        changed = replace(job, machine=replace(job.machine, **settings))
        if changed.machine != job.machine and needed(changed) <= available:
            raise TooLarge(job.picture.color, problem, f"use {remedy}")
    raise TooLarge(job.picture.color, problem, "use a smaller picture or a machine with more")


def _most_mb(image: Tensor, signed_radius: Tensor) -> float:
    """More than any rendering holds, from the size and the largest radius alone."""
    height, width = signed_radius.shape
    spread = min(float(signed_radius.abs().max()), max(height, width))
    window = (160 + 2.5 * spread) ** 2
    samples = 40 * height * width + 2000 * window
    return samples * (image.shape[0] + 1) * _FLOAT / memory.MB


def record(forecast: Forecast) -> dict[str, Any]:
    """A forecast in plain numbers."""
    found: dict[str, Any] = {
        "size": list(forecast.size),
        "coc_px": list(forecast.coc_px),
        "read_seconds": forecast.read_seconds,
        "render_seconds": forecast.seconds,
        "peak_mb": forecast.peak_mb,
    }
    if (plan := forecast.plan) is not None:
        names = ("slices", "tiles", "slice_tiles", "slice_tiles_done", "tiles_with_hidden")
        found["stats"] = {name: getattr(plan, name) for name in names}
    return found


def line(forecast: Forecast) -> str:
    """A forecast in words."""
    width, height = forecast.size
    near, far = forecast.coc_px
    told = f"  {width}x{height}, CoC {near:.2f} to {far:.2f} px: "
    if (plan := forecast.plan) is None:
        return f"{told}maps alone, nothing is rendered"
    share = 100 * plan.slice_tiles_done / plan.slice_tiles
    return (
        f"{told}{plan.slices} slices, {plan.slice_tiles_done} of {plan.slice_tiles} steps of "
        f"slice x tile ({share:.0f} %); about {duration(forecast.seconds)}, "
        f"{forecast.peak_mb:.0f} MB"
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


def duration(seconds: float) -> str:
    """Like ``0.3 s``, ``12 s``, ``3 min 20 s`` or ``2 h 5 min``."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"

"""What rendering will take: work, seconds and memory, from the inputs and from this machine."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from defocus_cli import memory
from defocus_cli.accuracy import quality_of
from defocus_cli.arrays import Windows, scratch_folder
from defocus_cli.budget import base_mb, enough_mb
from defocus_cli.calibration import Calibration, calibrated, kept, usual
from defocus_cli.errors import TooLarge, UserError
from defocus_cli.focusing import focused, radius_at_infinity, radius_map
from defocus_cli.job import RENDERED_KINDS, Job, Lens

if TYPE_CHECKING:
    from defocus_cli.made import Outcome
    from defocus_core.planning import Plan
    from defocus_core.source import Pixels

# Pictures of a batch that are looked at; the others are taken for alike.
MOST_READ = 16
# What might help a frame that is too large, in the order in which it costs least.
_REMEDIES = (
    ("--threads 1", {"threads": 1}),
    ("--quality standard", {"quality": "standard", "tolerance": None}),
    ("--quality draft", {"quality": "draft", "tolerance": None}),
    ("--quality draft --threads 1", {"quality": "draft", "tolerance": None, "threads": 1}),
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
        scratch_mb: that its arrays take in scratch files; 0 if they are held in memory.
    """

    job: Job
    size: tuple[int, int]
    coc_px: tuple[float, float]
    read_seconds: float
    plan: Plan | None
    seconds: float
    peak_mb: float
    scratch_mb: float = 0.0


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
    from defocus_cli import engine

    engine.load()
    device = engine.choose_device(jobs[0].machine.device)
    base = base_mb() if device == "cpu" else memory.held_mb(device)
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
    from defocus_cli import engine

    start = time.perf_counter()
    loaded = engine.load_inputs(job)
    read_seconds = time.perf_counter() - start
    height, width, _ = loaded.color.shape
    lens, held = focused(job.lens, loaded.depth), loaded.holding
    radius, reach = radius_map(lens, loaded.depth.metres, held.keeping)
    planned, seconds, peak = None, 0.0, base + (held.held_mb if device == "cpu" else 0.0)
    if calibration is not None and _renders(job):
        image, signed = Windows(loaded.color.planes, "cpu"), Windows([radius], "cpu", lone=True)

        def plan_of(changed: Job) -> Plan:
            return _planned(changed, lens, image, signed, reach)

        planned = plan_of(job)
        seconds = calibration.predicted_seconds(planned)
        room = _room_mb(held.room_mb, device)
        if (at_once := _fitting(job, calibration, planned, room)) is None:
            raise _too_large(job, device, room, plan_of)
        peak += calibration.predicted_mb(planned, at_once)
    scratch = held.arrays_mb if held.scratch else 0.0
    return Forecast(job, (width, height), reach, read_seconds, planned, seconds, peak, scratch)


def _planned(
    job: Job, lens: Lens, image: Pixels, signed_radius: Pixels, coc_px: tuple[float, float]
) -> Plan:
    """The work on a picture [C, H, W] whose pixels have the given radii [H, W] px."""
    from defocus_core import Aperture
    from defocus_core.planning import plan

    height, width = signed_radius.shape
    return plan(
        signed_radius,
        image=image,
        aperture=Aperture(lens.blades, lens.blade_rotation),
        quality=quality_of(job.machine, coc_px),
        left_right=bool({"left", "right"} & set(job.outputs.kinds)),
        tile=job.machine.tile,
        infinity=radius_at_infinity(lens, (width, height)),
    )


def regions_at_once(
    outcome: Outcome, image: Pixels, signed_radius: Pixels, room_mb: float
) -> int | None:
    """How many regions may be computed at once; None for as many as there are threads.

    Args:
        outcome: what is to be rendered, and where.
        image: [C, H, W].
        signed_radius: [H, W] px.
        room_mb: what the process may take to compute in.

    Raises:
        TooLarge: not even one would fit; the remedy is the option with which it would.
    """
    job, device = outcome.job, outcome.device
    room = _room_mb(room_mb, device)
    threads = job.machine.threads
    if _most_mb(image.shape, max(map(abs, outcome.coc_px)), threads) < room:
        return None

    def plan_of(changed: Job) -> Plan:
        return _planned(changed, outcome.lens, image, signed_radius, outcome.coc_px)

    if (found := _fitting(job, _known(job, device), plan_of(job), room)) is not None:
        return found
    raise _too_large(job, device, room, plan_of)


def _too_large(job: Job, device: str, room: float, plan_of: Callable[[Job], Plan]) -> TooLarge:
    """What is said of a picture of which not even one region fits; the remedy would help."""
    least = _known(job, device).predicted_mb(plan_of(job), 1)
    problem = f"needs about {math.ceil(least)} MB to render, but {room:.0f} MB are left"
    if room == 0:
        problem += f" beside the {base_mb():.0f} MB of the program"
    for remedy, settings in _REMEDIES:
        changed = replace(job, machine=replace(job.machine, **settings))
        if changed.machine == job.machine:
            continue
        if _fitting(changed, _known(changed, device), plan_of(changed), room):
            return TooLarge(job.picture.color, problem, f"use {remedy}")
    machine = memory.available_mb(device)
    if device == "cpu" and machine is not None and least < machine:
        gigabytes = math.ceil(enough_mb(least) / 102.4) / 10
        return TooLarge(job.picture.color, problem, f"use --memory {gigabytes:.1f}GiB")
    return TooLarge(job.picture.color, problem, "use a smaller picture or a machine with more")


def _known(job: Job, device: str) -> Calibration:
    """What is known of a machine without measuring it now."""
    return kept(device, job.machine.threads) or usual(job.machine.threads)


def _room_mb(room_mb: float, device: str) -> float:
    """What there is to compute in, on the machine as it is now."""
    available = memory.available_mb(device)
    if device != "cpu":
        return math.inf if available is None else available
    return max(room_mb if available is None else min(room_mb, available), 0.0)


def _fitting(job: Job, calibration: Calibration, planned: Plan, room_mb: float) -> int | None:
    """The most regions at once that fit; None if not even one does."""
    for at_once in range(job.machine.threads, 0, -1):
        if calibration.predicted_mb(planned, at_once) <= room_mb:
            return at_once
    return None


def _most_mb(shape: tuple[int, ...], spread: float, threads: int) -> float:
    """More than any rendering holds, from the shape [C, H, W] and the largest radius alone."""
    channels, height, width = shape
    spread = min(spread, max(height, width))
    margin = 3 * spread + 200
    side = max(768, 4 * margin + 128) + 2 * margin
    region = min(side, height) * min(side, width)
    window = (160 + 2.5 * spread) ** 2
    samples = 2 * height * width + 60 * threads * region + 2000 * window
    return samples * (channels + 1) * _FLOAT / memory.MB


def record(forecast: Forecast) -> dict[str, Any]:
    """A forecast in plain numbers."""
    found: dict[str, Any] = {
        "size": list(forecast.size),
        "coc_px": list(forecast.coc_px),
        "read_seconds": forecast.read_seconds,
        "render_seconds": forecast.seconds,
        "peak_mb": forecast.peak_mb,
    }
    if forecast.scratch_mb:
        found["scratch_mb"] = forecast.scratch_mb
        found["scratch_folder"] = str(scratch_folder())
    if (plan := forecast.plan) is not None:
        names = ("slices", "tiles", "slice_tiles", "slice_tiles_done", "tiles_with_hidden")
        found["stats"] = {name: getattr(plan, name) for name in names}
    return found


def line(forecast: Forecast) -> str:
    """A forecast in words."""
    width, height = forecast.size
    near, far = forecast.coc_px
    told = f"  {width}x{height}, CoC {near:.2f} to {far:.2f} px: "
    scratch = ""
    if forecast.scratch_mb:
        scratch = f", and {forecast.scratch_mb:.0f} MB of scratch in {scratch_folder()}"
    if (plan := forecast.plan) is None:
        return f"{told}maps alone, nothing is rendered{scratch}"
    share = 100 * plan.slice_tiles_done / plan.slice_tiles
    return (
        f"{told}{plan.slices} slices, {plan.slice_tiles_done} of {plan.slice_tiles} steps of "
        f"slice x tile ({share:.0f} %); about {duration(forecast.seconds)}, "
        f"{forecast.peak_mb:.0f} MB{scratch}"
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

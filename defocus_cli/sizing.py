"""Whether what rendering takes fits into memory, and how much of it at once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from defocus_cli import memory
from defocus_cli.accuracy import quality_of
from defocus_cli.budget import base_mb, enough_mb
from defocus_cli.calibration import Calibration, kept, usual
from defocus_cli.errors import TooLarge
from defocus_cli.focusing import radius_at_infinity
from defocus_cli.job import Job, Lens

if TYPE_CHECKING:
    from defocus_cli.made import Outcome
    from defocus_core.planning import Plan
    from defocus_core.source import Pixels

# What might help a frame that is too large, in the order in which it costs least.
_REMEDIES = (
    ("--threads 1", {"threads": 1}),
    ("--quality standard", {"quality": "standard", "tolerance": None}),
    ("--quality draft", {"quality": "draft", "tolerance": None}),
    ("--quality draft --threads 1", {"quality": "draft", "tolerance": None, "threads": 1}),
)
_FLOAT = 4  # bytes


class Fit(NamedTuple):
    """What of a picture fits into memory.

    Attributes:
        at_once: regions that are computed at once; None where memory does not limit them.
        hold: whether the cells of a large draft are held, too.
    """

    at_once: int | None
    hold: bool


def planned_work(
    job: Job,
    lens: Lens,
    image: Pixels,
    signed_radius: Pixels,
    coc_px: tuple[float, float],
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


def fitting(outcome: Outcome, image: Pixels, signed_radius: Pixels, room_mb: float) -> Fit:
    """How much of a picture may be held and computed at once.

    Args:
        outcome: what is to be rendered, and where.
        image: [C, H, W].
        signed_radius: [H, W] px.
        room_mb: what the process may take to compute in.

    Raises:
        TooLarge: not even one would fit; the remedy is the option with which it would.
    """
    job, device = outcome.job, outcome.device
    room = room_on(room_mb, device)
    if fits_anyhow(job, image.shape, outcome.coc_px, room):
        return Fit(None, hold=True)

    def plan_of(changed: Job) -> Plan:
        return planned_work(changed, outcome.lens, image, signed_radius, outcome.coc_px)

    if found := most_at_once(job, _known(job, device), plan_of(job), room):
        return found
    raise too_large(job, device, room, plan_of)


def too_large(job: Job, device: str, room: float, plan_of: Callable[[Job], Plan]) -> TooLarge:
    """What is said of a picture of which not even one region fits; the remedy would help."""
    least = _known(job, device).predicted_mb(plan_of(job), 1)
    problem = f"needs about {math.ceil(least)} MB to render, but {room:.0f} MB are left"
    if room == 0:
        problem += f" beside the {base_mb():.0f} MB of the program"
    for remedy, settings in _REMEDIES:
        changed = replace(job, machine=replace(job.machine, **settings))
        if changed.machine == job.machine:
            continue
        if most_at_once(changed, _known(changed, device), plan_of(changed), room):
            return TooLarge(job.picture.color, problem, f"use {remedy}")
    machine = memory.available_mb(device)
    if device == "cpu" and machine is not None and least < machine:
        return TooLarge(job.picture.color, problem, f"use --memory {_size(enough_mb(job, least))}")
    return TooLarge(job.picture.color, problem, "use a smaller picture or a machine with more")


def _size(mb: float) -> str:
    """A size that is no less, as people write it on the command line."""
    tens = math.ceil(mb * memory.MB / 10**7)
    return f"{10 * tens}MB" if tens < 1000 else f"{math.ceil(tens / 10) / 10:.1f}GB"


def _known(job: Job, device: str) -> Calibration:
    """What is known of a machine without measuring it now."""
    return kept(device, job.machine.threads) or usual(job.machine.threads)


def room_on(room_mb: float, device: str) -> float:
    """What there is to compute in, on the machine as it is now."""
    available = memory.available_mb(device)
    if device != "cpu":
        return math.inf if available is None else available
    return max(room_mb if available is None else min(room_mb, available), 0.0)


def most_at_once(job: Job, calibration: Calibration, planned: Plan, room_mb: float) -> Fit | None:
    """The most that fits; None if not even one region."""
    threads, cells = job.machine.threads, planned.cells / memory.MB
    for at_once in range(threads, 0, -1):
        left = room_mb - calibration.predicted_mb(planned, at_once)
        if left >= 0:
            return Fit(at_once, hold=cells <= left)
    return None


def fits_anyhow(
    job: Job,
    shape: tuple[int, ...],
    coc_px: tuple[float, float],
    room_mb: float,
) -> bool:
    """Whether there is more room than any rendering takes of a shape [C, H, W] and some radii."""
    threads, spread = job.machine.threads, max(map(abs, coc_px))
    return _most_mb(shape, spread, threads) < room_mb


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

"""Regions of a picture that fit into memory at once, and the remedy if not even one does."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from defocus_cli.jobs.job import Job
from defocus_cli.rendering.memory_budget import base_mb, enough_mb, limit_mb
from defocus_cli.system import memory
from defocus_cli.system.errors import TooLarge

if TYPE_CHECKING:
    from defocus_cli.rendering.memory_budget import Holding
    from defocus_core import Stream

# Share of the room that the cells of a draft may take.
_FOR_CELLS = 0.25


def room_on(device: str, room_mb: float) -> float:
    """Memory left to compute in, with what the machine has free now."""
    available = memory.available_mb(device)
    if device != "cpu":
        return math.inf if available is None else available
    return max(room_mb if available is None else min(room_mb, available), 0.0)


def holds_cells(shape: tuple[int, ...], room_mb: float) -> bool:
    """Whether the cells of a draft of a picture [C, H, W] are kept, not computed where needed."""
    from defocus_core import cells_bytes

    return cells_bytes(shape) / memory.MB <= _FOR_CELLS * room_mb


def regions_at_once(job: Job, stream: Stream, holding: Holding, device: str) -> tuple[int, float]:
    """How many regions of a picture may be computed at once, and a bound of their memory in MB.

    Raises:
        TooLarge: not even one fits; the remedy is the option with which it would.
    """
    from defocus_core import memory_bound

    threads, room = job.machine.threads, room_on(device, holding.room_mb)

    def needed(threads: int, at_once: int) -> float:
        return memory_bound(stream, threads, at_once) / memory.MB

    for at_once in range(threads, 0, -1):
        if (bound := needed(threads, at_once)) <= room:
            return at_once, bound
    beside = base_mb() + holding.files_mb
    raise TooLarge(
        job.picture.color,
        f"needs {_sum(base_mb(), holding.files_mb, bound)} to render, "
        f"but {min(limit_mb(job.machine), beside + room):.0f} MB are allowed",
        _remedy(job, bound, threads > 1 and needed(1, 1) <= room, device),
    )


def _sum(base: float, files: float, rendering: float) -> str:
    """Three sizes and their sum, in words."""
    parts = [math.ceil(mb) for mb in (base, files, rendering)]
    return "{} MB ({} of the program, {} of its files, {})".format(sum(parts), *parts)


def _remedy(job: Job, needed_mb: float, with_one_thread: bool, device: str) -> str:
    if with_one_thread:
        return "use --threads 1"
    machine = memory.available_mb(device)
    enough = enough_mb(job, needed_mb)
    if device == "cpu" and (machine is None or enough < machine + base_mb()):
        return f"use --memory {_size(enough)}"
    if job.machine.quality != "draft":
        return "use --quality draft, a smaller picture, or a machine with more"
    return "use a smaller picture or a machine with more"


def _size(mb: float) -> str:
    """A size, rounded up, as the command line takes it."""
    tens = math.ceil(mb * memory.MB / 10**7)
    return f"{10 * tens}MB" if tens < 1000 else f"{math.ceil(tens / 10) / 10:.1f}GB"

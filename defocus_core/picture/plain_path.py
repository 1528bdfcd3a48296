"""The plain path of a picture: read, radii, scene, render, write.

What else may happen to it is a row of `steps.table`, in the order in which it happens.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from defocus_core.errors import InputError, TooLarge, UsageProblem
from defocus_core.picture.memory_budget import base_mb, capacity_mb, holding
from defocus_core.picture.pair import read as read_pair
from defocus_core.picture.radii import radii_of
from defocus_core.picture.render import render
from defocus_core.picture.steps.table import BLUR, LENS, RADII, READ, through
from defocus_core.picture.take import InputPair, Inputs, Take
from defocus_core.picture.write import write
from defocus_core.request.job import Job
from defocus_core.system import memory
from defocus_core.system.interrupts import delayed_signals
from defocus_core.system.process import imports

__all__ = ["choose_device", "compute", "load", "prepare", "read", "write"]


def read(job: Job) -> Inputs:
    """Decode the picture of a job, and what lies behind or below it if that is wanted and there."""
    held, left = holding(job), capacity_mb(job.machine)
    if (at_once := held.files_mb + held.whole_mb * held.scratch) > left and held.whole_mb:
        problem = f"takes {at_once:.0f} MB to decode, {left:.0f} MB are left"
        remedy = "save it as EXR, or allow more ‹memory›"
        raise TooLarge("out-of-memory", problem, remedy, path=job.picture.color)
    color, depth = read_pair(InputPair.of(job, held.keeping))
    inputs = Inputs(held, color, depth, empty=depth.empty)
    inputs = replace(inputs, warnings=(*color.warnings, *depth.warnings))
    return through(READ, Take(job=job, inputs=inputs, lens=job.lens)).inputs


def prepare(job: Job, inputs: Inputs) -> Take:
    """The picture as far as it is known before rendering: its lens, its radii."""
    depth = inputs.depth
    if "depth" in job.outputs.kinds and depth.is_radius:
        holds = "relative disparity" if depth.is_relative else "radii"
        problem = f"holds {holds}, of which no depth can be written"
        raise InputError("radii", problem, "leave depth out of the outputs", path=depth.path)
    take = through(LENS, Take(job=job, inputs=inputs, lens=job.lens))
    radii = radii_of(take.lens, depth, inputs.holding.keeping)
    take = through(
        RADII,
        replace(
            take,
            radii=radii,
            shown=radii.px,
            limits=radii.limits,
            device=choose_device(job.machine.device),
        ),
    )
    return replace(take, blur=radii, warnings=(*take.warnings, *radii.warnings, *inputs.warnings))


def compute(job: Job, inputs: Inputs, progress: Callable[[int, int], None] | None = None) -> Take:
    """The images and maps that a job asks for."""
    take = prepare(job, inputs)
    return render(through(BLUR, take), progress) if job.outputs.need_rendering else take


def choose_device(name: str) -> str:
    """``cpu`` or ``cuda``."""
    import torch

    available = name != "cpu" and torch.cuda.is_available()
    if name == "cuda" and not available:
        raise UsageProblem(
            "no-gpu", "PyTorch finds no CUDA GPU here", "use ‹device› cpu or auto", field="device"
        )
    return "cuda" if available else "cpu"


def load() -> None:
    """Import torch and the renderer, which takes seconds, and set up the allocator."""
    memory.share_heap()
    memory.keep_freed(True)  # what is read leaves room for what is rendered
    with delayed_signals(), imports():
        import torch  # noqa: F401

        import defocus_core.renderer.engine.renderer  # noqa: F401
    base_mb()

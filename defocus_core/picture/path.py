"""Steps of a job between reading and writing: the focus, the radii, the pictures."""

from __future__ import annotations

from collections.abc import Callable

from defocus_core.batch.jobs.job import Job
from defocus_core.batch.lenses.lens import Lens
from defocus_core.errors import InputError, UsageProblem
from defocus_core.picture.inputs import Inputs
from defocus_core.picture.memory_budget import base_mb
from defocus_core.picture.render import with_views
from defocus_core.picture.steps.focusing import quality_of, scaled
from defocus_core.picture.steps.implausible import implausible
from defocus_core.picture.steps.neighbours import with_neighbours
from defocus_core.picture.steps.shot_decisions import decided_words, shot_focused, shot_repair
from defocus_core.picture.take import Rendered
from defocus_core.system import memory
from defocus_core.system.interrupts import put_off
from defocus_core.system.process import imports
from defocus_core.system.text import counted


def compute(
    job: Job, inputs: Inputs, progress: Callable[[int, int], None] | None = None
) -> Rendered:
    """The images and maps that a job asks for."""
    prepared = prepare(job, inputs)
    if not job.outputs.need_rendering:
        return prepared
    prepared, radius, seen_behind = with_neighbours(prepared)
    return with_views(prepared, radius, seen_behind, progress)


def prepare(job: Job, inputs: Inputs) -> Rendered:
    """The picture as far as it is known before rendering: its lens, its radii."""
    depth = inputs.depth
    if "depth" in job.outputs.kinds and depth.is_radius:
        holds = "relative disparity" if depth.is_relative else "radii"
        problem = f"holds {holds}, of which no depth can be written"
        raise InputError("radii", problem, "leave depth out of the outputs", path=depth.path)
    lens = shot_focused(job, inputs.depth, deep=inputs.layers is not None)
    lens = scaled(lens, inputs.depths)
    radii = inputs.radii(lens)
    decided = shot_repair(job, inputs, radii.picture)
    declared = job.reading.says_scale
    likely = implausible(depth, radii.picture.px, radii.picture.limits, lens, declared=declared)
    return Rendered(
        job=job,
        inputs=inputs,
        lens=lens,
        radii=radii,
        device=choose_device(job.machine.device),
        quality=quality_of(job.machine, radii.limits),
        warnings=(*likely, *_clamp_words(lens, radii.picture.clamped), *inputs.warnings),
        decided=decided,
        shot_note=decided_words(job.shot, decided),
    )


def _clamp_words(lens: Lens, clamped: int) -> tuple[str, ...]:
    """What became of radii that are too large; nothing where none is."""
    if not clamped or lens.clamp_blur is None:
        return ()
    return (f"radius of {counted(clamped, 'pixel')} clamped to {lens.clamp_blur:g} px",)


def load() -> None:
    """Import torch and the renderer, which takes seconds, and set up the allocator."""
    memory.share_heap()
    memory.keep_freed(True)  # what is read leaves room for what is rendered
    with put_off(), imports():
        import torch  # noqa: F401

        import defocus_core.renderer.engine.renderer  # noqa: F401
    base_mb()


def choose_device(name: str) -> str:
    """``cpu`` or ``cuda``."""
    import torch

    available = name != "cpu" and torch.cuda.is_available()
    if name == "cuda" and not available:
        raise UsageProblem(
            "no-gpu", "PyTorch finds no CUDA GPU here", "use ‹device› cpu or auto", field="device"
        )
    return "cuda" if available else "cpu"

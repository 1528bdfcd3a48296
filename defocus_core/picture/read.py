"""Read: the decoded inputs of a job, and the memory that they may take."""

from __future__ import annotations

from dataclasses import replace

from defocus_core.batch.jobs.job import Job
from defocus_core.errors import TooLarge, UsageProblem
from defocus_core.picture.memory_budget import base_mb, capacity_mb, holding, refuse_small
from defocus_core.picture.pair import InputPair
from defocus_core.picture.pair import read as read_pair
from defocus_core.picture.steps.table import through
from defocus_core.picture.take import Inputs, Take


def read(job: Job) -> Inputs:
    """Decode the picture of a job, and what lies behind or below it if that is wanted and there."""
    if job.reading.blur_channels and job.outputs.format != "exr":
        problem = f"has no effect in {job.outputs.format}, which holds the picture alone"
        raise UsageProblem("idle-option", problem, "use ‹format› exr", field="blur-channels")
    refuse_small(job, base_mb())
    held, left = holding(job), capacity_mb(job.machine)
    if (at_once := held.files_mb + held.whole_mb * held.scratch) > left and held.whole_mb:
        problem = f"takes {at_once:.0f} MB to decode, {left:.0f} MB are left"
        remedy = "save it as EXR, or allow more ‹memory›"
        raise TooLarge("out-of-memory", problem, remedy, path=job.picture.color)
    color, depth = read_pair(InputPair.of(job, held.keeping))
    inputs = Inputs(held, color, depth, empty=depth.nothing)
    inputs = replace(inputs, warnings=(*color.warnings, *depth.warnings))
    return through("read", Take(job=job, inputs=inputs, lens=job.lens)).inputs

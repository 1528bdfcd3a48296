"""Forecasts of jobs: size, blur radii, repair of depth, and an upper bound of the memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from defocus_core.errors import DefocusError
from defocus_core.picture import plain_path
from defocus_core.picture.memory_budget import base_mb, bound_of
from defocus_core.picture.scene import passes_of, surfaces_of
from defocus_core.picture.take import Take, repair_record, repair_words
from defocus_core.request.job import Job

MAX_READ = 16  # pictures of a batch to open
_OPENED_PIXELS = 1 << 24  # MB of pictures, beyond which no other is opened


class Forecast(NamedTuple):
    """A job prepared for rendering, with an upper bound of the memory that rendering takes."""

    take: Take
    peak_mb: float  # upper bound of the memory of the process, or of the GPU

    @property
    def record(self) -> dict[str, Any]:
        """The forecast as a dictionary for JSON."""
        return {
            "size": list(self.take.size),
            "coc_px": list(self.take.limits),
            "peak_mb": self.peak_mb,
            "color_note": self.take.color_note,
            "depth_note": self.take.depth_words(),
            "depth_repair": repair_record(self.take.repair),
        }

    def __str__(self) -> str:
        (width, height), (near, far) = self.take.size, self.take.limits
        repair = repair_words(self.take.repair)
        of_depth = f"; depth: {repair}" if repair else ""
        coc = f"CoC {near:.2f} to {far:.2f} px"
        return f"  {width}x{height}, {coc}: at most {self.peak_mb:.0f} MB{of_depth}"


def forecasts(jobs: Sequence[Job]) -> tuple[dict[int, Forecast], list[DefocusError]]:
    """Forecasts of jobs by index; and the errors of jobs that cannot be rendered.

    Of many jobs, at most `MAX_READ` are examined, at even intervals from first to last.
    """
    plain_path.load()
    count, pixels = min(len(jobs), MAX_READ), 0
    found, unusable = dict[int, Forecast](), list[DefocusError]()
    for number in (k * (len(jobs) - 1) // max(count - 1, 1) for k in range(count)):
        if pixels > _OPENED_PIXELS:
            break
        try:
            found[number] = forecast(jobs[number])
            pixels += math.prod(found[number].take.size)
        except DefocusError as error:
            unusable.append(error)
    return found, unusable


def forecast(job: Job) -> Forecast:
    """The forecast of a job; this reads its inputs and repairs the depth."""
    inputs = plain_path.read(job)
    take, arrays = plain_path.prepare(job, inputs), inputs.arrays_mb
    bounds = [0.0]
    if job.outputs.need_rendering:
        surfaces = surfaces_of(take)
        take = replace(take, repair=surfaces.repair)
        for _, renderer in plain_path.renderers(take, passes_of(surfaces)):
            bounds.append(bound_of(job, renderer, arrays, take.device))
    files = base_mb() + arrays if take.device == "cpu" else 0.0
    return Forecast(take, files + max(bounds))

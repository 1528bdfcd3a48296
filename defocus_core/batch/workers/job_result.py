"""One job carried out: read, computed, written; what came of it is `Taken` or `Failed`.

What is sent between processes has no arrays: outputs are relative to the root, inputs have no
paths, and an exception stays in the process that raised it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from defocus_core.batch.journal import identity
from defocus_core.batch.journal.record import Failed, Stamp, Taken, failure
from defocus_core.picture import plain_path
from defocus_core.picture.measures import measures
from defocus_core.picture.repair_words import repair_record
from defocus_core.picture.take import Inputs, Take
from defocus_core.request.job import Job
from defocus_core.request.lens import lens_record
from defocus_core.request.parameters import LENS_FILES

TileCount = Callable[[int, int], None]
_DIGITS = 6  # of radii and measures


class Reader:
    """Decodes the pictures of jobs; jobs of one picture that follow one another share it."""

    def __init__(self) -> None:
        self._last: tuple[object, Inputs] | None = None

    def read(self, job: Job) -> Inputs | Failed:
        """The inputs of a job, decoded, unless they cannot be."""
        key = (job.picture, job.reading, job.lens_focal, job.outputs.need_rendering)
        if self._last is not None and self._last[0] == key:
            inputs = self._last[1]
            shared = {role: stamp for role, stamp in inputs.stamps.items() if role in job.files}
            lens_files = {role: path for role, path in job.files.items() if role in LENS_FILES}
            return replace(inputs, stamps=shared | _stamps(lens_files), seconds=0.0)
        self._last = None  # free a picture before the next is decoded
        start, stamps = time.perf_counter(), _stamps(job.files)
        try:
            inputs = plain_path.read(job)
        except Exception as error:
            return failure(error, "read", stamps)
        inputs = replace(inputs, stamps=stamps, seconds=time.perf_counter() - start)
        self._last = key, inputs
        return inputs


def _stamps(files: Mapping[str, Path]) -> dict[str, Stamp]:
    """The stamps of files by role; what cannot be read is reported by its decoder."""
    stamps: dict[str, Stamp] = {}
    for role, path in files.items():
        with suppress(OSError):
            stamps[role] = identity.settled_stamp(path)
    return stamps


def compute(job: Job, inputs: Inputs | Failed, progress: TileCount | None = None) -> Take | Failed:
    """Compute a job whose inputs are decoded."""
    if isinstance(inputs, Failed):
        return inputs
    try:
        return plain_path.compute(job, inputs, progress)
    except Exception as error:
        return failure(error, "render", inputs.stamps)


def write(take: Take | Failed) -> Taken | Failed:
    """Write what a job computed; when this returns, it is durable."""
    if isinstance(take, Failed):
        return take
    start = time.perf_counter()
    job, inputs = take.job, take.inputs.stamps
    try:
        take = plain_path.write(take)
        root = job.outputs.root
        outputs = {
            name: identity.stamp(root / path, root)._replace(path=path)
            for name, path in job.names.items()
        }
    except Exception as error:
        return failure(error, "write", inputs)
    seconds = {
        "read": take.inputs.seconds,
        "render": take.seconds,
        "write": time.perf_counter() - start,
        "cpu": take.cpu_seconds,
    }
    return Taken(
        inputs=dict(inputs),
        outputs=outputs,
        lens=lens_record(take.lens),
        size=take.size,
        coc_px=take.limits,
        color_note=take.color_note,
        depth_note=take.depth_words(),
        depth_repair=repair_record(take.repair),
        device=take.device,
        measures={
            name: None if value is None else float(f"{value:.{_DIGITS}g}")
            for name, value in measures(take).items()
        },
        warnings=tuple(take.warnings),
        seconds={step: round(value, 4) for step, value in seconds.items()},
        stats=dict(take.stats),
    )

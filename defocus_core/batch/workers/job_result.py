"""One job carried out, and its record as a plain dictionary that is sent between processes.

What a worker knows of a record of the journal is there: status, reason, message, inputs, outputs,
lens, size, coc_px, color_note, depth_note, depth_repair, device, quality, measures, warnings and
seconds; outputs are relative to the root, inputs have no paths. Beside them, for the moment, are
`TRANSIENT`: ``stats`` of the renderer; where an error was raised, ``trace``, its traceback if it
was a fault, and ``error`` itself, for this process alone.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from defocus_core.batch.journal import identity
from defocus_core.batch.journal.journal import Record
from defocus_core.batch.journal.records import Step, verdict
from defocus_core.picture import plain_path
from defocus_core.picture.measures import measures
from defocus_core.picture.repair_words import repair_record
from defocus_core.picture.take import Inputs, Take
from defocus_core.request.job import Job
from defocus_core.request.lens import lens_record
from defocus_core.request.parameters import LENS_FILES

TileCount = Callable[[int, int], None]
TRANSIENT = ("stats", "trace", "error")  # keys of what the journal does not keep
_NO_PICTURE = dict.fromkeys(
    (
        "lens",
        "size",
        "coc_px",
        "color_note",
        "depth_note",
        "depth_repair",
        "device",
        "quality",
        "measures",
    )
)


class Reader:
    """Decodes the pictures of jobs; jobs of one picture that follow one another share it."""

    def __init__(self) -> None:
        self._last: tuple[object, Inputs] | None = None

    def read(self, job: Job) -> Inputs | Record:
        """The inputs of a job, decoded; its record if it cannot be done."""
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


def _stamps(files: Mapping[str, Path]) -> dict[str, Any]:
    """The stamps of files by role; what cannot be read is reported by its decoder."""
    stamps: dict[str, Any] = {}
    for role, path in files.items():
        with suppress(OSError):
            stamps[role] = identity.settled_stamp(path)
    return stamps


def compute(job: Job, inputs: Inputs | Record, progress: TileCount | None = None) -> Take | Record:
    """Compute a job whose inputs are decoded; its record if it cannot be done."""
    if isinstance(inputs, Mapping):
        return inputs
    try:
        return plain_path.compute(job, inputs, progress)
    except Exception as error:
        return failure(error, "render", inputs.stamps)


def write(take: Take | Record) -> Record:
    """Write what a job computed; when this returns, it is durable."""
    if isinstance(take, Mapping):
        return take
    start = time.perf_counter()
    job, inputs = take.job, take.inputs.stamps
    try:
        take = plain_path.write(take)
        outputs = {
            name: {"path": path, **identity.stamp(job.outputs.root / path, job.outputs.root)}
            for name, path in job.names.items()
        }
    except Exception as error:
        return failure(error, "write", inputs)
    return {
        "status": "ok",
        "reason": None,
        "message": "",
        "inputs": dict(inputs),
        "outputs": outputs,
        "lens": lens_record(take.lens),
        "size": list(take.size),
        "coc_px": list(take.limits),
        "color_note": take.color_note,
        "depth_note": take.depth_words(),
        "depth_repair": repair_record(take.repair),
        "device": take.device,
        "quality": job.machine.quality,
        "measures": measures(take),
        "warnings": list(take.warnings),
        "seconds": {
            "read": round(take.inputs.seconds, 4),
            "render": round(take.seconds, 4),
            "write": round(time.perf_counter() - start, 4),
            "cpu": round(take.cpu_seconds, 4),
        },
        "stats": dict(take.stats),
    }


def failure(error: Exception, step: Step, inputs: Mapping[str, Any]) -> Record:
    """The record of a job that an exception ended."""
    status, reason, message = verdict(error, step)
    result = {**failed(status, reason, message, inputs), "error": error}
    if reason == "fault":
        result["trace"] = "".join(traceback.format_exception(error))
    return result


def failed(status: str, reason: str, message: str, inputs: Mapping[str, Any]) -> Record:
    """The record of a job without outputs."""
    ended = {"status": status, "reason": reason, "message": message, "inputs": dict(inputs)}
    return {**ended, "outputs": {}, **_NO_PICTURE, "warnings": [], "seconds": {}, "stats": {}}

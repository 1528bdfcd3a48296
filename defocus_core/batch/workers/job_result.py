"""One job carried out, and its result as a plain dictionary that can be sent between processes.

A result has status, reason, message, inputs, outputs, lens, size, coc_px, color_note, depth_note,
depth_repair, device, quality, measures, warnings and seconds as a record of the journal has them,
but for paths: outputs are relative to the root, inputs have none. ``stats`` are those of the
renderer. Where something was raised, ``trace`` is its traceback if it was a fault, and ``error``
itself is there, for this process alone.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defocus_core.batch.depth.repair_words import repair_record
from defocus_core.batch.jobs.job import Job
from defocus_core.batch.journal import identity
from defocus_core.batch.journal.reasons import Step, verdict
from defocus_core.batch.lenses.lens import lens_record
from defocus_core.batch.lenses.parameters import LENS_FILES
from defocus_core.batch.rendering import delivery, job_steps
from defocus_core.batch.rendering.measures import measures

if TYPE_CHECKING:
    from defocus_core.batch.rendering.outcome import Loaded, Rendering

Result = dict[str, Any]
TileCount = Callable[[int, int], None]
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


@dataclass(frozen=True)
class Ready:
    """A job whose inputs are decoded, or which cannot be done."""

    job: Job
    loaded: Loaded | None
    inputs: Mapping[str, Any]
    seconds: float
    result: Result | None = None  # if it cannot be done


@dataclass(frozen=True)
class Computed:
    """A job that is computed."""

    ready: Ready
    rendering: Rendering
    seconds: float


class Reader:
    """Decodes the pictures of jobs; jobs of one picture that follow one another share it."""

    def __init__(self) -> None:
        self._last: tuple[object, Ready] | None = None

    def read(self, job: Job) -> Ready:
        """Decode the inputs of a job."""
        key = (job.picture, job.reading, job.lens_focal, job.outputs.need_rendering)
        if self._last is not None and self._last[0] == key:
            ready = self._last[1]
            shared = {role: stamp for role, stamp in ready.inputs.items() if role in job.files}
            own = {role: path for role, path in job.files.items() if role in LENS_FILES}
            return replace(ready, job=job, inputs=shared | _stamps(own), seconds=0.0)
        self._last = None  # free a picture before the next is decoded
        start = time.perf_counter()
        stamps = _stamps(job.files)
        try:
            loaded = job_steps.load_inputs(job)
        except Exception as error:
            return Ready(job, None, stamps, 0.0, failure(error, "read", stamps))
        ready = Ready(job, loaded, stamps, time.perf_counter() - start)
        self._last = key, ready
        return ready


def _stamps(files: Mapping[str, Path]) -> dict[str, Any]:
    """The stamps of files by role; what cannot be read is reported by its decoder."""
    stamps: dict[str, Any] = {}
    for role, path in files.items():
        with suppress(OSError):
            stamps[role] = identity.settled_stamp(path)
    return stamps


def compute(ready: Ready, progress: TileCount | None = None) -> Computed | Result:
    """Compute a job that can be done."""
    assert ready.loaded is not None
    start = time.perf_counter()
    try:
        rendering = job_steps.compute(ready.job, ready.loaded, progress)
    except Exception as error:
        return failure(error, "render", ready.inputs)
    return Computed(ready, rendering, time.perf_counter() - start)


def write(computed: Computed) -> Result:
    """Write what a job computed; when this returns, it is durable."""
    start = time.perf_counter()
    job, inputs = computed.ready.job, computed.ready.inputs
    try:
        outcome = delivery.write(computed.rendering)
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
        "lens": lens_record(outcome.lens),
        "size": list(outcome.size),
        "coc_px": list(outcome.coc_px),
        "color_note": outcome.color_note,
        "depth_note": outcome.depth_words(),
        "depth_repair": repair_record(outcome.repair),
        "device": outcome.device,
        "quality": outcome.quality,
        "measures": measures(computed.rendering, outcome),
        "warnings": list(outcome.warnings),
        "seconds": {
            "read": round(computed.ready.seconds, 4),
            "render": round(outcome.render_seconds, 4),
            "write": round(time.perf_counter() - start, 4),
            "cpu": round(outcome.render_cpu_seconds, 4),
        },
        "stats": dict(outcome.stats),
    }


def failure(error: Exception, step: Step, inputs: Mapping[str, Any]) -> Result:
    """The result of a job that an exception ended."""
    status, reason, message = verdict(error, step)
    result = failed(status, reason, message, inputs) | {"error": error}
    if reason == "fault":
        result["trace"] = "".join(traceback.format_exception(error))
    return result


def failed(status: str, reason: str, message: str, inputs: Mapping[str, Any]) -> Result:
    """The result of a job without outputs."""
    ended = {"status": status, "reason": reason, "message": message, "inputs": dict(inputs)}
    return {**ended, "outputs": {}, **_NO_PICTURE, "warnings": [], "seconds": {}, "stats": {}}

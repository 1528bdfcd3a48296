"""The report of a rendered job: a progress bar, a line of words, a JSON record."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from defocus_core.batch.journal.record import Failed, Record
from defocus_core.io.arrays import scratch_folder
from defocus_core.request.job import FRAME_ROLE, Job
from defocus_core.request.lens import lens_record, lens_record_words, lens_words
from defocus_core.system.text import counted


def job_record(job: Job) -> dict[str, Any]:
    """Inputs, lens and outputs of a job, for JSON."""
    return {
        "stem": job.sample_id,
        **{role: str(path) for role, path in _own_files(job).items()},
        "lens": lens_record(job.lens),
        "outputs": {kind: str(path) for kind, path in job.paths.items()},
        "previews": {kind: str(path) for kind, path in job.previews.items()},
    }


def _own_files(job: Job) -> dict[str, Path]:
    """The inputs of a job by role, without those of other frames of its shot."""
    return {role: path for role, path in job.files.items() if not role.startswith(FRAME_ROLE)}


def job_line(job: Job) -> str:
    """Inputs, lens and outputs of a job, in words."""
    inputs = dict.fromkeys(map(str, _own_files(job).values()))
    others = 0 if job.shot is None else len(job.shot.pictures.keys() - {job.picture.frame})
    more = f" and {counted(others, 'other frame')} of the shot" if others else ""
    return (
        f"{job.sample_id}: {lens_words(job.lens)}; would read {', '.join(inputs)}{more}; "
        f"would write {_written_words(job)}"
    )


def outcome_record(job: Job, record: Record, *, done_before: bool = False) -> dict[str, Any]:
    """A job that ended, for JSON: its plan, and the fields of its record."""
    end, taken = record.end, record.taken
    told = {name: getattr(taken, name, None) for name in _OF_PICTURES}
    seconds = {} if taken is None else taken.seconds
    return {
        **job_record(job),
        **{"status": end.status, "reason": end.reason, "message": end.message},
        **{"warnings": list(end.warnings), "quality": record.quality},
        **told,
        "lens": lens_record(job.lens) if taken is None else taken.lens,
        "done_before": done_before,
        "render_seconds": seconds.get("render"),
        "render_cpu_seconds": seconds.get("cpu"),
        "stats": {} if taken is None else dict(taken.stats),
    }


_OF_PICTURES = ("size", "color_note", "depth_note", "depth_repair", "coc_px", "device")


def outcome_lines(job: Job, record: Record, *, verbose: bool) -> Iterator[str]:
    """A job that ended, in words: one line, one for each warning, and more if ``verbose``."""
    end = record.end
    if isinstance(end, Failed):
        yield f"defocus: {end.message}"
        if verbose:
            yield from end.trace.splitlines()
        return
    (width, height), (near, far) = end.size, end.coc_px
    yield (
        f"{job.sample_id}: {width}x{height}, {lens_record_words(end.lens)}, "
        f"CoC {near:.2f} to {far:.2f} px, {end.seconds['render']:.2f} s -> {_written_words(job)}"
    )
    for warning in end.warnings:
        yield f"{job.sample_id}: warning: {warning}"
    if not verbose:
        return
    yield f"  colour: {end.color_note}"
    yield f"  depth: {end.depth_note}"
    threads = counted(job.machine.threads, "thread")
    yield f"  {end.device}, {threads}, {record.quality}, {end.seconds['cpu']:.2f} CPU s"
    counts = dict(end.stats)
    if (scratch := counts.pop("scratch_mb", None)) is not None:
        yield f"  {scratch:.0f} MB of scratch in {scratch_folder()}"
    if counts:
        yield "  " + ", ".join(f"{name} {count:.6g}" for name, count in counts.items())


def done_before_line(job: Job) -> str:
    """A job that was done before, in words."""
    return f"{job.sample_id}: done before -> {_written_words(job)}"


def _written_words(job: Job) -> str:
    """The files of a job, those of one name together, like ``out/{left,right}/a.exr``."""
    if job.outputs.file:
        return str(job.written[0])
    folders: dict[str, list[str]] = {}
    for path in job.written:
        folders.setdefault(path.name, []).append(path.parent.name)
    return ", ".join(
        str(job.outputs.root / (f"{{{','.join(kinds)}}}" if len(kinds) > 1 else kinds[0]) / name)
        for name, kinds in folders.items()
    )

"""The report of a rendered job: a progress bar, a line of words, a JSON record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from defocus_core.io.arrays import scratch_folder
from defocus_core.request.job import FRAME_ROLE, Job
from defocus_core.request.lens import lens_record, lens_record_words, lens_words
from defocus_core.system.text import counted

# What JSON tells of a job as its record has it.
_TOLD = (
    *("status", "reason", "message", "size", "color_note", "depth_note", "depth_repair"),
    *("coc_px", "device", "quality", "warnings"),
)


def plan_record(job: Job) -> dict[str, Any]:
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


def plan_line(job: Job) -> str:
    """Inputs, lens and outputs of a job, in words."""
    inputs = dict.fromkeys(map(str, _own_files(job).values()))
    others = 0 if job.shot is None else len(job.shot.pictures.keys() - {job.picture.frame})
    more = f" and {counted(others, 'other frame')} of the shot" if others else ""
    return (
        f"{job.sample_id}: {lens_words(job.lens)}; would read {', '.join(inputs)}{more}; "
        f"would write {_written_words(job)}"
    )


def outcome_record(
    job: Job, record: Mapping[str, Any], *, done_before: bool = False
) -> dict[str, Any]:
    """Inputs, lens, outputs, time and warnings of a job that ended, for JSON."""
    seconds = record["seconds"]
    return {
        **plan_record(job),
        **{key: record.get(key) for key in _TOLD},  # journals of earlier versions lack some
        "done_before": done_before,
        "lens": record["lens"] or lens_record(job.lens),
        "render_seconds": seconds.get("render"),
        "render_cpu_seconds": seconds.get("cpu"),
        "stats": record.get("stats", {}),
    }


def outcome_lines(job: Job, record: Mapping[str, Any], *, verbose: bool) -> Iterator[str]:
    """A job that ended, in words: one line, one for each warning, and more if ``verbose``."""
    if record["status"] != "ok":
        yield f"defocus: {record['message']}"
        if verbose and "trace" in record:
            yield from record["trace"].splitlines()
        return
    (width, height), (near, far) = record["size"], record["coc_px"]
    seconds = record["seconds"]
    yield (
        f"{job.sample_id}: {width}x{height}, {lens_record_words(record['lens'])}, "
        f"CoC {near:.2f} to {far:.2f} px, {seconds['render']:.2f} s -> {_written_words(job)}"
    )
    for warning in record["warnings"]:
        yield f"{job.sample_id}: warning: {warning}"
    if verbose:
        yield f"  colour: {record['color_note']}"
        yield f"  depth: {record['depth_note']}"
        yield (
            f"  {record['device']}, {counted(job.machine.threads, 'thread')}, {record['quality']}, "
            f"{seconds['cpu']:.2f} CPU s"
        )
        if "scratch_mb" in record["stats"]:
            scratch_mb = record["stats"]["scratch_mb"]
            yield f"  {scratch_mb:.0f} MB of scratch in {scratch_folder()}"
    counts = {name: count for name, count in record["stats"].items() if name != "scratch_mb"}
    if verbose and counts:
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

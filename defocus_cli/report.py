"""What commands tell: words and a progress bar on stderr, one JSON document on stdout."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from errno import ENOSPC
from functools import cache
from importlib import metadata
from typing import TYPE_CHECKING, Any

import click

from defocus_cli import stats_table
from defocus_cli.arrays import scratch_folder
from defocus_cli.errors import InputError, printable, reason
from defocus_cli.files import spoken
from defocus_cli.quantities import Percentile, counted, length_text

if TYPE_CHECKING:
    from defocus_cli.job import Job, Lens


@cache
def version() -> str:
    """The version of the installed package."""
    try:
        return metadata.version("defocus")
    except metadata.PackageNotFoundError:
        return "unknown"


def say(line: str) -> None:
    """One line on stderr, above the progress bar if there is one."""
    line = printable(line)
    # Words that find no ear are no reason to lose the picture.
    with spoken(), suppress(OSError):
        if "tqdm" in sys.modules and sys.stderr is not None:
            sys.modules["tqdm"].tqdm.write(line, file=sys.stderr)
        else:
            click.echo(line, err=True)


def tell(line: str) -> None:
    """One line on stdout.

    Raises:
        InputError: it cannot be written.
        BrokenPipeError: who read it has gone.
    """
    _print(printable(line))


def print_json(**document: Any) -> None:
    """One JSON document on stdout, which names the version first.

    Raises:
        InputError: it cannot be written.
        BrokenPipeError: who read it has gone.
    """
    _print(json.dumps({"defocus": version(), **document}, indent=1, allow_nan=False))


def _print(text: str) -> None:
    if sys.stdout is None:  # closed by whoever started us
        raise InputError("stdout", "is closed", "send it to a file or to another program")
    try:
        click.echo(text)
    except BrokenPipeError:
        raise
    except OSError as error:
        remedy = "free some space" if error.errno == ENOSPC else "check where it leads"
        raise InputError("stdout", f"cannot be written: {reason(error)}", remedy) from error


def lens_record(lens: Lens) -> dict[str, Any]:
    """A lens in plain numbers and words, units in the names; infinity is the word ``inf``."""
    record: dict[str, Any] = {
        "focal_length_mm": lens.foclen,
        "fnumber": lens.fnum,
        "sensor_width_mm": lens.sensor_width,
        "focus_mm": "inf" if lens.foc_dist == math.inf else lens.foc_dist,
        "blades": lens.blades,
        "blade_rotation_deg": lens.blade_rotation,
    }
    if lens.focus_at is not None:
        record["focus_at_px"] = list(lens.focus_at)
    if lens.focus_percentile is not None:
        record["focus_percentile"] = lens.focus_percentile
    if lens.max_coc is not None:
        record["max_coc_px"] = lens.max_coc
    if (draw := lens.draw) is not None:
        record["draw"] = {"seed": draw.seed, "index": draw.index, "attempt": draw.attempt}
    return record


def lens_words(lens: Lens) -> str:
    """A lens in words, like ``50mm f/1.4, focus 2m, sensor 36mm``."""
    return lens_record_words(lens_record(lens))


def lens_record_words(lens: Mapping[str, Any]) -> str:
    """The same of a lens in plain numbers."""
    focus = "at {},{}".format(*lens["focus_at_px"]) if "focus_at_px" in lens else ""
    if "focus_percentile" in lens:
        focus = f"at {Percentile(lens['focus_percentile'])}"
    if lens["focus_mm"] is not None:
        focus = f"{length_text(float(lens['focus_mm']))} {focus}".strip()
    shape = f", {lens['blades']} blades" if lens["blades"] else ""
    foclen, sensor = (length_text(lens[f"{key}_mm"]) for key in ("focal_length", "sensor_width"))
    return f"{foclen} f/{lens['fnumber']:g}, focus {focus}, sensor {sensor}{shape}"


def plan_record(job: Job) -> dict[str, Any]:
    """What a job would read and write."""
    return {
        "stem": job.sample_id,
        **{role: str(path) for role, path in job.picture.files.items()},
        "lens": lens_record(job.lens),
        "outputs": {kind: str(path) for kind, path in job.paths.items()},
        "previews": {kind: str(path) for kind, path in job.previews.items()},
    }


def plan_line(job: Job) -> str:
    """What a job would read and write, in words."""
    inputs = dict.fromkeys(map(str, job.picture.files.values()))
    return (
        f"{job.sample_id}: {lens_words(job.lens)}; would read {', '.join(inputs)}; "
        f"would write {_written_words(job)}"
    )


def outcome_record(
    job: Job, record: Mapping[str, Any], result: Mapping[str, Any]
) -> dict[str, Any]:
    """What a job read, did and wrote.

    Args:
        job: the job.
        record: what the journal says of it.
        result: what became of it now; empty if it was done before.
    """
    seconds = record["seconds"]
    return {
        **plan_record(job),
        "status": record["status"],
        "reason": record["reason"],
        "message": record["message"],
        "done_before": not result,
        "size": record["size"],
        "color_note": record.get("color_note"),  # journals of earlier versions have none
        "depth_note": record["depth_note"],
        "lens": record["lens"] or lens_record(job.lens),
        "coc_px": record["coc_px"],
        "device": record["device"],
        "quality": record["quality"],
        "render_seconds": seconds.get("render"),
        "render_cpu_seconds": seconds.get("cpu"),
        "warnings": record["warnings"],
        "stats": result.get("stats", {}),
    }


def outcome_lines(
    job: Job,
    record: Mapping[str, Any],
    result: Mapping[str, Any],
    *,
    verbose: bool,
    stats: bool = False,
) -> Iterator[str]:
    """What a job did, in words: one line, one for each warning, and more if ``verbose``.

    What was computed and what was skipped is a table if ``stats``, a line if ``verbose`` alone.
    """
    if record["status"] != "ok":
        yield f"defocus: {record['message']}"
        if verbose and "trace" in result:
            yield from result["trace"].splitlines()
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
        if "scratch_mb" in result["stats"]:
            scratch_mb = result["stats"]["scratch_mb"]
            yield f"  {scratch_mb:.0f} MB of scratch in {scratch_folder()}"
    counts = {name: count for name, count in result["stats"].items() if name != "scratch_mb"}
    if stats:
        yield from stats_table.lines(counts)
    elif verbose and counts:
        yield "  " + ", ".join(f"{name} {count:.6g}" for name, count in counts.items())


def done_before_line(job: Job) -> str:
    """That a job was done before, in words."""
    return f"{job.sample_id}: done before -> {_written_words(job)}"


def _written_words(job: Job) -> str:
    """The files of a job, those of one name together, like ``out/{left,right}/a.exr``."""
    folders: dict[str, list[str]] = {}
    for path in job.written:
        folders.setdefault(path.name, []).append(path.parent.name)
    return ", ".join(
        str(job.outputs.root / (f"{{{','.join(kinds)}}}" if len(kinds) > 1 else kinds[0]) / name)
        for name, kinds in folders.items()
    )

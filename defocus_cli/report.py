"""What commands tell: words and a progress bar on stderr, one JSON document on stdout."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from importlib import metadata
from typing import TYPE_CHECKING, Any

import click

from defocus_cli.quantities import Percentile, length_text

if TYPE_CHECKING:
    from defocus_cli.engine import Outcome
    from defocus_cli.inspection import DepthFound, Inspection
    from defocus_cli.job import Job, Lens


TileCount = Callable[[int, int], None]

_MAP_WORDS = {
    "coc": "CoC map (signed radius, negative nearer than the focus)",
    "disparity": "disparity map (between left and right, signed like the CoC)",
}


@cache
def version() -> str:
    """The version of the installed package."""
    try:
        return metadata.version("defocus")
    except metadata.PackageNotFoundError:
        return "unknown"


def say(line: str) -> None:
    """One line on stderr, above the progress bar if there is one."""
    with suppress(OSError):  # words that find no ear are no reason to lose the picture
        if "tqdm" in sys.modules and sys.stderr is not None:
            sys.modules["tqdm"].tqdm.write(line, file=sys.stderr)
        else:
            click.echo(line, err=True)


def print_json(**document: Any) -> None:
    """One JSON document on stdout, which names the version first."""
    click.echo(json.dumps({"defocus": version(), **document}, indent=1, allow_nan=False))


@contextmanager
def progress(jobs: Sequence[Job]) -> Iterator[tuple[Iterable[Job], TileCount | None]]:
    """The jobs, and what to tell (tiles done, tiles in all) of each, None if nobody watches.

    If stderr is a terminal, a bar there counts the jobs, or the tiles of a lone job.
    """
    if sys.stderr is None or not sys.stderr.isatty():  # None: closed by whoever started us
        yield jobs, None
        return
    from tqdm import tqdm

    if len(jobs) > 1:
        with tqdm(jobs, unit="picture", file=sys.stderr, leave=False) as bar:
            yield bar, None
        return
    with tqdm(unit="tile", file=sys.stderr, leave=False) as tile_bar:

        def count(done: int, total: int) -> None:
            if tile_bar.total is None:
                tile_bar.reset(total)
            tile_bar.update(done - tile_bar.n)

        yield jobs, count


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
    focus = f"at {lens.focus_at[0]},{lens.focus_at[1]}" if lens.focus_at else ""
    if lens.focus_percentile is not None:
        focus = f"at {Percentile(lens.focus_percentile)}"
    if lens.foc_dist is not None:
        focus = f"{length_text(lens.foc_dist)} {focus}".strip()
    shape = f", {lens.blades} blades" if lens.blades else ""
    sensor = length_text(lens.sensor_width)
    return f"{length_text(lens.foclen)} f/{lens.fnum:g}, focus {focus}, sensor {sensor}{shape}"


def plan_record(job: Job) -> dict[str, Any]:
    """What a job would read and write."""
    return {
        "stem": job.sample_id,
        "color": str(job.picture.color),
        "depth": str(job.picture.depth),
        "lens": lens_record(job.lens),
        "outputs": {kind: str(path) for kind, path in job.paths.items()},
        "previews": {kind: str(path) for kind, path in job.previews.items()},
    }


def plan_line(job: Job) -> str:
    """What a job would read and write, in words."""
    inputs = dict.fromkeys([str(job.picture.color), str(job.picture.depth)])
    return (
        f"{job.sample_id}: {lens_words(job.lens)}; would read {', '.join(inputs)}; "
        f"would write {_written_words(job)}"
    )


def outcome_record(outcome: Outcome) -> dict[str, Any]:
    """What a job read, did and wrote."""
    return {
        **plan_record(outcome.job),
        "size": list(outcome.size),
        "depth_note": outcome.depth_note,
        "lens": lens_record(outcome.lens),
        "coc_px": list(outcome.coc_px),
        "device": outcome.device,
        "quality": outcome.job.machine.quality,
        "render_seconds": outcome.render_seconds,
        "render_cpu_seconds": outcome.render_cpu_seconds,
        "warnings": list(outcome.warnings),
        "stats": dict(outcome.stats),
    }


def outcome_lines(outcome: Outcome, *, verbose: bool) -> Iterator[str]:
    """What a job did, in words: one line, one for each warning, and more if ``verbose``."""
    width, height = outcome.size
    near, far = outcome.coc_px
    yield (
        f"{outcome.job.sample_id}: {width}x{height}, {lens_words(outcome.lens)}, "
        f"CoC {near:.2f} to {far:.2f} px, {outcome.render_seconds:.2f} s -> "
        f"{_written_words(outcome.job)}"
    )
    for warning in outcome.warnings:
        yield f"{outcome.job.sample_id}: warning: {warning}"
    if verbose:
        yield f"  depth: {outcome.depth_note}"
        yield (
            f"  {outcome.device}, {outcome.job.machine.threads} threads, "
            f"{outcome.job.machine.quality}, {outcome.render_cpu_seconds:.2f} CPU s"
        )
        if outcome.stats:
            yield "  " + ", ".join(f"{name} {value:.6g}" for name, value in outcome.stats.items())


def _written_words(job: Job) -> str:
    """The files of a job, those of one name together, like ``out/{left,right}/a.exr``."""
    folders: dict[str, list[str]] = {}
    for path in job.written:
        folders.setdefault(path.name, []).append(path.parent.name)
    return ", ".join(
        str(job.outputs.root / (f"{{{','.join(kinds)}}}" if len(kinds) > 1 else kinds[0]) / name)
        for name, kinds in folders.items()
    )


def inspection_record(found: Inspection) -> dict[str, Any]:
    """What is in a file."""
    record: dict[str, Any] = {
        "file": str(found.info.path),
        "size": [found.info.width, found.info.height],
        "parts": [
            {"index": p.index, "name": p.name, "deep": p.deep, "channels": dict(p.channels)}
            for p in found.info.parts
        ],
        "color": None,
        "color_note": found.color_note,
        "depth": None,
        "depth_note": found.depth_note,
        "maps": [{"kind": shown.kind, "range_px": shown.range_px} for shown in found.maps],
    }
    if found.color is not None:
        record["color"] = {
            "channels": list(found.color.channels),
            "nonfinite_pixels": found.color.nonfinite,
        }
    if (depth := found.depth) is not None:
        record["depth_note"] = depth.note
        record["depth"] = {
            "range_m": depth.range_m,
            "sky_pixels": depth.sky,
            "invalid_pixels": depth.invalid,
            "lens": lens_record(depth.lens) if depth.lens else None,
            "coc_px": depth.coc_px,
        }
    return record


def inspection_lines(found: Inspection) -> Iterator[str]:
    """What is in a file, in words."""
    info = found.info
    yield f"{info.path}: {info.width}x{info.height}"
    for part in info.parts:
        named = f"part {part.index}{f' ({part.name})' if part.name else ''}: "
        channels = ", ".join(f"{name} {kind}" for name, kind in part.channels)
        yield f"  {named if len(info.parts) > 1 else ''}{channels}{', deep' if part.deep else ''}"
    for shown in found.maps:
        reach = "no finite pixel"
        if shown.range_px is not None:
            reach = f"{shown.range_px[0]:.2f} to {shown.range_px[1]:.2f} px"
        yield f"  {_MAP_WORDS[shown.kind]}: {reach}"
    if found.maps and found.color is None and found.depth is None:
        return
    if found.color is None:
        yield f"  no colour: {found.color_note}"
    else:
        holes = f", {found.color.nonfinite} pixels not finite" if found.color.nonfinite else ""
        yield f"  colour: {', '.join(found.color.channels)}{holes}"
    if found.depth is None:
        yield f"  no depth: {found.depth_note}"
    else:
        yield from _depth_lines(found.depth)


def _depth_lines(depth: DepthFound) -> Iterator[str]:
    reach = "no finite depth"
    if depth.range_m is not None:
        reach = f"{depth.range_m[0]:.6g} m to {depth.range_m[1]:.6g} m"
    yield f"  depth: {reach}, {depth.sky} sky and {depth.invalid} invalid pixels ({depth.note})"
    if depth.lens is not None and depth.coc_px is not None:
        near, far = depth.coc_px
        yield f"  CoC: {near:.2f} to {far:.2f} px ({lens_words(depth.lens)})"

"""``defocus info``: the contents of a file, and how it would be read."""

from __future__ import annotations

from pathlib import Path

import click

from defocus_cli.options import shared
from defocus_cli.options.reading import reading_options
from defocus_cli.options.shot import shot_lens_options
from defocus_cli.options.types import FilePath, GroupedCommand
from defocus_cli.words import console
from defocus_cli.words import inspection as inspection_report
from defocus_cli.words.endings import Failures
from defocus_core.batch.jobs.job import Picture, Reading, reading_through
from defocus_core.batch.jobs.shot_lenses import ShotLenses
from defocus_core.errors import DefocusError
from defocus_core.io.shots.frame_patterns import is_pattern
from defocus_core.reports.inspection import shot_summary
from defocus_core.reports.inspection.inspection import inspect, inspect_pairs
from defocus_core.reports.inspection.repair_drawing import check_preview, draw_repair


@click.command("info", cls=GroupedCommand)
@click.argument("files", type=FilePath(), nargs=-1, required=True, metavar="FILE...")
@shot_lens_options(required=False)
@reading_options
@click.option(
    "--preview",
    type=FilePath(),
    metavar="PNG",
    help="Draw a colour and a depth file: the picture, and beside it where its depth is repaired, "
    "orange where it was made nearer, blue where farther. Needs a lens.",
)
@shared.json_option
def command(
    files: tuple[Path, ...],
    lenses: ShotLenses | None,
    reading: Reading,
    preview: Path | None,
    as_json: bool,
) -> None:
    """Say what is in colour and depth files, as 'defocus render' would read them.

    With a lens, the range of the signed radius of the circle of confusion is shown too. A file that
    cannot be read is named, and the others are reported. A file of colour and one of depth, of one
    size, are compared: whether the colour is blurred already, and whether the two lie on each
    other.

    Of patterns like 'shot.####.exr' the shot is summed up: frames, gaps, sizes, depth over time
    and, with a lens, where blur is largest.

    \b
    With --json, "files" has of each:
      file, size   its path; width and height in px
      parts        index, name, deep, views, and channels with their types; of an EXR
                   data_window and display_window (x and y of their first and last pixel),
                   pixel_aspect; of a deep one samples: most_of_a_pixel, total, pixels,
                   range_z, the least and greatest depth as it stands in the file
      color        channels, nonfinite_pixels; with alpha nothing_pixels, where it is 0, and
                   partial_pixels, where it is below 1; null if there is none
      color_note   how the colour would be read, or why there is none
      depth        range_m, or range of what is no distance, sky_pixels, invalid_pixels,
                   nothing_pixels, where the alpha of the colour is 0; with a lens, which lens,
                   coc_px, repair: what would be done to the depth before it is rendered, empty
                   if nothing, and depth_repair: the same in numbers (kinds, noise_px,
                   edge_width_px, displaced_px, share of pixels); warnings of a depth that hardly
                   suits the lens; null if there is none
      depth_note   how the depth would be read, or why there is none
      evidence     formats that the depth could be of
      maps         kind, and range_px or range, of what 'defocus render' wrote
    "shots" has of each pattern:
      pattern, frames, gaps
                   the pattern, the numbers that are there, and those missing
      sizes        size, and the frames of this size
      depth        of 25 frames at most, evenly spread: frame, range_m or range, sky_pixels,
                   focus_mm, coc_px and repair, null without a lens
      largest_blur frame and coc_px; null without a lens
    "pairs" has, of a file of colour and one of depth, or a file of both, whose size is one:
      color, depth the files
      evidence     what shows that the colour is blurred already, or does not lie on the depth
      repair, depth_repair, preview
                   with --preview: what was done to the depth with the colours, and the PNG
    and "failed" of files that cannot be read: subject, problem, remedy

    \b
    Examples:
      defocus info rgb.exr depth.exr
      defocus info depth_mm.png --focal-length 50mm --fnumber 1.4 --focus 2m
      defocus info rgb.exr depth.exr --lens 50mm.toml --preview repaired.png
      defocus info 'rgb.####.exr' 'depth.####.exr' --focal-length 50mm --animate pull.csv
    """  # noqa: D301  click reads the backspace
    patterns = [file for file in files if is_pattern(file)]
    files = tuple(file for file in files if file not in patterns)
    shots = shot_summary.summarise(patterns, reading, lenses) if patterns else []
    for shot in () if as_json else shots:
        for line in shot_summary.lines(shot):
            console.stdout(line)
    lens = None
    if lenses is not None and files:
        lens = lenses.of(Picture(files[0].stem, files[0], files[0]))[0]
    reading = reading_through(reading, lens)
    if preview is not None:
        check_preview(preview, files, lens)
    failures = Failures()
    records = []
    for file in files:  # each is reported before the next is read
        try:
            record = inspect(file, reading, lens, lone=len(files) == 1)
        except DefocusError as error:
            failures.add(error)
            continue
        records.append(record)
        for line in () if as_json else inspection_report.lines(record):
            console.stdout(line)
    pairs = inspect_pairs(records, reading, lens)
    if preview is not None and lens is not None and not failures:
        draw_repair(pairs, reading, lens, preview)
    for pair in () if as_json else pairs:
        for line in inspection_report.pair_lines(pair):
            console.stdout(line)
    if as_json and (records or shots):
        more = {"shots": shots} if shots else {}
        console.print_json(files=records, pairs=pairs, **more, failed=failures.records())
    failures.end()

"""``defocus depth``: convert depth files of any format to EXR in planar metres."""

from __future__ import annotations

from pathlib import Path

import click

from defocus_cli.options.job import reading_options
from defocus_cli.options.shared import FilePath, GroupedCommand, json_option, output_option
from defocus_cli.words import console
from defocus_core.picture.depth_conversion import convert, refuse_existing, targets
from defocus_core.request.job import Reading
from defocus_core.system.text import counted


@click.command("depth", cls=GroupedCommand)
@click.argument("files", type=FilePath(), nargs=-1, required=True, metavar="FILE...")
@output_option(
    "-o --out OUT",
    "EXR file to write, ending in .exr; or a directory, for an EXR <stem>.exr of each FILE.",
    FilePath(),
    required=True,
)
@output_option("--preview", "Also write <stem>.preview.png to look at, where near is bright.")
@output_option("--overwrite", "Replace existing files.")
@reading_options(lambda row: not row.of_pictures)
@json_option
def command(
    files: tuple[Path, ...],
    out: Path,
    preview: bool,
    overwrite: bool,
    reading: Reading,
    as_json: bool,
) -> None:
    """Convert depth files to EXR with depth in metres, in the float channel Z.

    The depth is planar: the distance along the optical axis, not to the point. Sky is inf.

    Say what the numbers in the files mean: by --depth-format, whose names 'defocus help depth'
    lists, or by --depth-unit, --depth-kind and the other options, which hold for all FILES. Nothing
    is guessed from the numbers. If a file cannot be converted, an error names it, and the others
    are converted.

    \b
    Examples:
      defocus depth 000001.png --depth-format kitti --invalid fill -o depth.exr
      defocus depth disp0.pfm --depth-format middlebury --invalid far -o depth.exr
      defocus depth disparity.png --depth-kind disparity --depth-range 2m 50m -o depth.exr
      defocus depth frames/*.png --depth-format vkitti2 -o depths --preview
    """  # noqa: D301  click reads the backspace
    wanted = targets(files, out, preview=preview)
    refuse_existing(wanted, overwrite=overwrite)
    failures = console.Failures()
    records = []
    for place in wanted:
        with failures.kept():
            converted = convert(place, reading)
            records.append(converted)
            for warning in converted["warnings"]:
                console.stderr(f"warning: {warning}")
            if not as_json:
                ends, sky = converted["range_m"], converted["sky_pixels"]
                words = "all sky" if ends is None else f"{ends[0]:.6g} m to {ends[1]:.6g} m"
                words += f", {counted(sky, 'sky pixel')}" if sky else ""
                console.stdout(f"{place.file} → {place.out}: {words} ({converted['note']})")
    if as_json and records:
        console.print_json(files=records, failed=failures.records())
    failures.end()

"""``defocus info``: the contents of a file, and how it would be read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from defocus_cli.options.job import reading_options, shot_lens_options
from defocus_cli.options.shared import FilePath, GroupedCommand, json_option
from defocus_cli.words import console
from defocus_core.io.exr.windows import Window
from defocus_core.io.shots.frame_patterns import is_pattern
from defocus_core.reports.inspection import inspect, range_key, range_words, shot_line, summarised
from defocus_core.request.job import PictureFiles, Reading, reading_through
from defocus_core.request.lens import lens_record_words
from defocus_core.request.output_kinds import KINDS
from defocus_core.request.parameters import BLURRING
from defocus_core.request.picture_lenses import PictureLenses
from defocus_core.system.text import counted


@click.command("info", cls=GroupedCommand)
@click.argument("files", type=FilePath(), nargs=-1, required=True, metavar="FILE...")
@shot_lens_options(required=False, names=BLURRING, moving=False)
@reading_options(lambda row: not (row.of_render or row.name == "resize-depth"))
@json_option
def command(
    files: tuple[Path, ...], lenses: PictureLenses | None, reading: Reading, as_json: bool
) -> None:
    """Show what colour and depth files contain, and how 'defocus render' would read them.

    For each file: its size in px, parts, channels and number types, and the range of its depth in
    metres. With a lens, also the range of the radius of the blur in px, negative nearer than the
    focus. For a pattern like 'shot.####.exr', a line shows the frames, gaps and sizes.

    Files are read one by one; 'defocus render' with --dry-run checks colour and depth together. If
    a file cannot be read, an error names it, and the other files are shown.

    \b
    Examples:
      defocus info rgb.exr depth.exr
      defocus info depth_mm.png --focal-length 50mm --fnumber 1.4 --focus 2m
      defocus info 'rgb.####.exr' 'depth.####.exr'
    """  # noqa: D301  click reads the backspace
    patterns = [file for file in files if is_pattern(file)]
    files = tuple(file for file in files if file not in patterns)
    shots = list(map(summarised, patterns))
    console.stdout(*(() if as_json else map(shot_line, shots)))
    lens = None
    if lenses is not None and files:
        lens = lenses.lens_of(PictureFiles(files[0].stem, files[0], files[0]))[0]
    reading = reading_through(reading, lens)
    failures = console.Failures()
    records: list[dict[str, Any]] = []
    for file in files:  # each is reported before the next is read
        count = len(records)
        with failures.kept():
            records.append(inspect(file, reading, lens, lone=len(files) == 1))
        if not as_json and len(records) > count:  # a full stdout ends the command
            console.stdout(*file_lines(records[-1]))
    if as_json and (records or shots):
        more = {"shots": shots} if shots else {}
        console.print_json(files=records, **more, failed=failures.records())
    failures.end()


def file_lines(told: Mapping[str, Any]) -> Iterator[str]:
    """The content of a file in words, from the record of ``inspect``."""
    color, depth = told["color"], told["depth"]
    yield "{}: {}x{}".format(told["file"], *told["size"])
    for part in told["parts"]:
        name = f" ({part['name']})" if part["name"] else ""
        named = f"part {part['index']}{name}: "
        channels = ", ".join(f"{name} {kind}" for name, kind in part["channels"].items())
        deep = ", deep" if part["deep"] else ""
        yield f"  {named if len(told['parts']) > 1 else ''}{channels}{deep}{_layout(part)}"
        if samples := part.get("samples"):
            ends, most = samples["range_z"], counted(samples["most_of_a_pixel"], "sample")
            depths = f"Z {ends[0]:.6g} to {ends[1]:.6g}" if ends else "without Z"
            total, pixels = counted(samples["total"], "sample"), counted(samples["pixels"], "pixel")
            yield f"    {total} in {pixels}, {most} a pixel at most, {depths}"
    for shown in told["maps"]:
        kind, ends = KINDS[shown["kind"]], shown[range_key(shown["kind"])]
        reach = f"{ends[0]:.2f} to {ends[1]:.2f} {kind.unit}".rstrip() if ends else ""
        yield f"  {kind.title}: {reach or 'no finite pixel'}"
    if told["maps"] and color is None and depth is None:
        return
    if color is None:
        yield f"  no colour: {told['color_note']}"
    else:
        bad = color["nonfinite_pixels"]
        holes = f", {counted(bad, 'pixel')} not finite" if bad else ""
        if color.get("nothing_pixels") or color.get("partial_pixels"):
            partial = f"below 1 in {counted(color['partial_pixels'], 'pixel')}"
            holes += f", alpha 0 in {counted(color['nothing_pixels'], 'pixel')} and {partial}"
        yield f"  colour: {', '.join(color['channels'])}{holes} ({told['color_note']})"
    if depth is None:
        yield f"  no depth: {told['depth_note']}"
    else:
        yield from _depth_lines(depth, told["depth_note"])
    for sentence in told["evidence"]:
        yield f"  {sentence}"


def _layout(part: Mapping[str, Any]) -> str:
    """Views, windows and pixel aspect of a part of an EXR in words; empty if all are usual."""
    words = []
    if part["views"]:
        words.append(f"view{'s' * (len(part['views']) > 1)} {', '.join(part['views'])}")
    windows = [part.get(f"{name}_window") for name in ("data", "display")]
    if windows[0] != windows[1]:
        data, display = (Window(*window) for window in windows if window)
        words.append(f"data window {data}, display window {display}")
    if part.get("pixel_aspect", 1) != 1:
        words.append(f"pixels {part['pixel_aspect']:g} times as wide as high")
    return "".join(f"; {word}" for word in words)


def _depth_lines(depth: Mapping[str, Any], note: str) -> Iterator[str]:
    """The depth of a file in words."""
    invalid = counted(depth["invalid_pixels"], "invalid pixel")
    if depth["nothing_pixels"]:
        invalid += f", nothing in {counted(depth['nothing_pixels'], 'pixel')}"
    yield f"  depth: {range_words(depth)}, {depth['sky_pixels']} sky and {invalid} ({note})"
    if depth["coc_px"] is not None:
        near, far = depth["coc_px"]
        yield f"  CoC: {near:.2f} to {far:.2f} px ({lens_record_words(depth['lens'])})"
        if depth["repair"]:
            yield f"  rendered: {depth['repair']}"
    for warning in depth["warnings"]:
        yield f"  warning: {warning}"

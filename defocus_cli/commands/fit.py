"""``defocus fit``: the lens between a sharp and a blurred picture."""

from __future__ import annotations

from pathlib import Path

import click

from defocus_cli.jobs.job import Reading
from defocus_cli.jobs.lens_options import PARSERS
from defocus_cli.jobs.pairing import find_pictures
from defocus_cli.options import shared
from defocus_cli.options.reading import reading_options
from defocus_cli.options.types import FilePath, GroupedCommand, Quantity, grouped_option
from defocus_cli.rendering import lens_fit
from defocus_cli.reports.batch_report import tile_bar
from defocus_cli.system import console
from defocus_cli.system.errors import InputError, UsageProblem, UserError

_MOST_BLADES = 99


def _blades(text: str) -> tuple[int, ...]:
    """Numbers of blades, as ``0,5,6``."""
    from defocus_cli.lenses.quantities import QuantityError

    numbers = [part.strip() for part in text.split(",")]
    if not all(n.isdigit() and (int(n) == 0 or 3 <= int(n) <= _MOST_BLADES) for n in numbers):
        raise QuantityError(f"'{text}' names no numbers of blades", "write them like 0,5,6")
    return tuple(dict.fromkeys(map(int, numbers)))


@click.command(
    "fit", cls=GroupedCommand, short_help="Find the lens between a sharp and a blurred picture."
)
@click.argument("sharp", type=FilePath(), metavar="SHARP")
@click.argument("depth", type=FilePath(), metavar="DEPTH")
@click.argument("blurred", type=FilePath(), metavar="BLURRED")
@grouped_option(
    "Files",
    "--right",
    type=FilePath(),
    metavar="FILE",
    help="The right picture of a dual-pixel pair, of which BLURRED is the left one.",
)
@grouped_option(
    "Output",
    "-o",
    "--out",
    type=FilePath(),
    metavar="LENS.toml",
    help="Lens file to write; of folders, a directory for <stem>.toml.",
)
@grouped_option("Output", "--overwrite", is_flag=True, help="Replace lens files that are there.")
@grouped_option(
    "Lens",
    "--focal-length",
    type=Quantity(PARSERS["focal-length"], "LENGTH"),
    default="50mm",
    show_default=True,
    metavar="LENGTH",
    help="Focal length of the lens, for which the f-number is found.",
)
@grouped_option(
    "Lens",
    "--sensor-width",
    type=Quantity(PARSERS["sensor-width"], "LENGTH"),
    default="36mm",
    show_default=True,
    metavar="LENGTH",
    help="Width of the sensor that the pictures show.",
)
@grouped_option(
    "Lens",
    "--blades",
    type=Quantity(_blades, "N,…"),
    default="0",
    show_default=True,
    metavar="N,…",
    help="Numbers of blades to choose from; 0 is round.",
)
@grouped_option(
    "Lens",
    "--exposure",
    is_flag=True,
    help="Find a factor for each colour, too: the pictures differ in exposure or white balance.",
)
@reading_options
@shared.json_option
def command(
    sharp: Path,
    depth: Path,
    blurred: Path,
    right: Path | None,
    out: Path | None,
    overwrite: bool,
    focal_length: float,
    sensor_width: float,
    blades: tuple[int, ...],
    exposure: bool,
    reading: Reading,
    as_json: bool,
) -> None:
    """Find focus and f-number by which SHARP with its DEPTH looks like BLURRED; files or folders.

    The radius of the blur is affine in 1/depth. So depth of unknown scale and shift will do: give
    any --depth-range, and use the lens file with the same one. Pixels that are clipped, or that a
    rendering must invent, hardly count. Errors are standard errors.

    \b
    With --json, "pairs" has of each:
      picture      its path
      focus_m, focus_dioptres, focus_error_dioptres; focus_m is null at infinity
      fnumber, fnumber_error (relative), px_per_dioptre
      blades, gains
      psnr         all, edges, elsewhere, in dB of compressed light
      doubts       what these pictures do not tell

    \b
    Examples:
      defocus fit sharp.exr depth.exr blurred.exr -o lens.toml
      defocus fit sharp.png d.png blurred.png --depth-kind disparity --depth-range 1m 20m
      defocus fit sharp depth blurred -o lenses --focal-length 85mm --exposure --blades 0,7
    """  # noqa: D301  click reads the backspace
    pairs = lens_fit.pairs_of(find_pictures(sharp, depth), blurred, right)
    many = sharp.is_dir()
    places = [out and (out / f"{p.picture.stem}.toml" if many else out) for p in pairs]
    for named in filter(None, places):
        if named.suffix != ".toml":
            raise UsageProblem("-o", f"{named} is no lens file", "let it end in .toml")
        if named.exists() and not overwrite:
            raise InputError(named, "is there already", "give another -o, or --overwrite")
    if many and out is not None:
        out.mkdir(parents=True, exist_ok=True)
    options = lens_fit.FitOptions(focal_length, sensor_width, blades, exposure)
    records, failed = [], None
    for pair, place in zip(pairs, places, strict=True):
        try:
            with tile_bar() as progress:
                record = lens_fit.fit_pair(pair, reading, options, progress)
        except UserError as error:
            if failed:
                failed.show()
            failed = error
            continue
        if place is not None:
            lens_fit.write_lens(place, record)
        records.append({**record, "out": None if place is None else str(place)})
        if not as_json:
            lines = lens_fit.words(record)
            click.echo("\n".join([f"{pair.picture.color}:", *(f"  {line}" for line in lines)]))
    if as_json:
        console.print_json(pairs=records)
    if failed:
        raise failed

"""``defocus fit``: find the lens between a sharp and a blurred picture."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from defocus_cli.options.job import reading_options
from defocus_cli.options.shared import (
    FilePath,
    GroupedCommand,
    bundle,
    files_option,
    json_option,
    lens_option,
    output_option,
)
from defocus_cli.words import console
from defocus_cli.words.batch import tile_bar
from defocus_core.errors import UsageProblem
from defocus_core.io.write_files import require_replaceable
from defocus_core.picture.lens_fit import FitOptions, fit_files, words, write_lens
from defocus_core.request.job import PictureFiles, Reading
from defocus_core.request.parameters import LENS_OPTIONS

_fit_option = partial(lens_option, is_common=True)
_options = [
    _fit_option(
        "--focal-length LENGTH",
        "Focal length of the lens; the f-number that is found depends on it.",
        LENS_OPTIONS["focal-length"].parse,
        into="foclen",
        default="50mm",
        show_default=True,
    ),
    _fit_option(
        "--sensor-width LENGTH",
        "Width of the sensor area that the pictures show.",
        LENS_OPTIONS["sensor-width"].parse,
        default="36mm",
        show_default=True,
    ),
    _fit_option(
        "--exposure",
        "Also find how brightness differs: a factor for each colour, and for each blurred "
        "picture how its light falls off towards the corners.  [default: the same brightness]",
    ),
    _fit_option(
        "--shift",
        "Also find the shift of BLURRED relative to SHARP, up to 16 px.  [default: no shift]",
    ),
    _fit_option("--dual-pixel", "Also find the crosstalk of the photodiodes, with --right."),
    _fit_option(
        "--dp-model MODEL",
        "What the photodiodes of a dual pixel see: split, smooth, @pixel4, @canon-dpp, or a file "
        "of measured kernels ('defocus help look'). Only with --right.  "
        "[default: smooth with --dual-pixel, else split]",
        LENS_OPTIONS["dp-model"].parse,
    ),
]


@click.command("fit", cls=GroupedCommand)
@click.argument("sharp", type=FilePath(), metavar="SHARP")
@click.argument("depth", type=FilePath(), metavar="DEPTH")
@click.argument("blurred", type=FilePath(), metavar="BLURRED")
@files_option(
    "--right FILE",
    "The right picture of a dual-pixel pair, whose left picture is BLURRED.",
    FilePath(),
    is_common=True,
)
@output_option(
    "-o --out LENS.toml",
    "Lens file to write, ending in .toml; without it, the lens is only printed.",
    FilePath(),
    is_common=True,
)
@output_option("--overwrite", "Replace an existing lens file.", is_common=True)
@bundle("options", FitOptions, _options)
@reading_options()
@json_option
def command(
    sharp: Path,
    depth: Path,
    blurred: Path,
    right: Path | None,
    out: Path | None,
    overwrite: bool,
    options: FitOptions,
    reading: Reading,
    as_json: bool,
) -> None:
    """Find the lens that blurs SHARP to BLURRED: its focus and its f-number.

    SHARP and BLURRED show the same scene, and DEPTH is its depth. The change of magnification
    from SHARP to BLURRED is found, too, up to 2 %. Pixels that are clipped, or hidden in SHARP, do
    not count.

    Depth of unknown scale and offset, as networks estimate it, is enough: give any --depth-range,
    and give the same one when you render with the lens file. The radii of the blur are then right,
    but distance and f-number are not those of the scene.

    \b
    Examples:
      defocus fit sharp.exr depth.exr blurred.exr -o lens.toml
      defocus fit sharp.png d.png blurred.png --depth-kind disparity --depth-range 1m 20m
      defocus fit sharp.exr depth.exr left.exr --right right.exr --exposure --shift --dual-pixel
    """  # noqa: D301  click reads the backspace
    if right is None and (options.dual_pixel or options.dp_model is not None):
        field = "dual-pixel" if options.dual_pixel else "dp-model"
        problem, remedy = "has no effect without the right picture", "add ‹right› FILE"
        raise UsageProblem("idle-option", problem, remedy, field=field)
    if out is not None:
        if out.suffix != ".toml":
            problem = f"{out} is not a lens file"
            raise UsageProblem("malformed", problem, "let it end in .toml", path="-o")
        require_replaceable(out, overwrite=overwrite)
    views = (blurred,) if right is None else (blurred, right)
    with tile_bar() as progress:
        found = fit_files(PictureFiles(sharp.stem, sharp, depth), views, reading, options, progress)
    if out is not None:
        write_lens(out, found)
    if as_json:
        console.print_json(pairs=[found | {"out": None if out is None else str(out)}])
    else:
        console.stdout(*words(found))

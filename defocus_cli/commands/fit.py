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
        "Focal length of the lens, to find the f-number.",
        LENS_OPTIONS["focal-length"].parse,
        into="foclen",
        default="50mm",
        show_default=True,
    ),
    _fit_option(
        "--sensor-width LENGTH",
        "Width of the sensor area in the pictures.",
        LENS_OPTIONS["sensor-width"].parse,
        default="36mm",
        show_default=True,
    ),
    _fit_option(
        "--exposure",
        "Find also a gain of each colour, and the falloff of light over the frame of each picture.",
    ),
    _fit_option("--shift", "Find also the shift of BLURRED from SHARP, up to 16 px."),
    _fit_option("--dual-pixel", "Find also the crosstalk of the photodiodes of a pair."),
    _fit_option(
        "--dp-model MODEL",
        "Model of the photodiodes, or file of their kernels, as for render.  "
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
    "Right picture of a dual-pixel pair; BLURRED is the left one.",
    FilePath(),
    is_common=True,
)
@output_option("-o --out LENS.toml", "Lens file to write.", FilePath(), is_common=True)
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
    """Find focus and f-number by which SHARP with its DEPTH looks like BLURRED.

    The radius of the blur is affine in 1/depth. So depth of unknown scale and shift is enough: give
    any --depth-range, and use the lens file with the same one. Pixels that are clipped, or that a
    rendering must invent, hardly count. The magnification of BLURRED is found, too.

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

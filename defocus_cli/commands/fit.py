"""``defocus fit``: the lens between a sharp and a blurred picture."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from defocus_cli.options.job import reading_options
from defocus_cli.options.shared import (
    Command,
    FilePath,
    GroupedCommand,
    bundle,
    files_option,
    json_option,
    lens_option,
    option,
    output_option,
    refuse_existing,
)
from defocus_cli.words import console
from defocus_cli.words.batch import tile_bar
from defocus_core.batch import lens_fit
from defocus_core.errors import NotExplained, UsageProblem
from defocus_core.request import quantities
from defocus_core.request.job import Reading
from defocus_core.request.pairing import find_pictures
from defocus_core.request.parameters import LENS_OPTIONS
from defocus_core.request.quantities import QuantityError, length_text

_fit_option = partial(lens_option, is_common=True)
_sensor_option = partial(option, heading="Sensor")

_MAX_BLADES = 99
_OF_PAIRS = ("dual_pixel", "dp_model", "dp_crosstalk", "side_shading")  # attributes of FitOptions


def _blades(text: str) -> tuple[int, ...]:
    """Numbers of blades, as ``0,5,6``."""
    numbers = [part.strip() for part in text.split(",")]
    if not all(n.isdigit() and (int(n) == 0 or 3 <= int(n) <= _MAX_BLADES) for n in numbers):
        raise QuantityError(f"'{text}' names no numbers of blades", "write them like 0,5,6")
    return tuple(dict.fromkeys(map(int, numbers)))


_options = [
    _fit_option(
        "--focal-length LENGTH",
        "Focal length of the lens, for which the f-number is found.",
        LENS_OPTIONS["focal-length"].parse,
        default="50mm",
        show_default=True,
    ),
    _fit_option(
        "--sensor-width LENGTH",
        "Width of the sensor that the pictures show.",
        LENS_OPTIONS["sensor-width"].parse,
        default="36mm",
        show_default=True,
    ),
    _fit_option(
        "--blades N,…",
        "Numbers of blades to choose from; 0 is round. Their rotation is found, too.",
        _blades,
        default="0",
        show_default=True,
    ),
    _fit_option(
        "--focus DISTANCE",
        "The distance in focus, where it is known: it is not sought, and one plane will do.",
        quantities.focus,
    ),
    _fit_option("--fnumber N", "The f-number, where it is known.", LENS_OPTIONS["fnumber"].parse),
    _sensor_option(
        "--dual-pixel",
        "Find how the photodiodes of a pair share the light, too: model, crosstalk, sides.",
    ),
    _sensor_option(
        "--dp-model MODEL",
        "The model of the photodiodes or the file of their kernels, as for render; not sought.",
        LENS_OPTIONS["dp-model"].parse,
    ),
    _sensor_option(
        "--dp-crosstalk 0…0.49",
        "The crosstalk of the photodiodes, where it is known.",
        LENS_OPTIONS["dp-crosstalk"].parse,
    ),
    _sensor_option(
        "--side-shading",
        "Find a factor of light of each side, too, that is a plane over the frame.",
    ),
    _fit_option(
        "--exposure",
        "Find a factor for each colour, too: the pictures differ in exposure, white balance or "
        "falloff.",
    ),
    _fit_option(
        "--gamma",
        "Find the power by which the files are linear light, too: their curve is not known.",
    ),
    _fit_option(
        "--shift",
        "Find by how many px, up to 16, BLURRED lies beside SHARP, and its magnification, too.",
    ),
]


def _fit_options(command: Command) -> Command:
    """Hand a command ``options``: what is known of the lens, and what is sought."""

    def make(focal_length: float, focus: Any, **others: Any) -> lens_fit.FitOptions:
        distance = _distance(focus, focal_length)
        return lens_fit.FitOptions(focal_length, focus=distance, **others)

    return bundle("options", make, _options)(command)


@click.command("fit", cls=GroupedCommand)
@click.argument("sharp", type=FilePath(), metavar="SHARP")
@click.argument("depth", type=FilePath(), metavar="DEPTH")
@click.argument("blurred", type=FilePath(), metavar="BLURRED")
@files_option(
    "--right FILE",
    "The right picture of a dual-pixel pair, of which BLURRED is the left one.",
    FilePath(),
    is_common=True,
)
@output_option(
    "-o --out LENS.toml",
    "Lens file to write; of folders, a directory for <stem>.toml.",
    FilePath(),
    is_common=True,
)
@output_option("--overwrite", "Replace lens files that are there.", is_common=True)
@output_option("--accept", "Take a lens that does not explain the pictures.", is_common=True)
@_fit_options
@reading_options()
@json_option
def command(
    sharp: Path,
    depth: Path,
    blurred: Path,
    right: Path | None,
    out: Path | None,
    overwrite: bool,
    accept: bool,
    options: lens_fit.FitOptions,
    reading: Reading,
    as_json: bool,
) -> None:
    """Find focus and f-number by which SHARP with its DEPTH looks like BLURRED; files or folders.

    The radius of the blur is affine in 1/depth. So depth of unknown scale and shift will do: give
    any --depth-range, and use the lens file with the same one. Pixels that are clipped, or that a
    rendering must invent, hardly count. Errors are standard errors.

    \b
    Examples:
      defocus fit sharp.exr depth.exr blurred.exr -o lens.toml
      defocus fit sharp.png d.png blurred.png --depth-kind disparity --depth-range 1m 20m
      defocus fit sharp depth blurred -o lenses --focal-length 85mm --exposure --blades 0,7
    """  # noqa: D301  click reads the backspace
    _refuse_idle(right, options)
    pairs = lens_fit.pairs_of(find_pictures(sharp, depth), blurred, right)
    places = _places(pairs, out, many=sharp.is_dir(), overwrite=overwrite)
    failures, records = console.Failures(), []
    for pair, place in zip(pairs, places, strict=True):
        record = _fit_one(pair, reading, options, place, failures, accept=accept)
        records += [record] if record else []
        if record and not as_json:
            lines = [f"{pair.picture.color}:", *(f"  {x}" for x in lens_fit.words(record))]
            click.echo("\n".join(lines))
    if as_json and records:
        console.print_json(pairs=records, failed=failures.records())
    failures.end()


def _fit_one(
    pair: lens_fit.Pair,
    reading: Reading,
    options: lens_fit.FitOptions,
    place: Path | None,
    failures: console.Failures,
    *,
    accept: bool,
) -> dict[str, Any] | None:
    """The record of the lens of a picture, which is written unless it explains little."""
    with failures.kept():
        with tile_bar() as progress:
            found = lens_fit.fit_pair(pair, reading, options, progress)
        refusals = [] if accept else found["refusals"]
        if place is not None and not refusals:
            lens_fit.write_lens(place, found)
        for refusal in refusals:
            failures.add(NotExplained(**refusal, path=pair.picture.color))
        return {**found, "out": None if place is None or refusals else str(place)}
    return None


def _distance(focus: float | quantities.Percentile | None, foclen: float) -> float | None:
    """The distance in focus in mm, of an option."""
    if isinstance(focus, quantities.Percentile):
        problem, remedy = "is not a distance", "give it like 2m"
        raise UsageProblem("malformed", problem, remedy, field="focus", value=str(focus))
    if focus is not None and focus <= foclen:
        problem = f"{length_text(focus)} is not beyond the focal length {length_text(foclen)}"
        remedy = "give one that is, or a shorter ‹focal-length›"
        raise UsageProblem("focus-too-near", problem, remedy, field="focus")
    return focus


def _places(
    pairs: list[lens_fit.Pair], out: Path | None, *, many: bool, overwrite: bool
) -> list[Path | None]:
    """Where the lens file of each picture goes; the folder of many is made."""
    places = [out and (out / f"{pair.picture.stem}.toml" if many else out) for pair in pairs]
    for named in filter(None, places):
        if named.suffix != ".toml":
            problem = f"{named} is not a lens file"
            raise UsageProblem("malformed", problem, "let it end in .toml", path="-o")
        refuse_existing(named, overwrite=overwrite)
    if many and out is not None:
        out.mkdir(parents=True, exist_ok=True)
    return places


def _refuse_idle(right: Path | None, options: lens_fit.FitOptions) -> None:
    """Refuse options of a dual-pixel pair without its right picture."""
    for name in _OF_PAIRS if right is None else ():
        if getattr(options, name) not in (None, False):
            problem, field = "has no effect without the right picture", name.replace("_", "-")
            remedy = "add ‹right› FILE, or leave it out"
            raise UsageProblem("idle-option", problem, remedy, field=field)

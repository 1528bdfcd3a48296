"""Options that commands share, bundled: a command receives one object for each group.

``@lens_options`` adds ``--focal-length``, ``--fnumber``, … and hands the command ``lens: Lens``.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from defocus_cli.formats.kinds import KINDS
from defocus_cli.jobs.job import (
    DEPTH_REPAIRS,
    DEPTH_UNITS,
    DEVICES,
    QUALITIES,
    TILES,
    Lens,
    Machine,
    Outputs,
    Reading,
)
from defocus_cli.jobs.lens_file import make_lens
from defocus_cli.jobs.lens_options import PARSERS
from defocus_cli.jobs.quantities import byte_count, pixel_count
from defocus_cli.options.types import FilePath, Format, GroupedOption, Kinds, Quantity
from defocus_cli.system.errors import UsageProblem

Command = Callable[..., Any]
Decorator = Callable[[Command], Command]
# Those of defocus_core, which takes seconds to import.


def cores() -> int:
    """The number of cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def lens_options(*, required: bool) -> Decorator:
    """Hand a command ``lens``: a Lens, or None if none was asked for and none is required."""

    def make(lens_file: Path | None, **values: Any) -> Lens | None:
        flags = {name.replace("_", "-"): value for name, value in values.items()}
        asked = lens_file is not None or any(value is not None for value in flags.values())
        return make_lens(flags, lens_file) if required or asked else None

    return _bundle("lens", make, [*map(_lens_option, _LENS_HELP), _lens_file_option()])


def reading_options(command: Command) -> Command:
    """Hand a command ``reading``: what to take from the input files."""
    option = functools.partial(_option, "Files")
    return _bundle(
        "reading",
        Reading,
        [
            option(
                "--depth-unit",
                type=click.Choice(DEPTH_UNITS),
                help="Unit of the depth.  [default: m; mm in 16-bit PNG]",
            ),
            option("--depth-channel", metavar="NAME", help="Depth channel of an EXR."),
            option("--color-layer", metavar="NAME", help="Colour layer of an EXR."),
            option(
                "--part",
                type=click.IntRange(min=0),
                metavar="N",
                help="Part of an EXR, or page of a TIFF, to look in, from 0.",
            ),
        ],
    )(command)


def hidden_option(command: Command) -> Command:
    """Hand a command ``hidden``: colour and depth behind the visible surface, or None."""
    return _option(
        "Files",
        "--hidden",
        nargs=2,
        type=FilePath(),
        default=None,
        metavar="COLOR DEPTH",
        help="Colour and depth of what lies behind, where it is known: depth inf with colour 0 is "
        "unknown, and invented; inf with colour is sky.",
    )(command)


def output_options(command: Command) -> Command:
    """Hand a command ``outputs``: what to write, and where."""
    option = functools.partial(_option, "Output")
    return _bundle(
        "outputs",
        _outputs,
        [
            option(
                "-o",
                "--out",
                "root",
                type=FilePath(),
                required=True,
                metavar="OUT",
                help="Directory to write to.",
            ),
            option(
                "--outputs",
                "kinds",
                type=Kinds(),
                default="render",
                show_default=True,
                metavar="KIND,…",
                help=f"What to write, of {', '.join(KINDS)}.",
            ),
            option(
                "--format",
                type=Format(),
                default="exr",
                show_default=True,
                help="Type of the images; coc, disparity and trust are always float EXR.",
            ),
            option(
                "--exr-type",
                type=click.Choice(["half", "float"]),
                help=f"Number type of the images' EXR.  [default: {Outputs.exr_type}]",
            ),
            option(
                "--preview",
                is_flag=True,
                help="Also write OUT/<kind>/<stem>.preview.png to look at.",
            ),
            option("--overwrite", is_flag=True, help="Render again and replace what is there."),
        ],
    )(command)


def _outputs(*, exr_type: str | None, **others: Any) -> Outputs:
    outputs = Outputs(**others)
    if exr_type and outputs.format != "exr":
        problem = f"says nothing about {outputs.format}"
        raise UsageProblem("--exr-type", problem, "leave it out, or use --format exr")
    return replace(outputs, exr_type=exr_type or outputs.exr_type)


def machine_options(command: Command) -> Command:
    """Hand a command ``machine``: how to compute."""
    return _bundle("machine", _machine, _computing())(command)


def rendering_options(command: Command) -> Command:
    """Hand a command ``machine``: how to compute pictures of any size, as accurate as wanted."""
    quality, *others = _computing()
    tolerance = machine_option(
        "--tolerance",
        type=Quantity(pixel_count, "PX"),
        metavar="PX",
        help="Instead of --quality: the cheapest whose slices are off by no more than so much CoC "
        "radius, like 1px.",
    )
    depth_repair = machine_option(
        "--depth-repair",
        type=click.Choice(DEPTH_REPAIRS),
        default=Machine.depth_repair,
        show_default=True,
        help="auto repairs depth that is noisy, anti-aliased, soft at edges or of few levels; "
        "off takes it as it is given.",
    )
    options = [quality, tolerance, depth_repair, *others, *memory_options()]
    return _bundle("machine", _machine, options)(command)


def _machine(*, quality: str | None, tolerance: float | None = None, **others: Any) -> Machine:
    if quality is not None and tolerance is not None:
        raise UsageProblem("--tolerance", "stands beside --quality", "keep one of them")
    return Machine(quality=quality or Machine.quality, tolerance=tolerance, **others)


def _computing() -> list[Decorator]:
    return [
        machine_option(
            "--quality",
            type=click.Choice(QUALITIES),
            help="Accuracy, bought with time; a draft is rendered at half of the size, and what is "
            f"in focus gets its detail back.  [default: {Machine.quality}]",
        ),
        machine_option(
            "--device",
            type=click.Choice(DEVICES),
            default="auto",
            show_default=True,
            help="Where to compute; auto takes a GPU if there is one.",
        ),
        machine_option(
            "--threads",
            type=click.IntRange(min=1),
            default=cores,
            metavar="N",
            help="Threads to compute with.  [default: one for each core]",
        ),
    ]


def memory_options() -> list[Decorator]:
    """Bounds of memory, which change no picture by more than the last digits."""
    return [
        machine_option(
            "--memory",
            type=Quantity(byte_count, "SIZE"),
            metavar="SIZE",
            help="Memory a process may take, like 2GB: what is larger goes through scratch files "
            "in TMPDIR.  [default: most of what is free]",
        ),
        machine_option(
            "--tile",
            type=click.IntRange(min=TILES[0], max=TILES[1]),
            metavar="PX",
            help="Side of the tiles to compute in; changes the last digits.",
        ),
    ]


def machine_option(*names: str, **settings: Any) -> Decorator:
    """An option that help shows beside those of `machine_options`."""
    return _option("Machine", *names, **settings)


def check_inputs_option(command: Command) -> Command:
    """Hand a command ``check_inputs``: stat or hash."""
    return machine_option(
        "--check-inputs",
        type=click.Choice(["stat", "hash"]),
        default="stat",
        show_default=True,
        help="How to see that an input of what is done has changed: size and time, or its bytes.",
    )(command)


def json_option(command: Command) -> Command:
    """Hand a command ``as_json``."""
    text = "Print one JSON document on stdout."
    return _option("Options", "--json", "as_json", is_flag=True, help=text)(command)


def verbose_option(command: Command) -> Command:
    """Hand a command ``verbose``."""
    text = "Say more, on stderr."
    return _option("Options", "-v", "--verbose", is_flag=True, help=text)(command)


def stats_option(command: Command) -> Command:
    """Hand a command ``stats``."""
    text = "Say what was computed and what was skipped, on stderr; --json always tells it."
    return _option("Options", "--stats", is_flag=True, help=text)(command)


_LENS_HELP = {
    "focal-length": ("LENGTH", "Focal length, like 50mm."),
    "fnumber": ("N", "F-number, like 1.4."),
    "aperture-diameter": ("LENGTH", "Diameter of the opening; instead of --fnumber."),
    "sensor-width": ("LENGTH", "Width of the sensor.  [default: 36mm]"),
    "focus": (
        "DISTANCE",
        "Distance in focus, like 2m or inf; or percentile(50) of the depth.",
    ),
    "focus-at": ("X,Y", "Focus on what this pixel shows, counted from 0; instead of --focus."),
    "blades": ("N", "Blades of the opening: 0 is round; 3 and more, a polygon in that round."),
    "blade-rotation": (
        "DEG",
        "Where a vertex of the polygon points, counter-clockwise from +x as seen in the image, "
        "for points beyond the focus.",
    ),
}


def _lens_option(name: str) -> Decorator:
    metavar, text = _LENS_HELP[name]
    kind = Quantity(PARSERS[name], metavar)
    return _option("Lens", f"--{name}", type=kind, metavar=metavar, help=text)


def _lens_file_option() -> Decorator:
    text = 'File of lens options, like focal-length = "50mm"; what is given beside it wins.'
    kind = FilePath()
    return _option("Lens", "--lens", "lens_file", type=kind, metavar="FILE.toml", help=text)


def _option(heading: str, *names: str, **settings: Any) -> Decorator:
    return click.option(*names, cls=GroupedOption, heading=heading, **settings)


def _bundle(name: str, make: Callable[..., Any], options: Sequence[Decorator]) -> Decorator:
    """Add ``options`` to a command and hand it what ``make`` makes of their values, as ``name``."""

    def decorate(command: Command) -> Command:
        @functools.wraps(command)
        def call(*args: Any, **params: Any) -> Any:
            values = {key: params.pop(key) for key in keys}
            return command(*args, **{name: make(**values)}, **params)

        optioned: Any = call
        for option in reversed(options):
            optioned = option(optioned)
        keys = [param.name for param in optioned.__click_params__[-len(options) :]]
        return call

    return decorate

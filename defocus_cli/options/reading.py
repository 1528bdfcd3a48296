"""Reading options: what to take from colour and depth files, and what their numbers mean.

``@reading_options`` adds ``--depth-format``, … and hands the command ``reading: Reading``.
"""

from __future__ import annotations

from typing import Any

import click

from defocus_cli.options.types import Command, Decorator, Quantity, bundle, grouped_option
from defocus_core.batch.jobs.job import Reading
from defocus_core.batch.jobs.reading_options import (
    PARSERS,
    far_distance,
    lens_file_reading,
    make_reading,
)
from defocus_core.io.depth_formats.reading import INVALID, KINDS, RESIZES, UNPREMULTIPLY
from defocus_core.io.depth_formats.table import UNITS

_HELP = {
    "depth-format": ("NAME", "Who wrote the depth, like kitti: 'defocus help depth' lists all."),
    "depth-scale": ("FACTOR", "Multiplies the numbers of the depth file, like 1/256."),
    "focal-px": ("PX", "Focal length in px, for disparity and for --radial."),
    "baseline": ("LENGTH", "Distance between the two cameras of disparity, like 65mm."),
    "doffs": ("PX", "Added to disparity: the difference of the two principal points."),
    "fov": ("DEG", "Horizontal field of view, for --radial.  [default: the lens's]"),
    "sky": ("NUMBER", "Numbers of the depth file from this one on are sky; of disparity, to it."),
    "depth-channel": ("NAME", "Depth channel of an EXR, or array of an NPZ or HDF5."),
    "color-layer": ("NAME", "Colour layer of an EXR."),
    "depth-repair": (
        "auto|off|soft-edges=SLOPE",
        "auto repairs depth that is noisy, anti-aliased, soft at edges or of few levels; off takes "
        "it as it is given; soft-edges=0.3 takes slopes of 0.3 px of radius per px and more for "
        "soft edges, whatever is found.  [default: auto]",
    ),
    "edge-width": (
        "PX",
        "Width of the widest soft edges of the depth, like 8px; 0 says that edges are hard.  "
        "[default: as found]",
    ),
    "blur-channels": (
        "NAME,…",
        "Further channels of an EXR that are light, like diffuse.*: blurred with the picture; "
        "the others are copied.",
    ),
    "part": ("N", "Part of an EXR, page of a TIFF or frame of an array, from 0."),
    "view": ("NAME", "View of an EXR of several cameras, like left.  [default: the file's first]"),
}
# What a depth file alone, without a picture and a lens, has no use for.
_OF_PICTURES = (
    *("color-layer", "blur-channels", "resize-depth", "unpremultiply-depth"),
    *("depth-repair", "edge-width"),
)


def reading_options(command: Command) -> Command:
    """Hand a command ``reading``: what to take from the input files, those of a lens file below."""
    return bundle("reading", _make, _options())(command)


def depth_reading_options(command: Command) -> Command:
    """Hand a command ``reading``: what to take from depth files alone."""
    options = [each for name, each in _named() if name not in _OF_PICTURES]
    return bundle("reading", _make, options)(command)


def _make(**fields: Any) -> Reading:
    file = click.get_current_context().params.get("lens_file")
    return make_reading(fields, lens_file_reading(file))


def _options() -> list[Decorator]:
    return [option for _, option in _named()]


def _named() -> list[tuple[str, Decorator]]:
    """Names and options, in the order of help."""
    return [
        ("depth-format", _parsed("depth-format")),
        (
            "depth-unit",
            _choice("depth-unit", UNITS, "Unit of the depth.  [default: m; mm in 16-bit PNG]"),
        ),
        ("depth-scale", _parsed("depth-scale")),
        ("depth-kind", _choice("depth-kind", KINDS, "What the numbers are.  [default: depth]")),
        ("depth-range", _range()),
        *((name, _parsed(name)) for name in ("focal-px", "baseline", "doffs")),
        ("radial", _flag("radial", "The numbers are distances to the point.")),
        ("planar", _flag("planar", "The numbers are depth along the axis.")),
        *((name, _parsed(name)) for name in ("fov", "sky")),
        (
            "invalid",
            _choice(
                "invalid",
                INVALID,
                "Pixels without depth: an error, infinitely far, or filled from the farther "
                "neighbour.  [default: error]",
            ),
        ),
        (
            "resize-depth",
            _choice(
                "resize-depth",
                RESIZES,
                "Take depth of another size than the colour: from the nearest pixel, or with edges "
                "where the colours change.",
            ),
        ),
        ("depth-repair", _parsed("depth-repair")),
        ("edge-width", _parsed("edge-width")),
        *((name, _parsed(name)) for name in ("depth-channel", "color-layer", "blur-channels")),
        ("part", _part()),
        ("view", _parsed("view")),
        (
            "unpremultiply-depth",
            _choice(
                "unpremultiply-depth",
                UNPREMULTIPLY,
                "Divide depth by alpha: on, off, or auto, if pixels of half alpha show that it was "
                "multiplied.  [default: auto]",
            ),
        ),
    ]


def _parsed(name: str) -> Decorator:
    metavar, text = _HELP[name]
    kind = Quantity(PARSERS[name], metavar)
    return grouped_option("Files", f"--{name}", type=kind, metavar=metavar, help=text)


def _choice(name: str, words: Any, text: str) -> Decorator:
    return grouped_option("Files", f"--{name}", type=click.Choice(list(words)), help=text)


def _flag(name: str, text: str) -> Decorator:
    flag = f"--{name}"
    return grouped_option("Files", flag, "geometry", flag_value=name, default=None, help=text)


def _part() -> Decorator:
    metavar, text = _HELP["part"]
    kind = click.IntRange(min=0)
    return grouped_option("Files", "--part", type=kind, metavar=metavar, help=text)


def _range() -> Decorator:
    return grouped_option(
        "Files",
        "--depth-range",
        nargs=2,
        type=Quantity(far_distance, "DISTANCE"),
        default=None,
        metavar="NEAR FAR",
        help="Distances of the ends of the number's type, 0 and 255 or 65535, or 0 and 1: of "
        "depth 0 is NEAR; of disparity 0 is FAR. Swapped, it is the other way round.",
    )

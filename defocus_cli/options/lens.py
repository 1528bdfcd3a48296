"""Lens options: those of ``--lens FILE.toml`` and those given beside it.

``@lens_options`` adds ``--focal-length``, ``--fnumber``, … and hands the command ``lens: Lens``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from defocus_cli.options.types import (
    Decorator,
    FilePath,
    Quantity,
    bundle,
    grouped_option,
    option_name,
)
from defocus_core.batch.jobs.job import Reading
from defocus_core.batch.jobs.lens_options import PARSERS, SHAPES, make_lens
from defocus_core.batch.jobs.reading_options import lens_file_reading
from defocus_core.batch.lenses.lens import Lens
from defocus_core.batch.lenses.shipped_lenses import lens_path

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
    "sharp-range": (
        "A..B",
        "Distances in focus besides, like 1.8m..2.4m: without blur there, unchanged elsewhere.",
    ),
    "cat-eye": (
        "SIZE:DISTANCE",
        "Rim of the barrel that clips the opening off the middle of the picture, like 1.05:1.5: "
        "its radius and its distance before the opening, in radii of the opening.",
    ),
    "axial-color": (
        "RED:BLUE",
        "Axial colour, like 0.1mm:0.1mm: how much farther behind the lens red and blue are in "
        "focus than green. Above 0, rims are green beyond the focus and magenta nearer.",
    ),
    "vignetting": (
        "on|off",
        "Whether corners are darker by the light that the rim takes away.  [default: off]",
    ),
    "blades": ("N", "Blades of the opening: 0 is round; 3 and more, a polygon in that round."),
    "blade-rotation": (
        "DEG",
        "Where a vertex of the polygon points, counter-clockwise from +x as seen in the image, "
        "for points beyond the focus.",
    ),
    "blade-curvature": ("0…1", "Curvature of the blades: 0 is straight, 1 round.  [default: 0]"),
    "obstruction": (
        "0…0.95",
        "Opaque share of the radius in the middle, as a mirror lens has, like 0.4.  [default: 0]",
    ),
    "spherical": (
        "-1…1",
        "Spherical aberration: above 0, bright rings beyond the focus and soft discs nearer; below "
        "0, the reverse.  [default: 0]",
    ),
    "squeeze": (
        "1…4",
        "Squeeze of an anamorphic lens: ovals so many times taller than wide, like 2.  "
        "[default: 1]",
    ),
    "aperture-image": (
        "FILE",
        "Picture of the opening instead of blades, grey or RGB, PNG, EXR or NPY: bright is open, "
        "as a point beyond the focus shows it. NPY of rows x columns of pictures is a field of "
        "kernels over the frame.",
    ),
    "highlights": (
        "auto|T:GAIN",
        "Give clipped lights of pictures of 8 or 16 bits the light they lost: a gain, like 16, "
        "from a threshold in linear light, like 0.93, up to white. Pictures with light above 1 "
        "stay as they are.  [default: off]",
    ),
    "dp-model": (
        "MODEL",
        "Dual pixels: split, each photodiode sees half of the opening; smooth, all of it, less and "
        "less towards the other side, as in real sensors; or an NPY file of two kernels that were "
        "measured, left and right, like pair.npy.  [default: split]",
    ),
    "dp-crosstalk": (
        "0…0.49",
        "Share of its light that each photodiode gives to the other, like 0.15.  [default: 0]",
    ),
    "noise": (
        "ELECTRONS:READ",
        "Noise of the sensor, like 4000:3: electrons that a light of 1 makes, whose number varies, "
        "and electrons of read noise.",
    ),
    "noise-seed": ("N", "Number that decides the random numbers of the noise.  [default: 0]"),
}


def _lens_option(name: str) -> Decorator:
    metavar, text = _LENS_HELP[name]
    kind = Quantity(PARSERS[name], metavar)
    return grouped_option("Lens", f"--{name}", type=kind, metavar=metavar, help=text)


class LensFile(FilePath):
    """The path of a lens file, or @NAME of one that ships."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path of the file."""
        return lens_path(super().convert(value, param, ctx), option_name(param))


def _lens_file_option() -> Decorator:
    text = (
        'File of lens options, like focal-length = "50mm", or @NAME of one that ships '
        "('defocus lenses'); what is given beside it wins."
    )
    kind = LensFile()
    return grouped_option("Lens", "--lens", "lens_file", type=kind, metavar="FILE.toml", help=text)


def lens_options(*, required: bool) -> Decorator:
    """Hand a command ``lens``: a Lens, or None if none was asked for and none is required."""

    def make(lens_file: Path | None, **values: Any) -> Lens | None:
        flags = {name.replace("_", "-"): value for name, value in values.items()}
        said = click.get_current_context().params.get("depth_format")
        depth_format = said or lens_file_reading(lens_file).get("depth_format")
        radii = Reading(depth_format=depth_format).holds_radii
        asked = lens_file is not None or any(value is not None for value in flags.values())
        if not (required or asked):
            return None
        return make_lens(flags, lens_file, radii=radii)

    return bundle("lens", make, lens_decorators())


def lens_decorators() -> list[Decorator]:
    """The options of a lens, and the one of a lens file."""
    return [*map(_lens_option, _LENS_HELP), _lens_file_option()]


def shape_options() -> Decorator:
    """Hand a command ``lens``: the shape of an opening, and no more of a lens."""

    def make(lens_file: Path | None, **values: Any) -> Lens:
        flags = {name.replace("_", "-"): value for name, value in values.items()}
        return make_lens(flags, lens_file, radii=True)

    return bundle("lens", make, [*map(_lens_option, SHAPES), _lens_file_option()])

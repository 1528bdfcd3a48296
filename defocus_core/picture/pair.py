"""Colour and depth of a picture, decoded: of one size, with a depth where there is something."""

from __future__ import annotations

from dataclasses import replace

from defocus_core.batch.jobs.job import Picture, Reading
from defocus_core.errors import InputError
from defocus_core.io.array_files.containers import container_type
from defocus_core.io.arrays import IN_MEMORY, Keeping
from defocus_core.io.depth_formats.depth import Depth, read_depth, require_valid
from defocus_core.io.exr.channel_choice import require_part
from defocus_core.io.exr.header import is_exr
from defocus_core.io.exr.views import require_view
from defocus_core.io.exr.windows import Overscan
from defocus_core.io.images.color import SHARP_INSIDE, read_color, require_finite
from defocus_core.io.images.color_planes import Color
from defocus_core.io.images.describe import describe
from defocus_core.io.safe_files import read_head
from defocus_core.picture.steps.alpha import element_depth
from defocus_core.picture.steps.overscan import overscan_of
from defocus_core.picture.steps.resizing import of_size
from defocus_core.system.log import note


def parts_of(picture: Picture, reading: Reading) -> tuple[int | None, int | None]:
    """The part to read in the colour and in the depth file; None where there is only one."""
    if reading.part is None:
        return None, None
    if container_type(read_head(picture.depth, 32)):  # which has frames
        return reading.part if len(describe(picture.color).parts) > 1 else None, reading.part
    paths = (picture.color, picture.depth)
    color, depth = (len(describe(path).parts) for path in paths)
    if picture.color == picture.depth or max(color, depth) == 1:
        require_part(picture.color, reading.part, color)
    return reading.part if color > 1 else None, reading.part if depth > 1 else None


def read(
    picture: Picture,
    reading: Reading,
    keeping: Keeping = IN_MEMORY,
    lens_focal: float | None = None,
    maximum: Overscan | None = None,
    *,
    whole: bool = False,
) -> tuple[Color, Depth]:
    """Colour and depth of the same size, whose pixels are all valid.

    `maximum`: the most pixels beyond the picture shown that are read; None for no limit.
    """
    shared = picture.color == picture.depth
    if shared and reading.resize_depth is None and not is_exr(read_head(picture.color)):
        reading = replace(reading, resize_depth="guided")  # depth in a photograph is smaller
    parts = parts_of(picture, reading)
    require_view((picture.color, picture.depth), reading.view)
    overscan = overscan_of(picture, reading, parts, whole=whole)
    overscan = overscan if maximum is None else overscan.within(maximum)
    color = read_color(
        picture.color,
        layer=reading.color_layer,
        part=parts[0],
        view=reading.view,
        keeping=keeping,
        overscan=overscan,
        blur_channels=reading.blur_channels,
        original=shared,
    )
    depth = read_depth(
        picture.depth,
        replace(reading, part=parts[1]),
        keeping=keeping,
        size=color.size,
        lens_focal=lens_focal,
        overscan=overscan,
        alpha=color.alpha,
        orientation=color.orientation,
    )
    radial = (reading.geometry or reading.row.geometry) == "radial"
    if radial and color.pixel_aspect != 1:
        problem = "holds distances to the point, and the pixels of the colour are not square"
        raise InputError(
            "not-square", problem, "convert it to depth along the axis", path=picture.depth
        )
    if shared and len(color.channels) == 1 and not color.extras and depth.channel:
        problem = f"has {depth.channel} alone, which is not both colour and depth"
        raise InputError(
            "no-depth", problem, "give the depth file as a second argument", path=picture.color
        )
    depth = element_depth(of_size(depth, color, reading, keeping), color, keeping)
    require_valid(depth)
    require_finite(color)
    if color.note.endswith(SHARP_INSIDE):
        note(f"defocus: {picture.color}: {SHARP_INSIDE} is rendered")
    return color, depth

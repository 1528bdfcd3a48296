"""Overscan of a picture: pixels beyond its display window that take part in the blur.

Colour and depth must both have them. A depth file without windows has them if it is of the size of
the colour's data window and display window together.
"""

from __future__ import annotations

from pathlib import Path

from defocus_core.batch.jobs.job import Picture, Reading
from defocus_core.io.depth_formats.exr_samples import choose_depth_channel
from defocus_core.io.exr.header import is_exr, read_headers
from defocus_core.io.exr.views import in_view
from defocus_core.io.exr.windows import NO_OVERSCAN, Overscan
from defocus_core.io.images.describe import describe
from defocus_core.io.images.exr_channels import NoDepthChannel, choose_color
from defocus_core.io.safe_files import read_head


def overscan_of(
    picture: Picture, reading: Reading, parts: tuple[int | None, int | None] = (None, None)
) -> Overscan:
    """The pixels beyond the display window that colour and depth of a picture both have.

    Args:
        picture: where they are.
        reading: how they are read.
        parts: the part of the colour and of the depth file.

    Raises:
        InputError: a file cannot be read.
    """
    from dataclasses import replace

    color_part, depth_part = parts
    if not is_exr(read_head(picture.color)):
        return NO_OVERSCAN
    headers = in_view(picture.color, read_headers(picture.color), reading.view)
    color = choose_color(picture.color, headers, layer=reading.color_layer, part=color_part).header
    overscan = color.data.beyond(color.display)
    if not any(overscan):
        return NO_OVERSCAN
    if not is_exr(read_head(picture.depth)):
        size = _size(picture.depth)
        return (
            overscan
            if size == overscan.frame(color.display.width, color.display.height)
            else NO_OVERSCAN
        )
    headers = in_view(picture.depth, read_headers(picture.depth), reading.view)
    deeper = replace(reading, part=depth_part)
    try:
        depth = choose_depth_channel(picture.depth, headers, deeper).header
    except NoDepthChannel:  # a plate needs none; of others who reads it says it
        return overscan
    return overscan.within(depth.data.beyond(depth.display))


def _size(path: Path) -> tuple[int, int]:
    """(height, width) of a file without windows."""
    info = describe(path)
    return info.height, info.width

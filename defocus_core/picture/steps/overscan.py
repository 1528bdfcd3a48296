"""Overscan of a picture: pixels beyond its display window that take part in the blur.

Colour and depth must both have them. A depth file without windows has them if it is of the size of
the colour's data window and display window together.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from defocus_core.io.depth_formats.exr_depth_channel import NoDepthChannel, choose_depth_channel
from defocus_core.io.exr.channel_choice import choose_color
from defocus_core.io.exr.header import is_exr, read_headers
from defocus_core.io.exr.views import in_view
from defocus_core.io.exr.windows import NO_OVERSCAN, Layout, Overscan, Window
from defocus_core.io.images.color import Color
from defocus_core.io.images.describe import describe
from defocus_core.io.safe_files import read_head
from defocus_core.picture.pair import InputPair, parts_of
from defocus_core.picture.write import Contents, window_of


def window(wanted: InputPair) -> InputPair:
    """The picture with the pixels beyond the one shown that it is read with."""
    overscan = overscan_of(wanted)
    return replace(wanted, overscan=overscan.within(wanted.limit or overscan))


def write(contents: Contents) -> Contents:
    """The planes without overscan, or with the display window in it."""
    color, outputs = contents.take.inputs.color, contents.take.job.outputs
    if contents.kind.source == "focus":
        return contents
    if not outputs.keep_overscan:
        return contents.mapped(partial(shown, color))
    (x, y), (width, height), overscan = color.corner, color.size, color.overscan
    display = Window(x, y, x + width - 1, y + height - 1)
    corner = (x - overscan.left, y - overscan.top)
    return contents._replace(layout=Layout(corner, display, contents.layout.views))


def shown(color: Color, plane: Any) -> Any:
    """An array [H, W] without the pixels beyond the picture shown."""
    return window_of(plane, *color.overscan.shown(*color.shape[:2]))


def overscan_of(wanted: InputPair) -> Overscan:
    """The pixels beyond the display window that colour and depth of a picture both have."""
    picture, reading, whole = wanted.picture, wanted.reading, wanted.whole
    color_part, depth_part = parts_of(picture, reading)
    if not is_exr(read_head(picture.color)):
        return NO_OVERSCAN
    headers = in_view(picture.color, read_headers(picture.color), reading.view)
    color = choose_color(picture.color, headers, layer=reading.color_layer, part=color_part).header
    overscan = color.data.beyond(color.display, whole=whole)
    if not any(overscan):
        return NO_OVERSCAN
    if not is_exr(read_head(picture.depth)):
        info, frame = describe(picture.depth), (color.display.width, color.display.height)
        return overscan if (info.height, info.width) == overscan.frame(*frame) else NO_OVERSCAN
    headers = in_view(picture.depth, read_headers(picture.depth), reading.view)
    deeper = replace(reading, part=depth_part)
    try:
        depth = choose_depth_channel(picture.depth, headers, deeper).header
    except NoDepthChannel:  # a plate needs none; of others who reads it says it
        return overscan
    return overscan.within(depth.data.beyond(depth.display, whole=whole))


def reframe(array: Any, held: Overscan, wanted: Overscan, nothing: float | None) -> Any:
    """An array [H, W] with another overscan than its own.

    `nothing`: what is where the array has no pixels; None for those at its edge, repeated.
    """
    if held == wanted:
        return array
    kept = held.within(wanted)
    cut, more = (
        Overscan(*(px - common for px, common in zip(each, kept, strict=True)))
        for each in (held, wanted)
    )
    rows, columns = cut.shown(*array.shape)
    values, pads = array[rows][:, columns], ((more.top, more.bottom), (more.left, more.right))
    if nothing is None:
        return np.pad(values, pads, mode="edge")
    return np.pad(values, pads, constant_values=array.dtype.type(nothing))

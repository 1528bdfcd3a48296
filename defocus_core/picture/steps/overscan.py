"""Overscan of a picture: pixels beyond its display window that take part in the blur."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from defocus_core.io.exr.windows import Layout, Window
from defocus_core.io.images.color import Color
from defocus_core.picture.pair import InputPair, overscan_of
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

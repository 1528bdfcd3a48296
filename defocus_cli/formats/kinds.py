"""Kinds of output, one row each, and the types of image files.

A kind is written to ``OUT/<name>/<stem>.<ext>``. An image has the channels of the colour file and
the type that ``--format`` names. A map is a float32 EXR of one channel, which has the kind's name.

A new kind is a new row: the other modules read this table.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

# Bytes of a pixel of a map, in a compressed EXR file of a picture that is neither flat nor noise.
_MAP_BYTES = 2.4
DISPARITY_PER_RADIUS = 8 / (3 * math.pi)  # distance of the centroids of two half discs


@dataclass(frozen=True)
class Kind:
    """A kind of output.

    Attributes:
        name: as ``--outputs`` has it.
        help: a line for ``defocus render --help``.
        compute: its pixels. Of a rendered kind, from the `defocus_core.Views` of a region
            [..., h, w] to [..., C, h, w], C = 1 of a map; else from signed radii [h, w] in px to
            [h, w].
        image: whether it is an image; else it is a map.
        rendered: whether it needs the rendered views; else the signed radii are enough.
        halves: whether it needs the views through the left and the right half of the lens.
        signed_preview: whether its preview is orange below 0, white at 0 and blue above 0; else
            the preview shows its values as linear light.
        title: what a map shows, for ``defocus info``.
        unit: the unit of a map's values, empty for a number without one.
        file_bytes: of a pixel of a map, in its file; of an image, its format says so.
    """

    name: str
    help: str
    compute: Callable[[Any], Any]
    image: bool = False
    rendered: bool = False
    halves: bool = False
    signed_preview: bool = False
    title: str = ""
    unit: str = ""
    file_bytes: float = _MAP_BYTES

    def memory_bytes(self, channels: int, sample_bytes: int) -> int:
        """Bytes that a pixel takes in memory before it is written.

        Args:
            channels: of an image.
            sample_bytes: of a channel of an image.
        """
        if not self.rendered:  # computed from the radii while it is written
            return 0
        return channels * sample_bytes if self.image else 4


_ROWS = (
    Kind(
        name="render",
        help="the defocused picture",
        compute=lambda views: views.render,
        image=True,
        rendered=True,
    ),
    Kind(
        name="left",
        help="what the left half of the lens sees (dual pixel)",
        compute=lambda views: views.left,
        image=True,
        rendered=True,
        halves=True,
    ),
    Kind(
        name="right",
        help="what the right half of the lens sees",
        compute=lambda views: views.right,
        image=True,
        rendered=True,
        halves=True,
    ),
    Kind(
        name="coc",
        help="signed radius of the circle of confusion in px, beyond the focus positive",
        compute=lambda radius: radius,
        signed_preview=True,
        title="CoC map (signed radius, negative nearer than the focus)",
        unit="px",
    ),
    Kind(
        name="disparity",
        help="dual-pixel disparity in px, signed alike",
        compute=lambda radius: radius * DISPARITY_PER_RADIUS,
        signed_preview=True,
        title="disparity map (between left and right, signed like the CoC)",
        unit="px",
    ),
    Kind(
        name="trust",
        help="share of the lens that saw what the picture holds: 1 is nothing invented",
        compute=lambda views: views.trust,
        rendered=True,
        title="trust map (share of the lens that saw what the picture holds)",
    ),
)
KINDS = {kind.name: kind for kind in _ROWS}
MAPS = tuple(kind.name for kind in _ROWS if not kind.image)

PREVIEW = ".preview"  # follows the name of a kind where a preview of it is meant

# Types of image files, and the suffix of each.
SUFFIXES = {"exr": ".exr", "png": ".png", "png16": ".png", "tiff": ".tif", "jpg": ".jpg"}
FORMAT_ALIASES = {"jpeg": "jpg", "tif": "tiff"}

"""OpenEXR pixels, in: arrays of the frame in the file's types, half, float and uint.

The frame is the display window with the wanted overscan. Pixels outside the data window are 0.
OpenImageIO decodes a strip of rows at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import first_line
from defocus_core.io.exr.header import DTYPES, Header, read_headers
from defocus_core.io.exr.windows import NO_OVERSCAN, Overscan, Window
from defocus_core.io.read_files import damaged, decoded_rows, decoding, opened_image, quiet

STRIP = 1 << 23  # bytes of pixels that are decoded at once
_ROWS = 32  # greatest number of rows in a chunk of most codecs; strips are multiples of it


@dataclass(frozen=True)
class ExrPart:
    """One decoded part of an EXR file."""

    header: Header
    # Arrays [H, W] of the frame by name, in the file's types; of a deep part those of the picture
    # in focus, with light as float32
    channels: dict[str, Any]


def read_parts(
    path: Path,
    headers: tuple[Header, ...] | None = None,
    wanted: Callable[[Header, str], bool] = lambda header, name: True,
    overscan: Overscan = NO_OVERSCAN,
) -> tuple[ExrPart, ...]:
    """All parts of an EXR file, decoded.

    Args:
        path: The file.
        headers: Headers of its parts; None to read them.
        wanted: Whether a channel, given the header of its part and its name, is decoded.
        overscan: The pixels beyond the display window to read.
    """
    headers = read_headers(path) if headers is None else headers
    is_flat = not all(header.deep for header in headers)
    opening = opened_image(path, partial(damaged, path)) if is_flat else nullcontext()
    with decoding(path), quiet(), opening as file:
        return tuple(_part(path, file, header, wanted, overscan) for header in headers)


def _part(
    path: Path, file: Any, header: Header, wanted: Callable[[Header, str], bool], overscan: Overscan
) -> ExrPart:
    types = {
        channel.name: channel.type for channel in header.channels if wanted(header, channel.name)
    }
    if header.deep:
        from defocus_core.io.exr.deep_layers import flat_channels

        flat = flat_channels(path, header, types, overscan) if types else {}
        return ExrPart(header, flat)
    frame = header.display.grown(overscan)
    size = (frame.height, frame.width)
    channels = {name: np.zeros(size, DTYPES[kind]) for name, kind in types.items()}
    if not types:
        return ExrPart(header, channels)
    if not file.seek_subimage(header.index, 0):
        raise damaged(path, first_line(path, file.geterror()))
    spec, (x0, y0, x1, y1) = file.spec(), header.data
    if (spec.x, spec.y, spec.width, spec.height) != (x0, y0, header.data.width, header.data.height):
        raise damaged(path, "two sizes in its header")
    high = spec.tile_height or _ROWS
    high *= max(1, STRIP // (spec.width * high * header.pixel_bytes))
    for top in range(y0, y1 + 1, high):
        window = Window(x0, top, x1, min(top + high - 1, y1))
        for name, pixels in _decode(path, file, header.index, window, types).items():
            frame.paste(channels[name], pixels, window)
    return ExrPart(header, channels)


def _decode(
    path: Path, file: Any, part: int, window: Window, types: Mapping[str, str]
) -> dict[str, NDArray[Any]]:
    """The channels [h, w] of full rows of the data window, by name.

    Channels of one type are read together, as OpenImageIO converts mixed types. `types`: type of
    each channel by name.
    """
    names = file.spec().channelnames
    if not types.keys() <= set(names):
        raise damaged(path, "two lists of channels")
    piece: dict[str, NDArray[Any]] = {}
    for kind in set(types.values()):
        places = {name: names.index(name) for name in types if types[name] == kind}
        span = min(places.values()), max(places.values()) + 1
        rows = window.y0, window.y1 + 1
        pixels = decoded_rows(path, file, part, rows, span, kind)
        piece |= {name: pixels[:, :, place - span[0]] for name, place in places.items()}
    return piece

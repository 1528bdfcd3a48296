"""Colour of EXR files: a layer, its alpha, passes that are light, and channels that are carried."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.arrays import Keeping, bands
from defocus_core.io.exr.channel_choice import ChannelGroup, choose_color, light_passes
from defocus_core.io.exr.chroma import rgb_of, weights_of
from defocus_core.io.exr.header import Header, Raw, read_headers
from defocus_core.io.exr.reading import ExrPart, read_parts
from defocus_core.io.exr.views import default_warning, in_view
from defocus_core.io.exr.windows import Overscan, Window
from defocus_core.io.images.color_planes import Color
from defocus_core.io.images.primaries import (
    REC_709,
    declared_primaries,
    primaries_name,
    same_primaries,
)

_NEARLY_SQUARE = 1e-3  # difference of the sides of a pixel as a share of one
_THUMBNAIL = "preview"  # attribute of an EXR header


def read_exr_color(
    path: Path,
    *,
    layer: str | None,
    part: int | None,
    view: str | None,
    blur_channels: Sequence[str],
    keeping: Keeping,
    overscan: Overscan,
    carried: bool,
) -> Color:
    """Decode the colour of an EXR file; the arguments are those of `read_color`."""
    every = read_headers(path)
    headers = in_view(path, every, view)
    chosen = choose_color(path, headers, layer=layer, part=part)
    own = (chosen.header.index, *chosen.channels.values())

    def wanted(header: Header, name: str) -> bool:
        return carried or (header.index == own[0] and name in own[1:])

    parts = read_parts(path, headers, keeping, wanted, overscan)
    channels, planes = _planes(path, parts[chosen.header.index], chosen, keeping, overscan)
    extras, left_out = _extras(parts, chosen) if carried else ({}, ())
    passes = light_passes(path, extras, blur_channels)
    planes += [extras.pop(name) for name in passes]
    attributes = {k: v for k, v in chosen.header.attributes.items() if k != _THUMBNAIL}
    if chosen.header.shown:
        attributes["view"] = Raw("string", chosen.header.shown.encode())
    return Color(
        planes=_one_type(planes, keeping),
        channels=channels,
        path=path,
        passes=passes,
        attributes=attributes,
        extras=extras,
        pixel_aspect=_aspect(chosen.header),
        corner=(chosen.header.display.x0, chosen.header.display.y0),
        data=reduce(Window.united, (header.data for header in headers)),
        overscan=overscan,
        note=_exr_note(chosen, overscan),
        warnings=tuple(filter(None, [default_warning(every, view)])),
        left_out=left_out,
        compression=chosen.header.compression,
    )


def _planes(
    path: Path, part: ExrPart, chosen: ChannelGroup, keeping: Keeping, overscan: Overscan
) -> tuple[tuple[str, ...], list[Any]]:
    """The names and arrays of a colour layer; alpha is added where a part has pixels of the frame.

    A picture that is smaller than its frame is an element, with nothing around it.
    """
    header, names = chosen.header, tuple(chosen.channels)
    planes = [part.channels[name] for name in chosen.channels.values()]
    if "RY" in names:
        planes[:3] = rgb_of(planes[0], planes[1:3], weights_of(header, path))
        names = ("R", "G", "B", *names[3:])
    frame = header.display.grown(overscan)
    if "A" in names or header.data.covers(frame):
        return names, planes
    alpha = keeping.new((frame.height, frame.width), planes[0].dtype)
    rows, columns = frame.cut(header.data)
    alpha[rows, columns] = np.ones((rows.stop - rows.start, columns.stop - columns.start), "f2")
    return (*names, "A"), [*planes, alpha]


def _aspect(header: Header) -> float:
    """Width of a pixel by its height, 1 if it is nearly square."""
    aspect = header.pixel_aspect
    return 1.0 if abs(aspect - 1) <= _NEARLY_SQUARE else aspect


def _exr_note(chosen: ChannelGroup, overscan: Overscan) -> str:
    header, names = chosen.header, chosen.channels.values()
    kinds = {channel.type for channel in header.channels if channel.name in names}
    thumbnail = "its thumbnail, which is sharp, left out" * (_THUMBNAIL in header.attributes)
    view = f"view {header.shown}" if header.shown else ""
    chroma = "luminance and chroma" if "RY" in chosen.channels else ""
    kind = f"EXR {' and '.join(sorted(kinds))}, linear"
    declared = declared_primaries(header.attributes)
    primaries = "" if same_primaries(declared, REC_709) else f"primaries {primaries_name(declared)}"
    aspect = _aspect(header)
    pixels = "" if aspect == 1 else f"pixels {aspect:g} times as wide as high"
    return ", ".join(
        filter(None, (kind, primaries, view, chroma, pixels, header.cut_note(overscan), thumbnail))
    )


def _one_type(planes: Sequence[Any], keeping: Keeping) -> tuple[Any, ...]:
    """Channels of one type: half if all are half, else float32."""
    if all(plane.dtype == np.float16 for plane in planes):
        return tuple(planes)
    floats = []
    for plane in planes:
        if plane.dtype != np.float32:
            native, plane = plane, keeping.new(plane.shape, np.float32)
            for rows in bands(plane.shape):
                plane[rows] = native[rows]
        floats.append(plane)
    return tuple(floats)


def _extras(
    parts: Sequence[ExrPart], chosen: ChannelGroup
) -> tuple[dict[str, NDArray[Any]], tuple[str, ...]]:
    """Channels beside the chosen layer, and in words the parts that the output cannot carry.

    A channel is called PART.NAME where its plain name is taken.
    """
    size = (chosen.header.display.width, chosen.header.display.height)
    extras: dict[str, NDArray[Any]] = {}
    left_out = []
    for part in sorted(parts, key=lambda p: p.header.index != chosen.header.index):
        display = part.header.display
        plain = {channel.name: channel.plain for channel in part.header.channels}
        if not plain:  # of another view
            continue
        lost = [name for name in plain if name not in part.channels]
        if lost:
            left_out.append(f"{', '.join(lost)}, with fewer samples than pixels, left out")
        is_of_color = part.header.index == chosen.header.index
        if (part.header.deep and not is_of_color) or (display.width, display.height) != size:
            why = "which is deep" if part.header.deep else "which is of another size"
            left_out.append(f"part {part.header.label}, {why}, left out")
            continue
        for name, plane in part.channels.items():
            if is_of_color and name in chosen.channels.values():
                continue
            own = plain[name]
            taken = own in extras or own in chosen.channels
            extras[f"{part.header.label}.{own}" if taken else own] = plane
    return extras, tuple(left_out)

"""OpenEXR pixels, out: one scan-line part, the same bytes for the same arrays.

The codec is ZIP unless another is named, as readers notice damage to ZIP. No date is written.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.exr.header import (
    STRUCTURAL,
    Codec,
    Raw,
    codec_of,
    header_bytes,
    read_attributes,
)
from defocus_core.io.exr.windows import Layout, Window
from defocus_core.io.read_files import quiet
from defocus_core.io.write_files import written_whole
from defocus_core.system.process import delayed_signals
from defocus_core.system.text import counted


def write_exr(
    path: Path,
    channels: Mapping[str, Any],
    attributes: Mapping[str, object],
    layout: Layout = Layout(),  # noqa: B008 - a constant
    compression: str = "zip",
) -> None:
    """Write a file of one part, with the pixel types of the arrays.

    OpenEXR encodes the chunks of pixels; its header is replaced by one with the wanted attributes.

    Args:
        path: The file.
        channels: float16, float32 or uint32 arrays [H, W] by name.
        attributes: By name; structural ones, and tags and profiles of photographs, are left out.
        layout: Position of the pixels, display window and views.
        compression: Name of the codec, as `codec_of` takes it.
    """
    own = {name: value for name, value in attributes.items() if name not in STRUCTURAL}
    carried = {name: value for name, value in own.items() if isinstance(value, Raw)}
    codec, level = codec_of(compression)
    plain = {name: value for name, value in own.items() if not isinstance(value, tuple)} | level
    height, width = next(iter(channels.values())).shape
    x, y = layout.corner
    whole = Window(x, y, x + width - 1, y + height - 1)
    windows = {
        name: Raw("box2i", struct.pack("<4i", *window))
        for name, window in (("dataWindow", whole), ("displayWindow", layout.display or whole))
    }
    if layout.views:
        texts = (struct.pack("<i", len(view)) + view.encode() for view in layout.views)
        carried["multiView"] = Raw("stringvector", b"".join(texts))
    corners = np.array(whole[:2], np.int32), np.array(whole[2:], np.int32)
    plain["dataWindow"] = corners  # chunks number their rows from it
    encoded = _encoded({n: np.ascontiguousarray(a) for n, a in channels.items()}, plain, codec)
    encoded.seek(8)
    header = header_bytes(read_attributes(encoded) | carried | windows)
    offsets = np.frombuffer(encoded.read(8 * -(-height // codec.rows)), "<i8")
    moved = len(header) + offsets.nbytes - encoded.tell()
    with written_whole(path) as file:
        file.write(header + (offsets + moved).tobytes())
        file.write(encoded.getbuffer()[encoded.tell() :])


def write_exr_image(
    path: Path,
    colors: Mapping[str, Any],
    exr_type: str,
    attributes: Mapping[str, object],
    extras: Mapping[str, Any] = MappingProxyType({}),
    layout: Layout = Layout(),  # noqa: B008 - a constant
    compression: str = "zip",
    clamped: int = 0,
) -> list[str]:
    """Write colours and extras [H, W] by name; returns a warning if colours were clamped to half.

    Args:
        path: The file.
        colors: Arrays of colours and alpha.
        exr_type: Type of the colours in the file, "half" or "float".
        attributes: As for `write_exr`.
        extras: Further arrays, which keep their types.
        layout: As for `write_exr`.
        compression: As for `write_exr`.
        clamped: Number of pixels of half colours that the caller has clamped.

    Returns:
        A list of one warning in words, or an empty list.
    """
    if exr_type == "half" and any(plane.dtype == "f4" for plane in colors.values()):
        beyond = [clamped_half(plane)[1] for plane in colors.values()]
        clamped = int(np.count_nonzero(np.logical_or.reduce(beyond)))
        colors = {name: as_half(plane) for name, plane in colors.items()}
    write_exr(path, {**extras, **colors}, attributes, layout, compression)
    warning = f"{counted(clamped, 'pixel')} beyond ±65504 clamped to half; float keeps them"
    return [warning] if clamped else []


def _encoded(
    channels: Mapping[str, NDArray[Any]], attributes: Mapping[str, object], codec: Codec
) -> io.BytesIO:
    """The file that OpenEXR encodes from channels and attributes; these have no `Raw` values."""
    with delayed_signals():
        import OpenEXR

    kind = {"compression": OpenEXR.Compression(codec.number), "type": OpenEXR.scanlineimage}
    encoded = io.BytesIO()
    with quiet():
        OpenEXR.File({**attributes, **kind}, channels).write(encoded)
    return encoded


def clamped_half(values: NDArray[np.float32]) -> tuple[NDArray[np.float16], NDArray[np.bool_]]:
    """``values`` as half, clamped to ±65504, and the mask of the clamped ones; NaN stays NaN."""
    largest = np.float32(np.finfo(np.float16).max)
    if not values.size or max(float(values.max()), -float(values.min())) <= largest:
        return values.astype(np.float16), np.zeros(values.shape, bool)
    return np.clip(values, -largest, largest).astype(np.float16), np.abs(values) > largest  # or NaN


def as_half(plane: Any) -> Any:
    """An array [H, W] as half, clamped to ±65504; the array itself if it already is half."""
    return plane if plane.dtype == np.float16 else clamped_half(plane)[0]

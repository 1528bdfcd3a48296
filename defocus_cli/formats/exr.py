"""OpenEXR pixels, in and out: native half, float and uint arrays, cropped to the display window.

Pixels outside the data window are 0. Output is one scan-line part, ZIP compressed (the codec whose
corruption is noticed on reading), without dates: the same arrays make the same bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from defocus_cli.formats.exr_header import STRUCTURAL, Header, Raw, Window, read_headers
from defocus_cli.formats.exr_text import legible
from defocus_cli.system.arrays import IN_MEMORY, Keeping
from defocus_cli.system.errors import InputError, reason
from defocus_cli.system.safe_files import quiet, written_whole

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

DAMAGED = ("is truncated or damaged", "write or copy it again")
NO_PIECES = (
    "is too large to be held in --memory, and its pixels cannot be had piece by piece",
    "allow more --memory, or save it in scan lines, ZIP compressed",
)
_STRIP_BYTES = 1 << 25  # of pixels, encoded at once
_LARGEST_TILE = 1 << 26  # bytes, decoded at once
_DTYPES = {"uint": "uint32", "half": "float16", "float": "float32"}


@dataclass(frozen=True)
class Part:
    """One decoded part of an EXR file.

    Attributes:
        header: what its header says.
        channels: name to native array [H, W] of the display window, in memory or in a scratch
            file; empty for a deep part. Subsampled channels are left out.
    """

    header: Header
    channels: dict[str, Any]


def read_parts(
    path: Path,
    headers: tuple[Header, ...] | None = None,
    keeping: Keeping = IN_MEMORY,
    wanted: Callable[[Header, str], bool] = lambda header, name: True,
) -> tuple[Part, ...]:
    """All parts of an EXR file, decoded.

    Args:
        path: the file.
        headers: what `read_headers` said, if it has been asked already.
        keeping: where the channels are to be kept; for scratch files, they are decoded in pieces.
        wanted: whether a channel of a part is; others may be left out.

    Raises:
        InputError: the file cannot be read, or not all of it.
    """
    import OpenEXR

    headers = read_headers(path) if headers is None else headers
    try:
        with quiet():
            if keeping.scratch:
                return tuple(_in_pieces(path, headers, keeping, wanted))
            decoded = OpenEXR.File(legible(path), separate_channels=True).parts
            # OpenEXR leaves out a part that it failed to decode, with no more than a print.
            if len(decoded) != len(headers):
                raise InputError(path, *DAMAGED)
            return tuple(_part(path, *pair) for pair in zip(headers, decoded, strict=True))
    except InputError:
        raise
    except Exception as error:
        # OpenEXR raises half a dozen types, and calls truncation "file has 0 parts".
        raise InputError(path, f"{DAMAGED[0]} ({reason(error)})", DAMAGED[1]) from error


def _part(path: Path, header: Header, decoded: Any) -> Part:
    """``decoded`` as a Part, checked against the header that was read before."""
    if header.deep:
        return Part(header, {})
    flat = [channel for channel in header.channels if not channel.subsampled]
    channels = {}
    for channel in flat:
        pixels = decoded.channels[channel.name].pixels
        shape = (header.data.height, header.data.width)
        if pixels is None or pixels.shape != shape or pixels.dtype != _DTYPES[channel.type]:
            raise InputError(path, *DAMAGED)
        channels[channel.name] = _crop(pixels, header.data, header.display)
    return Part(header, channels)


def _in_pieces(
    path: Path,
    headers: tuple[Header, ...],
    keeping: Keeping,
    wanted: Callable[[Header, str], bool],
) -> Iterator[Part]:
    """The parts, some rows or tiles of each at a time in memory."""
    from defocus_cli.formats.exr_strips import pieces, read_chunks

    for header, chunks in zip(headers, read_chunks(path), strict=True):
        channels: dict[str, Any] = {}
        flat = [c for c in header.channels if not c.subsampled and wanted(header, c.name)]
        if header.deep:
            flat = []
        pixel_bytes = 4 * len(header.channels)
        if flat and (
            chunks is None or (chunks.tiled and chunks.pixels * pixel_bytes > _LARGEST_TILE)
        ):
            raise InputError(path, *NO_PIECES)
        size = (header.display.height, header.display.width)
        for channel in flat:
            channels[channel.name] = keeping.new(size, _DTYPES[channel.type])
        if flat and chunks is not None:
            for data, found in pieces(path, chunks, pixel_bytes):
                for channel in flat:
                    pixels = found.get(channel.name)
                    if pixels is None or pixels.dtype != _DTYPES[channel.type]:
                        raise InputError(path, *DAMAGED)
                    if pixels.shape != (data.height, data.width):
                        raise InputError(path, *DAMAGED)
                    _put(channels[channel.name], pixels, data, header.display)
        yield Part(header, channels)


def _put(whole: Any, pixels: NDArray[Any], data: Window, display: Window) -> None:
    """Put what fills the data window where it lies in the display window."""
    x0, x1 = max(data.x0, display.x0), min(data.x1, display.x1) + 1
    y0, y1 = max(data.y0, display.y0), min(data.y1, display.y1) + 1
    if x0 < x1 and y0 < y1:
        seen = pixels[y0 - data.y0 : y1 - data.y0, x0 - data.x0 : x1 - data.x0]
        whole[y0 - display.y0 : y1 - display.y0, x0 - display.x0 : x1 - display.x0] = seen


def _crop(pixels: NDArray[Any], data: Window, display: Window) -> NDArray[Any]:
    """The display window of ``pixels``, which fill the data window; 0 where they do not reach."""
    import numpy as np

    if data == display:
        return pixels
    cropped = np.zeros((display.height, display.width), pixels.dtype)
    _put(cropped, pixels, data, display)
    return cropped


def write_exr(
    path: Path,
    channels: Mapping[str, Any],
    attributes: Mapping[str, object],
    corner: tuple[int, int] = (0, 0),
) -> None:
    """Write one part whose pixel types are those of the arrays.

    Args:
        path: written whole or not at all.
        channels: name to float16, float32 or uint32 array [H, W], of which some rows are looked at
            at a time.
        attributes: header metadata, `Raw` or as OpenEXR takes it; `STRUCTURAL` names are ignored.
        corner: x and y of the first pixel of both windows.

    Raises:
        InputError: the file cannot be written.
    """
    import numpy as np
    import OpenEXR

    from defocus_cli.formats.exr_strips import ZIP_ROWS, write_strips

    given = {name: value for name, value in attributes.items() if name not in STRUCTURAL}
    carried = {name: value for name, value in given.items() if isinstance(value, Raw)}
    header = {name: value for name, value in given.items() if name not in carried}
    header |= {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    height, width = next(iter(channels.values())).shape
    row_bytes = width * sum(array.dtype.itemsize for array in channels.values())
    each = max(1, _STRIP_BYTES // row_bytes // ZIP_ROWS) * ZIP_ROWS
    parts = (
        {name: np.ascontiguousarray(array[y : y + each]) for name, array in channels.items()}
        for y in range(0, height, each)
    )
    with written_whole(path) as file, quiet():
        x, y = corner
        window = Window(x, y, x + width - 1, y + height - 1)
        write_strips(file, header, carried, window, parts)


def clamped_half(values: NDArray[np.float32]) -> tuple[NDArray[np.float16], NDArray[np.bool_]]:
    """``values`` as half, clamped to the largest finite half ±65504, and where that was needed.

    NaN stays NaN and is not counted.
    """
    import numpy as np
    import torch

    largest = np.float32(np.finfo(np.float16).max)
    found = torch.from_numpy(np.require(values, requirements="W"))
    if not found.numel() or max(float(found.amax()), -float(found.amin())) <= largest:
        beyond = np.zeros(values.shape, bool)
    else:  # or NaN
        beyond = np.abs(values) > largest
        found = found.clamp(-float(largest), float(largest))
    return found.half().numpy(), beyond  # ten times as fast as NumPy

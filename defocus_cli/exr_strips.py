"""Strips of OpenEXR files: some rows decoded or encoded at a time, by OpenEXR itself.

The pixels of a scan-line file lie in chunks of some rows, each compressed by itself and found
through a table of offsets. So some chunks under a header that claims only their rows are a whole
file, small enough for memory; and the chunks of such files, under one header, are the file that
OpenEXR would have written at once, byte for byte. Layout: openexr.com, "OpenEXR File Layout".
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO

from defocus_cli.exr_header import MAGIC, Window, attributes_of

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

# Rows of a chunk, by the number of the compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A,
# DWAA, DWAB.
_CHUNK_ROWS = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256)
ZIP_ROWS = 16
_STRIP_BYTES = 1 << 25  # decoded
_TILED, _LONG_NAMES, _DEEP, _MULTIPART = 0x200, 0x400, 0x800, 0x1000
_MOST_CHUNKS = 1 << 24

Attributes = list[tuple[str, str, bytes]]


@dataclass(frozen=True)
class Chunks:
    """Where the rows of one part are.

    Attributes:
        attributes: of its header.
        version: of its file, the flags included.
        top: first row of the data window.
        rows: of the data window.
        each: rows of a chunk.
        offsets: of the chunks, from the top.
    """

    attributes: Attributes
    version: int
    top: int
    rows: int
    each: int
    offsets: tuple[int, ...]


def read_chunks(path: Path) -> tuple[Chunks | None, ...]:
    """Where the rows of each part are; None for a part whose rows cannot be had in strips.

    Raises:
        ValueError: the file is damaged.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        magic, version = struct.unpack("<4sI", file.read(8))
        if magic != MAGIC:
            raise ValueError("not an OpenEXR file")
        multipart = bool(version & _MULTIPART)
        headers = []
        while attributes := attributes_of(file):
            headers.append(attributes)
            if not multipart:
                break
        return tuple(_chunks(file, attributes, version) for attributes in headers)


def _chunks(file: BinaryIO, attributes: Attributes, version: int) -> Chunks | None:
    """The table of offsets of a part, which comes next in the file."""
    values = {name: value for name, _, value in attributes}
    _, top, _, bottom = struct.unpack("<4i", values["dataWindow"])
    rows = bottom - top + 1
    compression = values["compression"][0]
    kind = values.get("type", b"tiledimage" if version & _TILED else b"scanlineimage")
    flat = kind == b"scanlineimage" and not (version & _DEEP and "type" not in values)
    known = compression < len(_CHUNK_ROWS)
    if "chunkCount" in values:
        (count,) = struct.unpack("<i", values["chunkCount"])
    elif flat and known:
        count = -(-rows // _CHUNK_ROWS[compression])
    else:
        return None
    if not 0 < count <= _MOST_CHUNKS:
        raise ValueError(f"{count} chunks")
    offsets = struct.unpack(f"<{count}Q", file.read(8 * count))
    each = _CHUNK_ROWS[compression] if known else 0
    if not (flat and known and count == -(-rows // each)):
        return None
    return Chunks(attributes, version, top, rows, each, offsets)


def strips(
    path: Path, chunks: Chunks, row_bytes: int
) -> Iterator[tuple[int, dict[str, NDArray[Any]]]]:
    """First row, counted from the data window's, and channels by name of strip after strip.

    Args:
        path: the file.
        chunks: where its rows are.
        row_bytes: of a decoded row, all channels.

    Raises:
        Exception: of any type, if the file is damaged.
    """
    import OpenEXR

    some = max(1, _STRIP_BYTES // max(1, row_bytes) // chunks.each)
    with path.open("rb") as file:
        for first in range(0, len(chunks.offsets), some):
            last = min(first + some, len(chunks.offsets))
            held = io.BytesIO(_alone(file, chunks, first, last))
            (part,) = OpenEXR.File(held, separate_channels=True).parts
            yield (
                first * chunks.each,
                {name: channel.pixels for name, channel in part.channels.items()},
            )


def _alone(file: BinaryIO, chunks: Chunks, first: int, last: int) -> bytes:
    """Some chunks as a file of their own."""
    top = chunks.top + first * chunks.each
    bottom = min(chunks.top + last * chunks.each, chunks.top + chunks.rows) - 1
    left, _, right, _ = struct.unpack("<4i", _value(chunks.attributes, "dataWindow"))
    window = struct.pack("<4i", left, top, right, bottom)
    kept = [
        (name, kind, window if name == "dataWindow" else value)
        for name, kind, value in chunks.attributes
        if name not in ("chunkCount", "name", "view", "preview")
    ]
    start = _header(kept, chunks.version & (0xFF | _LONG_NAMES))
    body, offsets = bytearray(), []
    place = len(start) + 8 * (last - first)
    for offset in chunks.offsets[first:last]:
        offsets.append(place + len(body))
        file.seek(offset + (4 if chunks.version & _MULTIPART else 0))
        head = file.read(8)
        _, size = struct.unpack("<ii", head)
        data = file.read(size) if size >= 0 else b""
        if len(data) != size:
            raise ValueError("it ends early")
        body += head + data
    return start + struct.pack(f"<{len(offsets)}Q", *offsets) + bytes(body)


def write_strips(
    file: BinaryIO,
    header: Mapping[str, object],
    window: Window,
    parts: Iterable[dict[str, NDArray[Any]]],
) -> None:
    """Write ZIP compressed scan lines, as OpenEXR would at once.

    Args:
        file: to write to, at its beginning.
        header: as OpenEXR takes it, windows left out.
        window: that is written and displayed.
        parts: the channels of strip after strip, each of a multiple of `ZIP_ROWS` rows but the
            last.
    """
    import OpenEXR

    whole = struct.pack("<4i", window.x0, window.y0, window.x1, window.y1)
    offsets: list[int] = []
    row = window.y0
    for channels in parts:
        encoded = io.BytesIO()
        OpenEXR.File(dict(header), dict(channels)).write(encoded)  # changes what it is given
        attributes, chunks = _taken_apart(encoded)
        if not offsets:
            sized = [
                (name, kind, whole if name in ("dataWindow", "displayWindow") else value)
                for name, kind, value in attributes
            ]
            (version,) = struct.unpack_from("<I", encoded.getvalue(), 4)
            file.write(_header(sized, version))
            table = file.tell()
            file.write(bytes(8 * -(-window.height // ZIP_ROWS)))
        for chunk in chunks:
            offsets.append(file.tell())
            file.write(struct.pack("<i", row + struct.unpack_from("<i", chunk)[0]))
            file.write(chunk[4:])
        row += len(next(iter(channels.values())))
    file.seek(table)
    file.write(struct.pack(f"<{len(offsets)}Q", *offsets))
    file.seek(0, io.SEEK_END)


def _taken_apart(encoded: io.BytesIO) -> tuple[Attributes, Iterator[memoryview]]:
    """Attributes and chunks of a file of one part."""
    encoded.seek(8)
    attributes = attributes_of(encoded)
    _, top, _, bottom = struct.unpack("<4i", _value(attributes, "dataWindow"))
    count = -(-(bottom - top + 1) // ZIP_ROWS)
    offsets = struct.unpack(f"<{count}Q", encoded.read(8 * count))
    held = encoded.getbuffer()

    def chunks() -> Iterator[memoryview]:
        for offset in offsets:
            (length,) = struct.unpack_from("<i", held, offset + 4)
            yield held[offset : offset + 8 + length]

    return attributes, chunks()


def _header(attributes: Attributes, version: int) -> bytes:
    parts = [MAGIC, struct.pack("<I", version)]
    for name, kind, value in attributes:
        parts += [name.encode(), b"\0", kind.encode(), b"\0", struct.pack("<i", len(value)), value]
    return b"".join([*parts, b"\0"])


def _value(attributes: Attributes, wanted: str) -> bytes:
    return next(value for name, _, value in attributes if name == wanted)

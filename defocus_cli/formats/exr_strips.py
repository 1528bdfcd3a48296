"""Parts of OpenEXR files: some chunks decoded or encoded at a time, by OpenEXR itself.

The pixels of a file lie in chunks of some rows, or in tiles, each compressed by itself and found
through a table of offsets. So some chunks under a header that claims only their pixels are a whole
file, small enough for memory; and the chunks of such files, under one header, are the file that
OpenEXR would have written at once, byte for byte. Layout: openexr.com, "OpenEXR File Layout".
"""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, BinaryIO

from defocus_cli.formats.exr_header import MAGIC, Raw, Window, attributes_of
from defocus_cli.formats.exr_text import TEXTS

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

# Rows of a chunk of scan lines, by the number of the compression: none, RLE, ZIPS, ZIP, PIZ, PXR24,
# B44, B44A, DWAA, DWAB, HTJ2K256, HTJ2K32, LJ2K, ZSTD.
_CHUNK_ROWS = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256, 256, 32, 256, 1)
ZIP_ROWS = 16
_STRIP_BYTES = 1 << 25  # decoded
_TILED, _LONG_NAMES, _DEEP, _MULTIPART = 0x200, 0x400, 0x800, 0x1000
_MOST_CHUNKS = 1 << 24
_LEFT_OUT = frozenset({"chunkCount", "preview"})
_SHORT = 31  # bytes of a name that any reader takes
_ONE_LEVEL = 0  # the mode of a tiled part without smaller copies of itself

Attributes = list[tuple[str, str, bytes]]


@dataclass(frozen=True)
class Chunks:
    """Where the pixels of one part are.

    Attributes:
        attributes: of its header.
        version: of its file, the flags included.
        window: of its data.
        size: width and height of a chunk in px.
        tiled: whether its chunks are tiles, else scan lines.
        offsets: of the chunks, row by row; of a tiled part, those of full resolution.
    """

    attributes: Attributes
    version: int
    window: Window
    size: tuple[int, int]
    tiled: bool
    offsets: tuple[int, ...]

    @property
    def counts(self) -> tuple[int, int]:
        """How many chunks lie side by side, and how many below each other."""
        return _counts(self.window, self.size)

    @property
    def pixels(self) -> int:
        """Of the largest chunk."""
        return min(self.size[0], self.window.width) * min(self.size[1], self.window.height)


def read_chunks(path: Path) -> tuple[Chunks | None, ...]:
    """Where the pixels of each part are; None for a part that cannot be had chunk by chunk.

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
    window = Window(*struct.unpack("<4i", values["dataWindow"]))
    compression = values["compression"][0]
    kind = values.get("type", b"tiledimage" if version & _TILED else b"scanlineimage")
    deep = bool(version & _DEEP) and "type" not in values
    size = None
    if kind == b"tiledimage":
        size = struct.unpack_from("<2I", values["tiles"])
    elif kind == b"scanlineimage" and not deep and compression < len(_CHUNK_ROWS):
        size = window.width, _CHUNK_ROWS[compression]
    if size is not None and min(size) < 1:
        raise ValueError(f"tiles of {size[0]}×{size[1]} px")
    needed = math.prod(_counts(window, size)) if size is not None else 0
    count = needed
    if "chunkCount" in values:
        (count,) = struct.unpack("<i", values["chunkCount"])
    elif size is None:
        return None
    if not 0 < count <= _MOST_CHUNKS:
        raise ValueError(f"{count} chunks")
    offsets = struct.unpack(f"<{count}Q", file.read(8 * count))
    tiled = kind == b"tiledimage"
    if size is None or (count < needed if tiled else count != needed):
        return None
    return Chunks(attributes, version, window, size, tiled, offsets[:needed])


def _counts(window: Window, size: tuple[int, int]) -> tuple[int, int]:
    return -(-window.width // size[0]), -(-window.height // size[1])


def pieces(
    path: Path, chunks: Chunks, pixel_bytes: int
) -> Iterator[tuple[Window, dict[str, NDArray[Any]]]]:
    """Where they lie, and the channels by name, of piece after piece.

    Args:
        path: the file.
        chunks: where its pixels are.
        pixel_bytes: of a decoded pixel, all channels.

    Raises:
        Exception: of any type, if the file is damaged.
    """
    import OpenEXR

    across, down = chunks.counts
    some = max(1, _STRIP_BYTES // (pixel_bytes * chunks.pixels))
    wide = min(across, some)
    high = some // wide
    with path.open("rb") as file:
        for row, column in product(range(0, down, high), range(0, across, wide)):
            columns = range(column, min(column + wide, across))
            rows = range(row, min(row + high, down))
            window = _window(chunks, columns, rows)
            held = io.BytesIO(_alone(file, chunks, columns, rows, window))
            (part,) = OpenEXR.File(held, separate_channels=True).parts
            yield window, {name: channel.pixels for name, channel in part.channels.items()}


def _window(chunks: Chunks, columns: range, rows: range) -> Window:
    """What some chunks fill of the data window."""
    (width, height), whole = chunks.size, chunks.window
    return Window(
        whole.x0 + columns.start * width,
        whole.y0 + rows.start * height,
        min(whole.x0 + columns.stop * width - 1, whole.x1),
        min(whole.y0 + rows.stop * height - 1, whole.y1),
    )


def _alone(file: BinaryIO, chunks: Chunks, columns: range, rows: range, window: Window) -> bytes:
    """Some chunks as a file of their own."""
    changed = {"dataWindow": struct.pack("<4i", window.x0, window.y0, window.x1, window.y1)}
    if chunks.tiled:
        changed["tiles"] = struct.pack("<2IB", *chunks.size, _ONE_LEVEL)
    kept = [
        (name, kind, changed.get(name, value))
        for name, kind, value in chunks.attributes
        if name == "type" or (name not in _LEFT_OUT and kind not in TEXTS)
    ]
    flags = chunks.version & (0xFF | _LONG_NAMES) | (_TILED if chunks.tiled else 0)
    start = _header(kept, flags)
    body, offsets = bytearray(), []
    place = len(start) + 8 * len(columns) * len(rows)
    for row, column in product(rows, columns):
        offsets.append(place + len(body))
        file.seek(chunks.offsets[row * chunks.counts[0] + column])
        file.seek(4 if chunks.version & _MULTIPART else 0, io.SEEK_CUR)
        if chunks.tiled:
            x, y, *level = struct.unpack("<4i", file.read(16))
            body += struct.pack("<4i", x - columns.start, y - rows.start, *level)
        else:
            body += file.read(4)
        length = file.read(4)
        (size,) = struct.unpack("<i", length)
        data = file.read(size) if size >= 0 else b""
        if len(data) != size:
            raise ValueError("it ends early")
        body += length + data
    return start + struct.pack(f"<{len(offsets)}Q", *offsets) + bytes(body)


def write_strips(
    file: BinaryIO,
    header: Mapping[str, object],
    carried: Mapping[str, Raw],
    window: Window,
    parts: Iterable[dict[str, NDArray[Any]]],
) -> None:
    """Write ZIP compressed scan lines, as OpenEXR would at once.

    Args:
        file: to write to, at its beginning.
        header: as OpenEXR takes it, windows left out.
        carried: further attributes, as they stand in another file.
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
            named = {name: Raw(kind, value) for name, kind, value in attributes}
            named |= carried
            named |= dict.fromkeys(("dataWindow", "displayWindow"), Raw("box2i", whole))
            (version,) = struct.unpack_from("<I", encoded.getvalue(), 4)
            file.write(_header([(name, *named[name]) for name in sorted(named)], version))
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
    if any(max(len(name.encode()), len(kind.encode())) > _SHORT for name, kind, _ in attributes):
        version |= _LONG_NAMES
    parts = [MAGIC, struct.pack("<I", version)]
    for name, kind, value in attributes:
        parts += [name.encode(), b"\0", kind.encode(), b"\0", struct.pack("<i", len(value)), value]
    return b"".join([*parts, b"\0"])


def _value(attributes: Attributes, wanted: str) -> bytes:
    return next(value for name, _, value in attributes if name == wanted)

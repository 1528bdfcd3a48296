"""Text chunks of PNG files, which OpenImageIO renames."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_LONGEST = 1 << 16  # bytes of a text that is read
_MAX_CHUNKS = 100_000


def png_text(path: Path) -> dict[str, str]:
    """Keys and values of tEXt, zTXt and iTXt chunks before or after the pixels; empty if none.

    Chunks longer than 64 kB are passed over, and what is damaged ends the list.
    """
    texts: dict[str, str] = {}
    with path.open("rb") as file:
        if file.read(8) != _SIGNATURE:
            return texts
        for _ in range(_MAX_CHUNKS):
            if len(head := file.read(8)) < 8:
                break
            size, kind = struct.unpack(">I4s", head)
            if kind in (b"tEXt", b"zTXt", b"iTXt") and size <= _LONGEST:
                key, _, value = file.read(size).partition(b"\0")
                texts[key.decode("latin-1")] = _value(kind, value)
                file.seek(4, 1)
            elif kind == b"IEND":
                break
            else:
                file.seek(size + 4, 1)
    return texts


def _value(kind: bytes, value: bytes) -> str:
    if kind == b"tEXt":
        return value.decode("latin-1")
    if kind == b"zTXt":
        return _inflate(value[1:]).decode("latin-1", "replace")
    compressed, text = value[:1] == b"\1", value[2:].split(b"\0", 2)[-1]
    return (_inflate(text) if compressed else text).decode("utf-8", "replace")


def _inflate(data: bytes) -> bytes:
    try:
        return zlib.decompressobj().decompress(data, _LONGEST)
    except zlib.error:
        return b""

"""OpenEXR files whose header holds text that is not UTF-8, as some programs write names in Latin-1.

OpenEXR's own reader takes them, its binding for Python refuses the whole file. Layout: openexr.com,
"OpenEXR File Layout".
"""

from __future__ import annotations

import io
import struct
from typing import TYPE_CHECKING

from defocus_cli.formats.exr_header import attribute_of, is_multipart

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

TEXTS = ("string", "stringvector")
_UNKNOWN = ord("?")


def legible(path: Path) -> str | io.BytesIO:
    """What OpenEXR is to open: the file, or a copy in memory with ? where text is not UTF-8.

    Raises:
        ValueError: the header is damaged.
        OSError: the file cannot be read.
    """
    places = list(_illegible(path))
    if not places:
        return str(path)
    data = bytearray(path.read_bytes())
    for place in places:
        data[place] = _UNKNOWN
    return io.BytesIO(data)


def _illegible(path: Path) -> Iterator[int]:
    """Where in a file bytes of such a text are that are not ASCII."""
    with path.open("rb") as file:
        more = is_multipart(file)
        while found := attribute_of(file):
            while found:
                _, kind, value = found
                start = file.tell() - len(value)
                for offset, text in _texts(kind, value):
                    if not _is_utf8(text):
                        yield from (start + offset + i for i, byte in enumerate(text) if byte > 127)
                found = attribute_of(file)
            if not more:
                return


def _texts(kind: str, value: bytes) -> Iterator[tuple[int, bytes]]:
    """Texts in the value of an attribute, and where they begin."""
    if kind == "string":
        yield 0, value
    place = 0
    while kind == "stringvector" and place < len(value):
        (length,) = struct.unpack_from("<i", value, place)
        place += 4
        if not 0 <= length <= len(value) - place:
            raise ValueError("a list of texts does not end")
        yield place, value[place : place + length]
        place += length


def _is_utf8(text: bytes) -> bool:
    try:
        text.decode()
    except UnicodeDecodeError:
        return False
    return True

"""Codecs of OpenEXR: their numbers in a header, and how many rows they pack at once.

One is named like ``zip``, ``dwaa`` or, of a level of its own, ``dwaa:100``.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import NamedTuple


class Codec(NamedTuple):
    """A codec."""

    number: int
    rows: int
    lossy: bool = False  # whether numbers of channels that are no colour may change, too


CODECS = {
    "none": Codec(0, 1),
    "rle": Codec(1, 1),
    "zips": Codec(2, 1),
    "zip": Codec(3, 16),
    "piz": Codec(4, 32),
    "pxr24": Codec(5, 16, lossy=True),
    "b44": Codec(6, 32, lossy=True),
    "b44a": Codec(7, 32, lossy=True),
    "dwaa": Codec(8, 32),
    "dwab": Codec(9, 256),
    "htj2k256": Codec(10, 256),
    "htj2k32": Codec(11, 32),
}
LARGEST_CHUNK = 256  # rows
_LEVEL = "dwaCompressionLevel"  # attribute of a header


def codec_of(name: str) -> tuple[Codec, dict[str, float]]:
    """The codec of a name like ``dwaa:100``, and the attributes that its level is written by."""
    name, _, level = name.partition(":")
    return CODECS[name], {_LEVEL: float(level)} if level else {}


def codec_name(header: Mapping[str, bytes]) -> str:
    """The name of the codec of a header, by the values of its attributes; zip if it is unknown."""
    number = header.get("compression", b"\3")[0]
    name = next((name for name, codec in CODECS.items() if codec.number == number), "zip")
    level = header.get(_LEVEL, b"")
    if not name.startswith("dwa") or len(level) != 4:
        return name
    return f"{name}:{struct.unpack('<f', level)[0]:g}"

"""What an OpenEXR header says, read without trusting it and before any pixel is allocated.

OpenEXR's own reader gives no channel types without decoding the pixels, and believes any size.
Layout: openexr.com, "OpenEXR File Layout".
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

from defocus_cli.system.errors import InputError
from defocus_cli.system.safe_files import check_size, read_head

if TYPE_CHECKING:
    from pathlib import Path

MAGIC = b"\x76\x2f\x31\x01"
PIXEL_TYPES = {0: "uint", 1: "half", 2: "float"}
_BYTES = {"uint": 4, "half": 2, "float": 4}
_DEEP, _MULTIPART = 0x800, 0x1000
_LONGEST_NAME = 255
# The attributes read here are tens of bytes, a channel list at most some thousand names.
_LONGEST_VALUE = 2**24
_SQUARE = struct.pack("<f", 1.0)
# Attributes that describe how this one file is laid out, not the picture.
STRUCTURAL = frozenset(
    {
        *("channels", "dataWindow", "displayWindow", "lineOrder", "tiles", "type", "version"),
        *("compression", "dwaCompressionLevel", "zipCompressionLevel", "chunkCount"),
        *("name", "multiView", "deepImageState", "maxSamplesPerPixel"),
    }
)


class Raw(NamedTuple):
    """An attribute of a header as it stands in the file: of any type, and of any text."""

    kind: str
    value: bytes


@dataclass(frozen=True)
class Window:
    """Pixel rectangle of an EXR header, both corners included."""

    x0: int
    y0: int
    x1: int
    y1: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height} at {self.x0},{self.y0}"

    @property
    def width(self) -> int:
        """In px."""
        return self.x1 - self.x0 + 1

    @property
    def height(self) -> int:
        """In px."""
        return self.y1 - self.y0 + 1

    def covers(self, other: Window) -> bool:
        """Whether every pixel of ``other`` lies in this window."""
        return (
            self.x0 <= other.x0
            and self.y0 <= other.y0
            and self.x1 >= other.x1
            and self.y1 >= other.y1
        )


@dataclass(frozen=True)
class Channel:
    """One channel of a header: its name, pixel type (uint, half or float), and subsampling."""

    name: str
    type: str
    subsampled: bool


@dataclass(frozen=True)
class Header:
    """One part of an EXR file; its attributes are those that another file may carry."""

    index: int
    name: str  # empty in most single-part files
    channels: tuple[Channel, ...]
    data: Window
    display: Window
    deep: bool
    pixel_aspect: float = 1.0  # width of a pixel by its height
    attributes: Mapping[str, Raw] = field(default_factory=dict, compare=False)

    @property
    def cut_note(self) -> str:
        """What of its pixels is not shown, and what is shown but has none; empty if neither."""
        data, display = self.data, self.display
        cropped = "" if display.covers(data) else f"cropped from {data} to the display window"
        missing = "" if data.covers(display) else f"0 outside the data window {data}"
        return ", ".join(filter(None, (cropped, missing)))

    @property
    def label(self) -> str:
        """What the part is called in messages: its name, or its number if it has none."""
        return self.name or str(self.index)


def is_exr(head: bytes) -> bool:
    """Whether a file that starts with ``head`` claims to be OpenEXR."""
    return head.startswith(MAGIC)


def read_headers(path: Path) -> tuple[Header, ...]:
    """Headers of all parts, sizes checked.

    Raises:
        InputError: not an OpenEXR file, a damaged header, or a size that the file cannot hold.
    """
    if not is_exr(read_head(path)):
        raise InputError(path, "is not an OpenEXR file", "check what wrote it")
    try:
        with path.open("rb") as file:
            headers = tuple(_parts(file))
    except UnicodeDecodeError as error:
        problem = f"has a name in its header that is not UTF-8, {error.object!r}"
        raise InputError(path, problem, "write it again with plain names") from error
    except (OSError, ValueError, struct.error) as error:
        problem = f"has a damaged OpenEXR header ({error})"
        raise InputError(path, problem, "write or copy it again") from error
    for header in headers:
        pixel_bytes = sum(_BYTES[channel.type] for channel in header.channels)
        check_size(path, header.data.width, header.data.height, pixel_bytes)
        check_size(path, header.display.width, header.display.height, pixel_bytes)
    return headers


def _parts(file: BinaryIO) -> list[Header]:
    (_, version) = struct.unpack("<4sI", file.read(8))
    if version & 0xFF != 2:
        raise ValueError(f"format version {version & 0xFF}, not 2")
    headers: list[Header] = []
    while attributes := {name: Raw(kind, value) for name, kind, value in attributes_of(file)}:
        headers.append(_header(len(headers), attributes, bool(version & _DEEP)))
        if not version & _MULTIPART:
            break
    if not headers:
        raise ValueError("no parts")
    return headers


def attributes_of(file: BinaryIO) -> list[tuple[str, str, bytes]]:
    """Name, type and value of the attributes of the next header, in order.

    There are none at the end of a multi-part list.

    Raises:
        ValueError: it is damaged.
    """
    return list(iter(lambda: attribute_of(file), None))


def attribute_of(file: BinaryIO) -> tuple[str, str, bytes] | None:
    """Name, type and value of the next attribute; None at the end of a header.

    Raises:
        ValueError: it is damaged.
    """
    name = _text(file)
    if not name:
        return None
    kind = _text(file)
    (size,) = struct.unpack("<i", file.read(4))
    if not 0 <= size <= _LONGEST_VALUE:
        raise ValueError(f"attribute {name} of {size} bytes")
    value = file.read(size)
    if len(value) < size:
        raise ValueError("it ends early")
    return name, kind, value


def is_multipart(file: BinaryIO) -> bool:
    """Whether a file, at its beginning, may have several headers; the first comes next."""
    (_, version) = struct.unpack("<4sI", file.read(8))
    return bool(version & _MULTIPART)


def _text(file: BinaryIO) -> str:
    """Next zero-terminated string."""
    text = bytearray()
    while (byte := file.read(1)) != b"\0":
        if not byte or len(text) == _LONGEST_NAME:
            raise ValueError("it ends early" if not byte else "a name does not end")
        text += byte
    return text.decode()


def _header(index: int, found: dict[str, Raw], any_deep: bool) -> Header:
    attributes = {name: raw.value for name, raw in found.items()}
    missing = {"channels", "dataWindow", "displayWindow"} - attributes.keys()
    if missing:
        raise ValueError(f"no {min(missing)}")
    kind = attributes.get("type", b"deepscanline" if any_deep else b"scanlineimage")
    return Header(
        index=index,
        name=attributes.get("name", b"").decode("utf-8", "replace"),
        channels=tuple(_channels(attributes["channels"])),
        data=Window(*struct.unpack("<4i", attributes["dataWindow"])),
        display=Window(*struct.unpack("<4i", attributes["displayWindow"])),
        deep=kind.startswith(b"deep"),
        pixel_aspect=struct.unpack("<f", attributes.get("pixelAspectRatio", _SQUARE))[0],
        attributes={name: raw for name, raw in found.items() if name not in STRUCTURAL},
    )


def _channels(value: bytes) -> list[Channel]:
    found = []
    while not value.startswith(b"\0"):
        name, end, value = value.partition(b"\0")
        if not end:
            raise ValueError("the channel list does not end")
        kind, xs, ys = struct.unpack_from("<i4x2i", value)
        if kind not in PIXEL_TYPES or xs < 1 or ys < 1:
            raise ValueError(f"channel type {kind}, sampling {xs}×{ys}")
        found.append(Channel(name.decode(), PIXEL_TYPES[kind], subsampled=(xs, ys) != (1, 1)))
        value = value[16:]
    return found

"""Headers of OpenEXR files, checked before any pixel is allocated.

They are read without a library, because none returns an attribute as it is in the file: OpenEXR's
binding for Python refuses text that is not UTF-8, and OpenImageIO converts attributes to its own.
Layout: openexr.com, "OpenEXR File Layout".
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import BinaryIO, NamedTuple

from defocus_core.errors import InputError
from defocus_core.io.exr.windows import Overscan, Window
from defocus_core.io.read_files import check_size, damaged, once, read_head

MAGIC = b"\x76\x2f\x31\x01"
# NumPy's names of the types of channels, which files number in this order; the last digit is bytes
DTYPES = {"uint": "<u4", "half": "<f2", "float": "<f4"}
_LONG_NAMES, _DEEP, MULTIPART = 0x400, 0x800, 0x1000
_SHORT_NAME, _LONGEST_NAME = 31, 255
_LONGEST_VALUE = 2**24  # bytes of an attribute
# More than any picture has, in all parts of a file together. They bound the time of decoders, which
# compare all pairs of channels and of the attributes of a part.
_MOST = {
    "parts": 512,
    "channels": 4096,
    "views": 1024,
    "attributes": 2**14,
    "attributes in a part": 2**11,
    "bytes": 2**27,
}
# Attributes that describe the layout of a file, not the picture.
STRUCTURAL = {
    *("channels", "dataWindow", "displayWindow", "lineOrder", "tiles", "type", "version", "name"),
    *("compression", "dwaCompressionLevel", "zipCompressionLevel", "chunkCount"),
    *("multiView", "deepImageState", "maxSamplesPerPixel"),
}


class Raw(NamedTuple):
    """The type and the bytes of an attribute as they are in a header."""

    kind: str
    value: bytes


@dataclass(frozen=True)
class Channel:
    """One channel of a header."""

    name: str
    type: str  # uint, half or float; for files other than EXR as NumPy or OpenImageIO names it
    plain: str  # the name of the channel without the name of a view


@dataclass(frozen=True)
class Header:
    """The header of a part of an EXR file, or of a page or array of another file.

    `attributes` are those that may be copied to an output file.
    """

    index: int
    name: str  # empty in most single-part files
    channels: tuple[Channel, ...]
    data: Window
    display: Window
    deep: bool
    pixel_aspect: float = 1.0  # width of a pixel divided by its height
    # Names of the views whose channels are in this part, the default one first
    multi_view: tuple[str, ...] = ()
    shown: str = ""  # the view that the channels are restricted to; empty for all
    compression: str = "zip"  # the codec of its pixels, a value of the option `compression`
    whole: bool = True  # False for a thumbnail or mask of another page of a TIFF
    attributes: Mapping[str, Raw] = field(default_factory=dict, compare=False)

    @property
    def views(self) -> tuple[str, ...]:
        """The names of the views that have channels in this part; empty without named views."""
        return (self.view,) if self.view else self.multi_view

    @property
    def view(self) -> str:
        """The name of the view that the whole part belongs to; empty if there is none."""
        raw = self.attributes.get("view")
        return raw.value.decode("utf-8", "replace") if raw and raw.kind == "string" else ""

    def cut_note(self, kept: Overscan) -> str:
        """A note on pixels beyond the display window or missing in it; empty if there are none.

        `kept`: the overscan that is read.
        """
        data, display = self.data, self.display
        overscan = f"overscan {kept}" if any(kept) else ""
        is_cropped = not display.grown(kept).covers(data)
        cropped = f"cropped from {data} to the display window" if is_cropped else ""
        missing = "" if data.covers(display) else f"nothing outside the data window {data}"
        return ", ".join(filter(None, (overscan, cropped, missing)))

    @cached_property
    def folded_names(self) -> frozenset[str]:
        """The names of the channels in lower case, without the names of views."""
        return frozenset(channel.plain.lower() for channel in self.channels)

    @property
    def label(self) -> str:
        """The name of the part in messages; its number if the part has no name."""
        return self.name or str(self.index)

    @property
    def pixel_bytes(self) -> int:
        """Bytes of all channels of one decoded pixel."""
        return sum(int(DTYPES[channel.type][-1]) for channel in self.channels)


class _Refused(Exception):  # noqa: N818 - it is said of a header
    """The refusal of a file with a valid header; its arguments are code, problem and remedy."""


def is_exr(head: bytes) -> bool:
    """Whether a file that starts with ``head`` claims to be OpenEXR."""
    return head.startswith(MAGIC)


def no_exr(path: Path) -> InputError:
    """The error for a file that is not OpenEXR although it should be."""
    return InputError("wrong-type", "is not an OpenEXR file", "check what wrote it", path=path)


@once
def read_headers(path: Path) -> tuple[Header, ...]:
    """The headers of all parts of an EXR file; sizes that no picture has are an InputError."""
    if not is_exr(read_head(path)):
        raise no_exr(path)
    try:
        with path.open("rb") as file:
            version, parts = raw_headers(file)
            headers, total = list[Header](), 0
            for attributes in parts:
                headers.append(_header(len(headers), attributes, deep=bool(version & _DEEP)))
                total += len(headers[-1].channels)
                _limit(channels=total)
    except UnicodeDecodeError as error:
        problem = f"has a name in its header that is not UTF-8, {error.object!r}"
        remedy = "write it again with plain names"
        raise InputError("not-utf-8", problem, remedy, path=path) from error
    except _Refused as error:
        raise InputError(*error.args, path=path) from None
    except (OSError, ValueError, struct.error) as error:
        raise damaged(path, str(error), "has a damaged OpenEXR header") from error
    for header in headers:
        for window in (header.data, header.display):
            check_size(path, window.width, window.height, header.pixel_bytes)
    return tuple(headers)


def read_attributes(file: BinaryIO) -> dict[str, Raw]:
    """The attributes by name of the next header in an open file; empty if no header follows."""
    attributes = {}
    while name := _text(file):
        kind = _text(file)
        (size,) = struct.unpack("<i", file.read(4))
        if not 0 <= size <= _LONGEST_VALUE:
            raise ValueError(f"attribute {name} of {size} bytes")
        value = file.read(size)
        if len(value) < size:
            raise ValueError("it ends early")
        attributes[name] = Raw(kind, value)
        _limit(**{"attributes in a part": len(attributes), "bytes": file.tell()})
    return attributes


def _limit(**counts: int) -> None:
    """Refuse a header whose `counts`, by keys of `_MOST`, exceed those of any picture."""
    for name, count in counts.items():
        if count > _MOST[name]:
            problem = f"has a header of more than {_MOST[name]} {name}"
            raise _Refused("too-large", problem, "split it into several files")


def header_bytes(attributes: Mapping[str, Raw]) -> bytes:
    """The first bytes of a file with one scan-line part, up to its table of offsets."""
    names = [name.encode() for pair in attributes.items() for name in (pair[0], pair[1].kind)]
    version = 2 | (_LONG_NAMES if max(map(len, names)) > _SHORT_NAME else 0)
    parts = [MAGIC, struct.pack("<I", version)]
    for name, (kind, value) in sorted(attributes.items()):
        parts += [name.encode(), b"\0", kind.encode(), b"\0", struct.pack("<i", len(value)), value]
    return b"".join([*parts, b"\0"])


def _text(file: BinaryIO) -> str:
    start, text = file.tell(), file.read(_LONGEST_NAME + 1)
    if (end := text.find(b"\0")) < 0:
        raise ValueError("a name does not end" if len(text) > _LONGEST_NAME else "it ends early")
    file.seek(start + end + 1)
    return text[:end].decode()


def raw_headers(file: BinaryIO) -> tuple[int, list[dict[str, Raw]]]:
    """The version field of an open file, which holds flags, too, and the attributes of each part.

    Afterwards the file stands at the first table of offsets.
    """
    (_, version) = struct.unpack("<4sI", file.read(8))
    if version & 0xFF != 2:
        raise ValueError(f"format version {version & 0xFF}, not 2")
    parts: list[dict[str, Raw]] = []
    total = 0
    while attributes := read_attributes(file):
        parts.append(attributes)
        total += len(attributes)
        _limit(parts=len(parts), attributes=total)
        if not version & MULTIPART:
            break
    if not parts:
        raise ValueError("no parts")
    return version, parts


# Sizes in bytes of attributes by type, and the types of attributes that every reader uses:
# openexr.com, "OpenEXR File Layout".
_SIZES = {
    **dict.fromkeys(("compression", "envmap", "lineOrder"), 1),
    **dict.fromkeys(("int", "float"), 4),
    **dict.fromkeys(("double", "rational", "timecode", "v2i", "v2f"), 8),
    **dict.fromkeys(("v3i", "v3f"), 12),
    **dict.fromkeys(("box2i", "box2f", "v2d"), 16),
    **{"tiledesc": 9, "v3d": 24, "keycode": 28, "chromaticities": 32, "m33f": 36, "m44f": 64},
    **{"m33d": 72, "m44d": 128},
}
_KINDS = {
    **{"channels": "chlist", "compression": "compression", "lineOrder": "lineOrder"},
    **dict.fromkeys(("dataWindow", "displayWindow"), "box2i"),
    **dict.fromkeys(("pixelAspectRatio", "screenWindowWidth"), "float"),
    **{"screenWindowCenter": "v2f", "chromaticities": "chromaticities", "view": "string"},
    **{"multiView": "stringvector", "tiles": "tiledesc", "type": "string", "name": "string"},
}


def _check(name: str, raw: Raw) -> None:
    """Raise ValueError for an attribute whose type, size or value no reader would accept."""
    if _KINDS.get(name, raw.kind) != raw.kind:
        raise ValueError(f"{name} is of type {raw.kind}")
    if len(raw.value) != _SIZES.get(raw.kind, len(raw.value)):
        raise ValueError(f"{name} has {len(raw.value)} bytes")
    if raw.kind == "chlist":
        channels_of(raw.value)
    elif raw.kind == "stringvector":
        _texts(raw.value)
    elif name in ("pixelAspectRatio", "screenWindowWidth"):
        (value,) = struct.unpack("<f", raw.value)
        if not 0 <= value < math.inf:
            raise ValueError(f"{name} is {value:g}")


def _header(index: int, attributes: dict[str, Raw], *, deep: bool) -> Header:
    for name, raw in attributes.items():
        _check(name, raw)
    values = {name: raw.value for name, raw in attributes.items()}
    missing = {"channels", "dataWindow", "displayWindow"} - values.keys()
    if missing:
        raise ValueError(f"no {min(missing)}")
    channels = tuple(channels_of(values["channels"]))
    if not channels:
        raise ValueError("no channels")
    (aspect,) = struct.unpack("<f", values.get("pixelAspectRatio", struct.pack("<f", 1.0)))
    return Header(
        index=index,
        name=values.get("name", b"").partition(b"\0")[0].decode("utf-8", "replace"),
        channels=channels,
        data=Window(*struct.unpack("<4i", values["dataWindow"])),
        display=Window(*struct.unpack("<4i", values["displayWindow"])),
        deep=values["type"].startswith(b"deep") if "type" in values else deep,
        pixel_aspect=aspect,
        compression=codec_name(values),
        multi_view=tuple(map(bytes.decode, _texts(values.get("multiView", b"")))),
        attributes={name: raw for name, raw in attributes.items() if name not in STRUCTURAL},
    )


def channels_of(value: bytes) -> list[Channel]:
    """The channels that the bytes of the attribute ``channels`` list."""
    channels: list[Channel] = []
    at = 0
    while value[at : at + 1] != b"\0":
        end = value.find(b"\0", at)
        if end < 0:
            raise ValueError("the channel list does not end")
        kind, xs, ys = struct.unpack_from("<i4x2i", value, end + 1)
        if not 0 <= kind < len(DTYPES) or xs < 1 or ys < 1:
            raise ValueError(f"channel type {kind}, sampling {xs}×{ys}")
        name = value[at:end].decode()
        if (xs, ys) != (1, 1):  # as chroma has
            problem = f"has fewer samples than pixels in channel {name}"
            raise _Refused("subsampled", problem, "save it with all, colour as R, G and B")
        channels.append(Channel(name, [*DTYPES][kind], name))
        _limit(channels=len(channels))
        at = end + 17
    return channels


def _texts(value: bytes) -> tuple[bytes, ...]:
    """The texts in the bytes of a ``stringvector``, where each text follows its length."""
    texts: list[bytes] = []
    at = 0
    while at < len(value):
        (size,) = struct.unpack_from("<i", value, at)
        at += 4
        if not 0 <= size <= len(value) - at:
            raise ValueError("a list of texts ends early")
        texts.append(value[at : at + size])
        _limit(views=len(texts))
        at += size
    return tuple(texts)


class Codec(NamedTuple):
    """A codec of pixels in EXR."""

    number: int  # in the file format
    rows: int  # number of rows in a chunk
    loses: tuple[str, ...] = ()  # NumPy types whose numbers the codec rounds
    # Names of channels, without layers, whose numbers the codec rounds; empty for all names
    names: frozenset[str] = frozenset()

    def changes(self, name: str, kind: str) -> bool:
        """Whether the codec may change the numbers of channel `name`, of the NumPy type `kind`."""
        return kind in self.loses and (not self.names or name.rpartition(".")[2] in self.names)


_OF_DWA = ("float16", "float32"), frozenset({"R", "G", "B", "Y", "RY", "BY"})  # DwaCompressor
CODECS = {
    "none": Codec(0, 1),
    "rle": Codec(1, 1),
    "zips": Codec(2, 1),
    "zip": Codec(3, 16),
    "piz": Codec(4, 32),
    "pxr24": Codec(5, 16, ("float32",)),
    "b44": Codec(6, 32, ("float16",)),
    "b44a": Codec(7, 32, ("float16",)),
    "dwaa": Codec(8, 32, *_OF_DWA),
    "dwab": Codec(9, 256, *_OF_DWA),
    "htj2k256": Codec(10, 256),
    "htj2k32": Codec(11, 32),
}
_LEVEL = "dwaCompressionLevel"  # attribute of a header


def codec_of(name: str) -> tuple[Codec, dict[str, float]]:
    """The codec of a name like ``dwaa:100``, and the attributes that hold the level, here 100."""
    name, _, level = name.partition(":")
    return CODECS[name], {_LEVEL: float(level)} if level else {}


def codec_name(header: Mapping[str, bytes]) -> str:
    """The name of the codec that a header declares, with its level; zip if it is unknown."""
    number = header.get("compression", b"\3")[0]
    name = next((name for name, codec in CODECS.items() if codec.number == number), "zip")
    level = header.get(_LEVEL, b"")
    if not name.startswith("dwa") or len(level) != 4:
        return name
    return f"{name}:{struct.unpack('<f', level)[0]:g}"

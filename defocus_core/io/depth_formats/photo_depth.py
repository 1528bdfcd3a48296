"""Depth images inside photographs of phones: HEIC auxiliary depth, and two kinds in JPEG.

GDepth (Google, "Depthmap metadata"): XMP properties, the depth map itself in base64 in the extended
XMP, which is spread over segments APP1 of at most 64 kB (Adobe, "XMP Specification Part 3"). There
GImage:Data may be the sharp picture, of which the photograph itself is blurred already.

Dynamic Depth (Google, version 1.0): XMP lists files that follow the photograph, and their lengths.
"""

from __future__ import annotations

import base64
import re
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from defocus_core.errors import InputError, reason
from defocus_core.io.depth_formats.jpeg_overshoot import without_overshoot
from defocus_core.io.depth_formats.reading import DepthNumbers, holds_gdepth
from defocus_core.io.images.raster import HEIC_DAMAGE, open_heic, read_pages, read_samples, upright
from defocus_core.io.safe_files import decoding, quiet, read_head

_XMP, _EXTENSION = b"http://ns.adobe.com/xap/1.0/\0", b"http://ns.adobe.com/xmp/extension/\0"
_EXTENSION_HEAD = 32 + 8  # digest, length of all, offset of this part
# Attributes, and elements but for their ends.
_PROPERTY = re.compile(
    r"""(?<![/\w])((?:GDepth|GImage|DepthMap|Item):\w+)(?:\s*=\s*["']|>)([^"'<]*)"""
)
_COUNT = re.compile(r"\d{1,12}")
_START_OF_SCAN = 0xDA


@contextmanager
def sharp_original(path: Path) -> Iterator[Path]:
    """A file with the sharp picture inside a photograph; itself if it has none of its own."""
    data = _properties(path).get("GImage:Data") if holds_gdepth(path) else None
    if data is None:
        yield path
        return
    try:
        with _unpack(data) as image:
            yield image
    except ValueError as error:
        problem = f"has a damaged picture in GImage:Data ({reason(error)})"
        raise InputError("damaged", problem, "copy the photograph again", path=path) from error


def read_heic(path: Path) -> DepthNumbers:
    """The depth image of a HEIC photograph; with d_min, d_max and representation_type."""
    file = open_heic(path)
    with decoding(path, HEIC_DAMAGE), quiet():
        images = file.info.get("depth_images") or []
        values = np.asarray(images[0]) if images else None
    if values is None:
        remedy = "take the photograph in portrait mode"
        raise InputError("no-depth", "has no depth image", remedy, path=path)
    values = np.atleast_3d(values)[:, :, 0]
    metadata = images[0].info["metadata"] or {}
    return DepthNumbers(path, values, "HEIC", "HEIC depth image", metadata=metadata)


def read_gdepth(path: Path) -> DepthNumbers:
    """The depth image of a JPEG photograph that holds GDepth, turned upright with it."""
    found = _properties(path).items()
    metadata = {name[7:]: text for name, text in found if name.startswith("GDepth:")}
    if "Data" not in metadata:
        remedy = "check what took or edited it"
        raise InputError("no-depth", "has no GDepth in its XMP", remedy, path=path)
    try:
        with _unpack(metadata.pop("Data")) as image:
            values = read_samples(image)[:, :, 0]
            if image.suffix == ".jpg":
                values = without_overshoot(values)
    except (InputError, ValueError) as error:  # it would name the scratch file
        why = error.problem if isinstance(error, InputError) else reason(error)
        problem = f"has a damaged GDepth image ({why})"
        raise InputError("damaged", problem, "copy the photograph again", path=path) from error
    values = upright(values, read_pages(path)[0].orientation)
    return DepthNumbers(path, values, "GDepth", "GDepth depth image", metadata=metadata)


def _properties(path: Path) -> dict[str, str]:
    """The properties GDepth:… and GImage:… of the XMP of a JPEG, and of Dynamic Depth."""
    read_head(path)
    data = path.read_bytes()
    packet = b"".join(_xmp(data)).decode("utf-8", "replace")
    return dict(_PROPERTY.findall(packet)) | _dynamic_depth(data, packet)


def _dynamic_depth(data: bytes, packet: str) -> dict[str, str]:
    """The properties of Dynamic Depth in the words of GDepth; empty if a file has none."""
    told = {name[9:]: text for name, text in _PROPERTY.findall(packet) if name[:9] == "DepthMap:"}
    start = len(data)
    for part in reversed(packet.split("<rdf:li")):
        item = {"Item:Semantic": "", "Item:DataURI": ""} | dict(_PROPERTY.findall(part))
        length, padding = (
            int(n) if _COUNT.fullmatch(n := item.get(f"Item:{name}", "")) else 0
            for name in ("Length", "Padding")
        )
        start -= length + padding
        uri = item["Item:DataURI"]
        if item["Item:Semantic"] == "Depth" or (uri and uri == told.get("DepthURI")):
            told["Data"] = base64.b64encode(data[max(start, 0) :][:length]).decode()
            break
    unit = told.pop("Units", "None")
    if unit != "None":
        told["Units"] = {"Meters": "m"}.get(unit, unit)
    return {f"GDepth:{name}": text for name, text in told.items()}


def _xmp(data: bytes) -> Iterator[bytes]:
    """The XMP packet of a JPEG and the parts of its extension, in order."""
    place, parts = 2, {}
    while place + 4 <= len(data) and data[place] == 0xFF and data[place + 1] != _START_OF_SCAN:
        (size,) = struct.unpack_from(">H", data, place + 2)
        body = data[place + 4 : place + 2 + size]
        if body.startswith(_XMP):
            yield body.removeprefix(_XMP)
        elif body.startswith(_EXTENSION):
            body = body.removeprefix(_EXTENSION)
            (offset,) = struct.unpack_from(">I", body, 36) if len(body) >= _EXTENSION_HEAD else (0,)
            parts[offset] = body[_EXTENSION_HEAD:]
        place += 2 + size
    for offset in sorted(parts):
        yield parts[offset]


@contextmanager
def _unpack(text: str) -> Iterator[Path]:
    """A temporary file of the image in a property, as OpenImageIO reads only files."""
    data = base64.b64decode(text, validate=False)
    suffix = ".png" if data.startswith(b"\x89PNG") else ".jpg"
    with tempfile.NamedTemporaryFile(suffix=suffix) as file:
        file.write(data)
        file.flush()
        yield Path(file.name)

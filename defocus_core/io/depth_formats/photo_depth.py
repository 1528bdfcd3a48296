"""Depth and mattes inside photographs of phones: HEIC auxiliary images, and three kinds in JPEG.

GDepth (Google, "Depthmap metadata"): XMP properties, with the depth map itself in base64 in the
extended XMP, which is spread over segments APP1 of at most 64 kB (Adobe, "XMP Specification Part
3"). GImage:Data may hold the sharp picture if the photograph itself is already blurred.

Dynamic Depth (Google, version 1.0): XMP lists the files that follow the photograph, and their
lengths.

Apple: further pictures of the JPEG (CIPA DC-007, "Multi-Picture Format"), each described by its own
XMP. Further pictures of other types, like gain maps and the second view of a stereo camera, are
ignored.
"""

from __future__ import annotations

import base64
import re
import struct
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, reason
from defocus_core.io.depth_formats.jpeg_overshoot import without_overshoot
from defocus_core.io.depth_formats.reading import PICTURES, DepthNumbers, own_format
from defocus_core.io.images.raster import HEIC_DAMAGE, open_heic, read_pages, read_samples, upright
from defocus_core.io.read_files import decoding, is_heic, quiet, read_head

_XMP, _EXTENSION = b"http://ns.adobe.com/xap/1.0/\0", b"http://ns.adobe.com/xmp/extension/\0"
_EXTENSION_HEAD = 32 + 8  # digest, length of all, offset of this part
# XMP attributes, and elements without their end tags.
_PROPERTY = re.compile(
    r"""(?<![/\w])((?:GDepth|GImage|DepthMap|Item|apdi):\w+)(?:\s*=\s*["']|>)([^"'<]*)"""
)
_COUNT = re.compile(r"\d{1,12}")
_START_OF_SCAN = 0xDA
_ENTRIES = 0xB002  # tag of the list of pictures
# Apple's types of a depth image: the number of each type in HEIC, and the keys of its range there.
_APPLE = {"disparity": (1, "d_min", "d_max"), "depth": (2, "z_near", "z_far")}
# Ends of the names of Apple's mattes: that of a person, and that of hair, which is finer.
_PERSON, _HAIR = "aux:portraiteffectsmatte", "aux:semantichairmatte"


@contextmanager
def sharp_original(path: Path) -> Iterator[Path]:
    """Yield the path of the sharp picture inside a photograph, or that of the photograph itself."""
    of_google = own_format(path) == "android-gdepth"
    data = _properties(path.read_bytes()).get("GImage:Data") if of_google else None
    if data is None:
        yield path
        return
    try:
        with _unpack(base64.b64decode(data)) as image:
            yield image
    except ValueError as error:
        problem = f"has a damaged picture in GImage:Data ({reason(error)})"
        raise InputError("damaged", problem, "copy the photograph again", path=path) from error


def read_heic(path: Path) -> DepthNumbers:
    """The depth image of a HEIC photograph, and as metadata what it says of its range."""
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


def read_jpeg(path: Path) -> DepthNumbers:
    """The depth image of a JPEG photograph, turned upright with it."""
    read_head(path)
    kind, told = "GDepth", _gdepth(path.read_bytes())
    if own_format(path) == "apple-heic":
        kind, told = "Apple JPEG", _depth_of_apple(path)
    if "Data" not in told:
        remedy = "check what took or edited it"
        raise InputError("no-depth", f"has no {kind} depth image", remedy, path=path)
    values = _decoded(path, told.pop("Data"), f"{kind} image")
    return DepthNumbers(path, values, kind, f"{kind} depth image", metadata=told)


def matte_inside(path: Path) -> NDArray[np.uint8] | None:
    """The coverage [H, W], 0 to 255, of the person in an Apple photograph; None without a matte.

    It is the portrait matte, joined with the matte of hair if both have one size.
    """
    mattes = {}
    if is_heic(read_head(path)):
        file = open_heic(path)
        with decoding(path, HEIC_DAMAGE), quiet():
            for name, numbers in (file.info.get("aux") or {}).items():
                if name.endswith((_PERSON, _HAIR)):
                    image = file[file.primary_index].get_aux_image(numbers[0])
                    mattes[name.rpartition(":")[2]] = np.atleast_3d(np.asarray(image))[:, :, 0]
    else:
        for name, (_, data) in _pictures_of_apple(path).items():
            if name.endswith((_PERSON, _HAIR)):
                mattes[name.rpartition(":")[2]] = _decoded(path, data, "matte")
    person, hair = (mattes.get(each.partition(":")[2]) for each in (_PERSON, _HAIR))
    if person is None or hair is None or person.shape != hair.shape:
        return person
    finer: NDArray[np.uint8] = np.maximum(person, hair)
    return finer


def _decoded(path: Path, data: bytes, words: str) -> NDArray[Any]:
    """The numbers [H, W] of an image in a photograph, turned upright with it; `words` name it."""
    try:
        with _unpack(data) as image:
            values = read_samples(image)[:, :, 0]
            if image.suffix == ".jpg":
                values = without_overshoot(values)
    except (InputError, ValueError) as error:  # names the temporary file
        why = error.problem if isinstance(error, InputError) else reason(error)
        problem = f"has a damaged {words} ({why})"
        raise InputError("damaged", problem, "copy the photograph again", path=path) from error
    turned: NDArray[Any] = upright(values, read_pages(path)[0].orientation)
    return turned


def _gdepth(data: bytes) -> dict[str, Any]:
    """The properties of depth in a JPEG by GDepth or Dynamic Depth, the image as bytes in `Data`.

    Keys are those of GDepth; the dictionary is empty if the file has neither.
    """
    properties = _properties(data)
    told: dict[str, Any] = {n[7:]: text for n, text in properties.items() if n[:7] == "GDepth:"}
    if "Data" in told:
        return told | {"Data": base64.b64decode(told["Data"])}
    told |= {name[9:]: text for name, text in properties.items() if name[:9] == "DepthMap:"}
    start = len(data)
    for part in reversed(_packet(data).split("<rdf:li")):
        item = {"Item:Semantic": "", "Item:DataURI": ""} | dict(_PROPERTY.findall(part))
        length, padding = (
            int(n) if _COUNT.fullmatch(n := item.get(f"Item:{name}", "")) else 0
            for name in ("Length", "Padding")
        )
        start -= length + padding
        uri = item["Item:DataURI"]
        if item["Item:Semantic"] == "Depth" or (uri and uri == told.get("DepthURI")):
            told["Data"] = data[max(start, 0) :][:length]
            break
    unit = told.pop("Units", "None")
    return told if unit == "None" else told | {"Units": {"Meters": "m"}.get(unit, unit)}


def _depth_of_apple(path: Path) -> dict[str, Any]:
    """Apple's properties of depth in a JPEG by the keys of HEIC, with the image as bytes in `Data`.

    The dictionary is empty without a depth image.
    """
    for name, (told, data) in _pictures_of_apple(path).items():
        if name not in _APPLE:
            continue
        kind, *ends = _APPLE[name]
        with decoding(path):
            numbers = [told.get(f"apdi:Float{end}Value") for end in ("Min", "Max")]
            values = {end: float(n) for end, n in zip(ends, numbers, strict=True) if n}
        return {"representation_type": kind, "Data": data, **values}
    return {}


def _pictures_of_apple(path: Path) -> dict[str, tuple[Mapping[str, str], bytes]]:
    """XMP properties and bytes of each further picture of a JPEG, by Apple's name of its type."""
    with decoding(path):
        pictures = [(_properties(data), data) for data in _further_pictures(path.read_bytes())]
    return {told.get("apdi:AuxiliaryImageType", ""): (told, data) for told, data in pictures}


def _further_pictures(data: bytes) -> Iterator[bytes]:
    """Yield the bytes of each picture but the first of a JPEG in the Multi-Picture Format."""
    for at, body in _segments(data):
        if not body.startswith(PICTURES):
            continue
        start = at + len(PICTURES)
        order = ">" if data[start : start + 2] == b"MM" else "<"
        (fields,) = struct.unpack_from(f"{order}I", data, start + 4)
        (count,) = struct.unpack_from(f"{order}H", data, start + fields)
        for n in range(count):
            field = start + fields + 2 + 12 * n
            tag, _, size, place = struct.unpack_from(f"{order}HHII", data, field)
            for entry in range(16, size, 16) if tag == _ENTRIES else ():
                length, first = struct.unpack_from(f"{order}4xII", data, start + place + entry)
                yield data[start + first :][:length]


def _properties(data: bytes) -> dict[str, str]:
    """The properties of Google and Apple in the XMP of a JPEG, by name."""
    return dict(_PROPERTY.findall(_packet(data)))


def _packet(data: bytes) -> str:
    """The XMP packet of a JPEG followed by its extended XMP, as one text."""
    packet, parts = b"", {}
    for _, body in _segments(data):
        if body.startswith(_XMP):
            packet += body.removeprefix(_XMP)
        elif body.startswith(_EXTENSION):
            body = body.removeprefix(_EXTENSION)
            (offset,) = struct.unpack_from(">I", body, 36) if len(body) >= _EXTENSION_HEAD else (0,)
            parts[offset] = body[_EXTENSION_HEAD:]
    return (packet + b"".join(parts[offset] for offset in sorted(parts))).decode("utf-8", "replace")


def _segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the byte offset and the bytes of each segment of a JPEG before its pixels."""
    place = 2
    while place + 4 <= len(data) and data[place] == 0xFF and data[place + 1] != _START_OF_SCAN:
        (size,) = struct.unpack_from(">H", data, place + 2)
        yield place + 4, data[place + 4 : place + 2 + size]
        place += 2 + size


@contextmanager
def _unpack(data: bytes) -> Iterator[Path]:
    """Yield the path of a temporary file with an image's bytes, as OpenImageIO reads only files."""
    suffix = ".png" if data.startswith(b"\x89PNG") else ".jpg"
    with tempfile.NamedTemporaryFile(suffix=suffix) as file:
        file.write(data)
        file.flush()
        yield Path(file.name)

"""Files decoded for comparison: all channels as stored, the metadata, and the layout of the file.

Integers become 0…1, other numbers stay as they are. Values are not scaled or multiplied by alpha;
`in_linear_light` makes files of different types comparable.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.array_files import NAMED, array_of, array_type, read_map
from defocus_core.io.depth_formats.exr_depth_channel import NO_DEPTH
from defocus_core.io.exr.deep_samples import read_deep_samples
from defocus_core.io.exr.header import Header, Raw, is_exr, read_headers
from defocus_core.io.exr.reading import read_parts
from defocus_core.io.images.color_space import linear_light, linear_to_srgb, srgb_to_linear, unit
from defocus_core.io.images.primaries import REC_709, Chromaticities, declared_primaries
from defocus_core.io.images.raster import PLAIN_CHANNELS, Raster, read_pages, read_samples
from defocus_core.io.read_files import read_head

# Suffixes of pictures and arrays that are not decoded here, but compared by bytes.
UNDECODED = frozenset(
    {".npz", ".h5", ".hdf5", ".mat", ".bin", ".pt", ".pth", ".raw", ".dng", ".psd", ".jxl", ".avif"}
)
SUFFIXES = UNDECODED | {
    *(".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".pfm", ".npy", ".webp", ".dpt"),
    *(".ppm", ".pgm", ".pbm", ".pnm", ".bmp", ".gif", ".tga", ".dpx", ".cin", ".sgi", ".rgb"),
    *(".jp2", ".heic", ".heif", ".ico", ".dds", ".tx"),
}
_KNOWN = "EXR, PNG, JPEG, TIFF, HDR, PFM or NPY"
_PNG = b"\x89PNG\r\n\x1a\n"
# Attributes that are numbers, by their type in the header.
_NUMBERS = {
    **dict.fromkeys(("float", "v2f", "v3f", "m33f", "m44f", "box2f", "chromaticities"), "f"),
    **dict.fromkeys(("double", "v2d", "v3d", "m33d", "m44d"), "d"),
    **dict.fromkeys(("int", "v2i", "v3i", "box2i", "rational"), "i"),
}
_LONGEST = 80  # characters of a metadata value that are shown


@dataclass(frozen=True)
class DecodedPicture:
    """A decoded file."""

    path: Path
    width: int  # of the display window, in px
    height: int  # in px
    # Name of each channel to its pixels [h, w]; parts and pages of another size have planes of
    # their own size
    planes: Mapping[str, NDArray[Any]]
    types: Mapping[str, str]  # name of each channel to its number type in the file
    # Exponent of the power law that decodes the colour, 1 for linear, None for sRGB
    gamma: float | None = 1.0
    associated: bool = True  # whether colour is multiplied by alpha
    primaries: Chromaticities = REC_709  # of the colour, as the file declares them
    # Attributes that describe the picture, as text
    metadata: Mapping[str, str] = field(default_factory=dict)
    # Layout of the file, as text; it changes no pixel
    layout: Mapping[str, str] = field(default_factory=dict)
    # Samples of deep parts, whose planes are the flattened picture: places y · 2^32 + x [N] under
    # the name "", and the values [N] by channel, sorted by place and depth
    samples: Mapping[str, NDArray[Any]] = field(default_factory=dict)


def read_picture(path: Path) -> DecodedPicture:
    """Decode all channels of a colour, depth or map file."""
    head = read_head(path)
    if is_exr(head):
        return _from_exr(path)
    if head.startswith(_PNG):
        _refuse_damaged_png(path)
    if (file_type := array_type(head)) and file_type not in NAMED:
        values = read_map(path)
        (height, width), kind = values.shape, values.dtype.name
        layout = {"format": file_type}
        return DecodedPicture(path, width, height, {"Z": values}, {"Z": kind}, layout=layout)
    return _from_raster(path, read_pages(path, wanted=_KNOWN, every_type=True))


def _refuse_damaged_png(path: Path) -> None:
    """Raise an error for a PNG with damaged chunks, some of which decoders skip."""
    data = memoryview(path.read_bytes())
    at, kind = len(_PNG), b""
    while at < len(data) and kind != b"IEND":
        size, kind = int.from_bytes(data[at : at + 4], "big"), bytes(data[at + 4 : at + 8])
        end = at + 8 + size
        if int.from_bytes(data[end : end + 4], "big") != zlib.crc32(data[at + 4 : end]):
            name = kind.decode("ascii", "backslashreplace")
            problem = f"is truncated or damaged (the checksum of its chunk {name} is wrong)"
            raise InputError("damaged", problem, "write or copy it again", path=path)
        at = end + 4
    if kind != b"IEND" or at != len(data):
        problem = "is damaged (it does not end as PNG does)"
        raise InputError("damaged", problem, "write or copy it again", path=path)


def of_planes(planes: dict[str, Any], name: str) -> DecodedPicture:
    """A picture of that name, made of channels [H, W] of linear light."""
    height, width = next(iter(planes.values())).shape
    types = {channel: plane.dtype.name for channel, plane in planes.items()}
    return DecodedPicture(Path(name), width, height, planes, types)


def planes_of(image: Any) -> dict[str, Any]:
    """Channels [H, W], half or float, of an array or a tensor; integers (sRGB) become linear."""
    values = np.asarray(array_of(image))
    if hasattr(image, "detach"):  # a tensor, whose channels come first
        values = values[0] if values.ndim == 4 and values.shape[0] == 1 else values
        values = np.moveaxis(values, 0, -1) if values.ndim == 3 else values
    shown = values.dtype in (np.uint8, np.uint16)  # in the order of files
    if shown:
        values = values / np.float32(np.iinfo(values.dtype).max)
    if values.dtype != np.float16:
        wide = values
        with np.errstate(over="ignore"):
            values = values.astype(np.float32)
        if np.any(np.isinf(values) & np.isfinite(wide)):
            raise ValueError(f"image must have values of 32 bits, got {np.nanmax(np.abs(wide)):g}")
    values = values[..., None] if values.ndim == 2 else values
    if values.ndim != 3 or values.shape[2] not in PLAIN_CHANNELS or not values.size:
        wanted = "[H, W], [H, W, C] or, as a tensor, [C, H, W] with 1 to 4 channels"
        raise ValueError(f"image must be {wanted}, got {list(np.shape(image))}")
    names = PLAIN_CHANNELS[values.shape[2]]
    planes = {name: np.ascontiguousarray(values[..., k]) for k, name in enumerate(names)}
    for name in names if shown else ():
        if name != "A":
            planes[name] = srgb_to_linear(planes[name]).astype(np.float32)
    return planes


def as_shown(picture: DecodedPicture) -> DecodedPicture:
    """A picture of linear light, sRGB-encoded."""
    planes = {n: p if n == "A" else linear_to_srgb(p) for n, p in picture.planes.items()}
    return replace(picture, planes=planes, gamma=None)


def color_layers(names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """The channels of each colour layer, without alpha: R, G, B, or Y, with the same prefix."""
    every = set(names)
    for prefix in dict.fromkeys(map(_prefix, names)):
        for wanted in (("R", "G", "B"), ("Y",)):
            layer = tuple(prefix + channel for channel in wanted)
            chroma = {prefix + channel for channel in ("X", "RY", "BY")} & every
            if set(layer) <= every and not (wanted == ("Y",) and chroma):
                yield layer
                break


def layers(names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """All channels of each layer: those with the same prefix."""
    by_prefix: dict[str, list[str]] = {}
    for name in names:
        by_prefix.setdefault(_prefix(name), []).append(name)
    yield from map(tuple, by_prefix.values())


def is_map(names: Sequence[str]) -> bool:
    """Whether a file holds a map of numbers, not light."""
    return set(names) <= {*NO_DEPTH, "Z"}


def in_linear_light(picture: DecodedPicture) -> DecodedPicture:
    """The picture with its colour as linear light, multiplied by alpha if it has one."""
    if picture.gamma == 1.0 and picture.associated:
        return picture
    planes = dict(picture.planes)
    for layer in color_layers(list(planes)):
        alpha = planes.get(_prefix(layer[0]) + "A")
        light = linear_light(
            np.stack([planes[name] for name in layer], axis=2),
            None if alpha is None else alpha[:, :, None],
            gamma=picture.gamma,
            associated=picture.associated,
        )
        planes |= {name: light[:, :, index] for index, name in enumerate(layer)}
    return replace(picture, planes=planes, gamma=1.0, associated=True)


def _prefix(name: str) -> str:
    """The prefix of a channel name, with its dot or slash."""
    return name[: max(name.rfind("."), name.rfind("/")) + 1]


def _place(name: str) -> tuple[str, int, str]:
    """The key to sort channels: R, G, B, A, then others by name."""
    own = name[len(_prefix(name)) :]
    return _prefix(name), "RGBA".find(own) if own in ("R", "G", "B", "A") else 4, own


def _from_exr(path: Path) -> DecodedPicture:
    headers = read_headers(path)
    counts = Counter(channel.name for header in headers for channel in header.channels)
    labels = Counter(header.label for header in headers)
    planes, types = {}, {}
    for part in read_parts(path, headers):
        label = part.header.label if labels[part.header.label] == 1 else str(part.header.index)
        for channel in part.header.channels:
            name = channel.name if counts[channel.name] == 1 else f"{label}/{channel.name}"
            if name in planes:
                problem = f"has two channels {channel.name}"
                raise InputError("duplicate", problem, "write it again with plain names", path=path)
            planes[name], types[name] = part.channels[channel.name], channel.type
    if not planes:
        raise InputError("empty", "has no channels", "write or copy it again", path=path)
    metadata = {
        f"{header.label}/{name}" if len(headers) > 1 else name: _spoken(raw)
        for header in headers
        for name, raw in header.attributes.items()
    }
    display = headers[0].display
    layout = {"format": "EXR", **_exr_layout(headers), "channel order": " ".join(planes)}
    ordered = {name: planes[name] for name in sorted(planes, key=_place)}
    return DecodedPicture(
        *(path, display.width, display.height, ordered, types),
        primaries=declared_primaries(headers[0].attributes),
        metadata=metadata,
        layout=layout,
        samples=_deep_samples(path, headers),
    )


def _deep_samples(path: Path, headers: Sequence[Header]) -> dict[str, NDArray[Any]]:
    """The samples of all deep parts by channel; empty if the file is flat."""
    found: dict[str, list[NDArray[Any]]] = {}
    for header in headers:
        if not header.deep:
            continue
        samples = read_deep_samples(path, header)
        rows, columns = np.divmod(samples.pixel.astype(np.int64), samples.window.width)
        places = (rows + samples.window.y0 << 32) + columns + samples.window.x0
        found.setdefault("", []).append(places)
        for channel in header.channels:
            found.setdefault(channel.name, []).append(samples.values[channel.name])
    return {name: np.concatenate(pieces) for name, pieces in found.items()}


def _exr_layout(headers: Sequence[Header]) -> dict[str, str]:
    layout = {}
    for header in headers:
        of = f" of part {header.label}" if len(headers) > 1 else ""
        codec = header.compression.partition(":")[0]
        layout[f"compression{of}"] = codec if codec == "none" else codec.upper()
        layout[f"data window{of}"] = str(header.data)
        layout[f"display window{of}"] = str(header.display)
    return layout


def _spoken(raw: Raw) -> str:
    """The value of an attribute in words, or its bytes if its type is unknown."""
    kind, value = raw
    if kind == "string":
        return value.decode("utf-8", "replace")
    code = _NUMBERS.get(kind, "")
    if not code or len(value) % struct.calcsize(code):
        return f"{kind} {value.hex()}"
    numbers = struct.unpack(f"<{len(value) // struct.calcsize(code)}{code}", value)
    return " ".join(f"{number:.9g}" for number in numbers)


def _from_raster(path: Path, pages: Sequence[Raster]) -> DecodedPicture:
    if any(page.deep for page in pages):
        raise InputError(
            "deep-data", "holds deep data, which is not compared", "flatten it first", path=path
        )
    planes: dict[str, NDArray[Any]] = {}
    types: dict[str, str] = {}
    for page in pages:
        dotted = f"{page.page}/" if page.page else ""
        names = [f"{dotted}{name}" for name in page.channels]
        if len(set(names)) < len(names):
            names = [f"{dotted}channel {index}" for index in range(len(names))]
        samples = read_samples(path, page.page)
        planes |= {name: unit(samples[:, :, index]) for index, name in enumerate(names)}
        types |= dict.fromkeys(names, page.type)
    first = pages[0]
    metadata = {name: str(tag.value)[:_LONGEST] for name, tag in first.tags.items()}
    if first.space.unheeded:
        metadata["colour space"] = first.space.unheeded
    return DecodedPicture(
        *(path, first.width, first.height, planes, types),
        gamma=first.space.gamma,
        associated=first.associated or not any(name.endswith("A") for name in planes),
        primaries=first.space.primaries,
        metadata=metadata,
        layout={"format": path.suffix.lower().lstrip(".").upper()},
    )

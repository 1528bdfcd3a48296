"""PNG, JPEG, TIFF, WEBP, HDR and HEIC files, decoded by OpenImageIO and pillow-heif.

Samples are returned as in the file: without colour conversion, and not multiplied by alpha (by
default OpenImageIO multiplies sRGB integers by alpha, which loses precision and is not linear).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.exr.channel_choice import require_part
from defocus_core.io.exr.header import no_exr
from defocus_core.io.images.color_space import CODES, ColorSpace, color_space
from defocus_core.io.images.primaries import PROFILE
from defocus_core.io.read_files import (
    check_size,
    damaged,
    decoded_rows,
    decoding,
    is_heic,
    needs_extra,
    opened_image,
    quiet,
    read_head,
)

_SAMPLES = {"uint8": "uint8", "uint16": "uint16", "half": "float", "float": "float"}
_SAMPLES["double"] = "float"
_WANTED = "EXR, PNG, JPEG, TIFF, WEBP or HDR"
_INTEGERS = ("uint8", "uint16")
_KINDS = ("png", "jpeg", "tiff", "hdr", "webp")
# First bytes of files of these kinds
_MAGIC = (b"\x89PNG", b"\xff\xd8\xff", b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"RIFF", b"#?")
# Exif orientations that swap rows and columns; those that then reverse rows; those that reverse
# columns.
SIDEWAYS, _BOTTOM_UP, _RIGHT_TO_LEFT = (5, 6, 7, 8), (3, 4, 7, 8), (2, 3, 6, 7)
_PART_OF_ANOTHER = 1 | 4  # bits of NewSubfileType: reduced in size, or a mask
_BEFORE_PIXELS = 1 << 12  # first bytes of a PNG, which have the chunk acTL if it is animated
_LAB = (8, 9, 10)  # of PhotometricInterpretation: decoded as if it were RGB
HEIC_DAMAGE = "is a damaged HEIC file"
OWN = "defocus:"  # prefix of attributes that say how defocus made a file
OWN_CHANNEL = "DocumentName"  # tag of a TIFF written by defocus that names its only channel
PLAIN_CHANNELS = {1: "Y", 2: "YA", 3: "RGB", 4: "RGBA"}  # names of channels by their number
_MOST_PAGES = 256  # of a TIFF: to find a page, all pages before it are read


@dataclass(frozen=True)
class Raster:
    """The header of one image of a file, turned upright by its Orientation."""

    width: int  # in px
    height: int  # in px
    channels: tuple[str, ...]  # names, upper case for colour and alpha: R, G, B, A or Y
    type: str  # sample type in OpenImageIO's words
    space: ColorSpace  # how its samples become light
    associated: bool = False  # whether colour is already multiplied by alpha
    deep: bool = False  # whether it holds deep data, which has no samples
    orientation: int = 1  # the Exif orientation that was undone, 1 to 8; 1 is upright
    page: int = 0  # index of the image in its file: a TIFF may have several
    bits: int = 0  # bits of each sample, if the file has fewer than the type; else 0
    whole: bool = True  # False for a thumbnail or mask of another image
    tags: Mapping[str, Tag] = field(default_factory=dict)  # its metadata on camera and author


# Remedies for video and raw files, by suffix.
_CONVERSIONS = {
    **dict.fromkeys(
        (".mp4", ".mov", ".mkv", ".avi", ".webm"),
        "write its frames as files, and render them as a pattern like 'shot.####.png'",
    ),
    **dict.fromkeys(
        (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2"),
        "develop it to a 16-bit TIFF",
    ),
}


def read_pages(path: Path, *, wanted: str = _WANTED, every_type: bool = False) -> list[Raster]:
    """The headers of all images of a file.

    `wanted`: the types that errors propose; `every_type`: whether files of any type are read.
    """
    if is_heic(read_head(path)):
        return [_heic_page(path)]
    with decoding(path, "cannot be read"), quiet(), _open(path, wanted) as file:
        if not every_type and file.format_name() not in _KINDS:
            problem = f"is of type {file.format_name().upper()}, which is not read"
            raise InputError("wrong-type", problem, f"use {wanted}", path=path)
        pages = [_raster(path, file, 0)]
        while file.seek_subimage(len(pages), 0):
            if len(pages) == _MOST_PAGES:
                problem = f"has more than {_MOST_PAGES} pages"
                remedy = "split it into several files"
                raise InputError("too-large", problem, remedy, path=path)
            pages.append(_raster(path, file, len(pages)))
        return pages


def choose_page(path: Path, pages: Sequence[Any], part: int | None) -> Any:
    """The only image of a file, or the one with the index ``part``.

    Without a part, the only one that is no thumbnail or mask; several are an InputError. `pages`:
    headers, of type `Raster` or `Header`.
    """
    if len(pages) == 1:  # a part is ignored, as in EXR files
        return pages[0]
    if part is not None:
        require_part(path, part, len(pages))
        return pages[part]
    whole = [page for page in pages if page.whole]
    if len(whole) == 1:
        return whole[0]
    remedy = "choose one with ‹part›, counted from 0"
    raise InputError("ambiguous", f"has {len(pages)} pages", remedy, path=path)


def read_samples(path: Path, page: int = 0) -> NDArray[Any]:
    """The samples of an image of a file, turned upright: uint8, uint16 or float32 [H, W, C]."""
    if is_heic(read_head(path)):
        file = open_heic(path)
        with decoding(path, HEIC_DAMAGE), quiet():
            return np.atleast_3d(np.asarray(file))
    with decoding(path, "cannot be read"), quiet(), _open(path, _WANTED) as file:
        file.seek_subimage(page, 0)
        spec = file.spec()
        kind = _SAMPLES.get(str(spec.format))
        if kind is None:
            problem = f"has samples of type {spec.format}"
            remedy = "save it with 8, 16 or float samples"
            raise InputError("unsupported", problem, remedy, path=path)
        rows, channels = (spec.y, spec.y + spec.height), (0, spec.nchannels)
        samples = decoded_rows(path, file, page, rows, channels, kind)
    turned: NDArray[Any] = upright(samples, spec.get_int_attribute("Orientation", 1))
    return turned


def open_heic(path: Path) -> Any:
    """A HEIC file opened by pillow-heif; pixels are decoded on access."""
    try:
        import pillow_heif
    except ImportError:
        raise needs_extra(path, "a HEIC", "pillow-heif", "heif") from None
    with decoding(path, HEIC_DAMAGE), quiet():
        return pillow_heif.open_heif(str(path))


def _heic_page(path: Path) -> Raster:
    """The header of the picture of a HEIC photograph, which libheif has turned upright."""
    import OpenImageIO as oiio  # noqa: N813

    file = open_heic(path)
    (width, height), channels = file.size, tuple(file.mode.replace("L", "Y"))
    spec = oiio.ImageSpec(width, height, len(channels), "uint8")
    spec.alpha_channel = len(channels) - 1 if channels[-1] == "A" else -1
    if data := file.info.get("icc_profile"):
        data = np.frombuffer(bytes(data), np.uint8)
        spec.attribute(PROFILE, oiio.TypeDesc(f"uint8[{len(data)}]"), data)
    if codes := file.info.get("nclx_profile"):
        both = codes["color_primaries"], codes["transfer_characteristics"]
        spec.attribute(CODES, oiio.TypeDesc("int[4]"), (*both, 0, 1))
    space = color_space(spec)
    space = replace(space, note=f"HEIC, {space.note}")
    return Raster(width, height, channels, "uint8", space)


@contextmanager
def _open(path: Path, formats: str) -> Iterator[Any]:
    """Yield the open `ImageInput` of a file; errors propose ``formats``."""
    head = read_head(path)
    if path.suffix.lower() == ".exr":
        raise no_exr(path)

    def refusal(why: str) -> InputError:
        if "format reader" not in why and head.startswith(_MAGIC):
            return damaged(path, why)
        why = "unknown format" if "format reader" in why else why
        problem = f"is not an image that can be read ({why})"
        remedy = _CONVERSIONS.get(path.suffix.lower(), f"use {formats}")
        return InputError("unreadable", problem, remedy, path=path)

    with opened_image(path, refusal) as file:
        yield file


def upright(stored: Any, orientation: int) -> Any:
    """A stored array [H, W, …], turned upright by its orientation (EXIF 1 to 8)."""
    turned = stored.swapaxes(0, 1) if orientation in SIDEWAYS else stored
    turned = turned[::-1] if orientation in _BOTTOM_UP else turned
    return turned[:, ::-1] if orientation in _RIGHT_TO_LEFT else turned


def _raster(path: Path, file: Any, page: int) -> Raster:
    spec = file.spec()
    width, height = spec.width, spec.height
    check_size(path, width, height, spec.pixel_bytes(True))
    stored = spec.get_int_attribute("tiff:PhotometricInterpretation", 1)
    if stored in _LAB:
        raise InputError("unsupported", "stores L*a*b*", "save it as RGB", path=path)
    if stored == 0 and spec.format != "uint8":
        problem = f"stores white as 0 in {spec.format}, which is decoded as its negative"
        raise InputError("unsupported", problem, "save it with black as 0", path=path)
    orientation = spec.get_int_attribute("Orientation", 1)
    if orientation in SIDEWAYS:
        width, height = height, width
    head, bits = read_head(path, _BEFORE_PIXELS), spec.get_int_attribute("oiio:BitsPerSample", 0)
    if head.startswith(b"\x89PNG") and spec.nchannels == 1:
        bits = head[24]
    if head.startswith(b"\x89PNG") and b"acTL" in head:
        problem = "is an animated PNG, of which only the first frame is read"
        raise InputError("unsupported", problem, "save its frames as files", path=path)
    # OpenImageIO stretches the numbers of fewer bits to 8 or 16
    is_stretched = 0 < bits < 8 * spec.format.size() and str(spec.format) in _INTEGERS
    return Raster(
        *(width, height, tuple(_canonical(spec)), str(spec.format)),
        color_space(spec),
        associated=not spec.get_int_attribute("oiio:UnassociatedAlpha", 0),
        deep=bool(spec.deep),
        orientation=orientation,
        page=page,
        bits=bits if is_stretched else 0,
        whole=not spec.get_int_attribute("tiff:subfiletype") & _PART_OF_ANOTHER,
        tags=tags_of(spec),
    )


def _canonical(spec: Any) -> Iterator[str]:
    """Yield names of the channels: Y for grey, A for alpha, else the file's own.

    A map written by this program has the name of its channel.
    """
    program, _, own = spec.get_string_attribute(OWN_CHANNEL).rpartition(":")
    if spec.nchannels == 1 and f"{program}:" == OWN and own.isidentifier():
        yield own
        return
    for index, name in enumerate(spec.channelnames):
        if index == spec.alpha_channel:
            yield "A"
        elif spec.nchannels <= 2 and index == 0:
            yield "Y"
        else:
            yield name


# Tags by OpenImageIO's names; other attributes describe how the file is encoded.
_TAG_GROUPS = ("Exif:", "GPS:", "IPTC:")
_TAGS = {"Make", "Model", "Artist", "Copyright", "ImageDescription", "DateTime", "FNumber"}
_TAGS |= {"ExposureTime"}
# Not copied: the output may differ from them, or their structure is unknown.
_NO_TAGS = ("Exif:PixelXDimension", "Exif:PixelYDimension", "Exif:ColorSpace", "Exif:MakerNote")
# Bytes of all tags as text: JPEG has room for 64 KB, and its encoder ends the process if they are
# more.
_MAX_BYTES = 2**14


class Tag(NamedTuple):
    """An EXIF, GPS or IPTC attribute under OpenImageIO's name: text, a number or some numbers."""

    value: str | float | tuple[float, ...]


def tags_of(spec: Any) -> dict[str, Tag]:
    """The tags of an OpenImageIO ``spec`` by name, shortest first, as many as fit in a JPEG."""
    tags = {
        each.name: Tag(_text(each.value) if isinstance(each.value, str) else each.value)
        for each in spec.extra_attribs
        if (each.name in _TAGS or each.name.startswith(_TAG_GROUPS))
        and "rational" not in str(each.type)  # OpenImageIO makes floats of those of EXIF
        and each.name not in _NO_TAGS
        and isinstance(each.value, str | int | float | tuple)
    }
    sizes = {name: len(str(tag.value).encode()) for name, tag in tags.items()}
    shortest_first = sorted(tags, key=sizes.__getitem__)
    totals = accumulate(map(sizes.__getitem__, shortest_first))
    return {
        n: tags[n] for n, total in zip(shortest_first, totals, strict=True) if total <= _MAX_BYTES
    }


def _text(text: str) -> str:
    """The text of a tag; bytes that are not UTF-8 are read as Latin-1, as older cameras write."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return text.encode(errors="surrogateescape").decode("latin-1")
    return text


def set_tag(spec: Any, name: str, tag: Tag) -> None:
    """Set a tag in an OpenImageIO ``spec``."""
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    value = tag.value
    if isinstance(value, tuple):
        kind = "int" if all(isinstance(number, int) for number in value) else "float"
        spec.attribute(name, oiio.TypeDesc(f"{kind}[{len(value)}]"), value)
    else:
        spec.attribute(name, value)

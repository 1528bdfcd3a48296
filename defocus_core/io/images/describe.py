"""Size, channels and parts of an image file, from its header."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from defocus_core.io.exr.header import Channel, Header, is_exr, read_headers
from defocus_core.io.exr.windows import Window
from defocus_core.io.read_files import once, read_head

if TYPE_CHECKING:
    from defocus_core.io.array_files import ArrayEntry

# Bytes of a number by type; the types are those of `Channel.type`.
SAMPLE_BYTES = {"half": 2, "uint": 4, "float": 4, "double": 8}
SAMPLE_BYTES |= {f"{kind}{8 * n}": n for kind in ("uint", "int", "float") for n in (1, 2, 4, 8)}
# A file with more numbers than the first, and than the second per byte of the file, is nearly
# empty: real pictures do not compress so much.
MOST_NUMBERS, NUMBERS_OF_A_BYTE = 2**26, 32


@dataclass(frozen=True)
class FileInfo:
    """The contents of the header of a colour or depth file."""

    path: Path
    width: int  # of the picture shown, in px
    height: int  # of the picture shown, in px
    parts: tuple[Header, ...]  # one, except in some EXR and TIFF files
    pixels: int  # greatest number that is read, with those beyond the picture shown

    @property
    def deep(self) -> bool:
        """Whether any part has deep pixels."""
        return any(part.deep for part in self.parts)

    @property
    def names(self) -> list[str]:
        """The names of the channels of all parts."""
        return [channel.name for part in self.parts for channel in part.channels]

    @property
    def numbers(self) -> int:
        """The number of samples in all channels, if each were as large as the largest part."""
        return self.pixels * len(self.names)

    @property
    def nearly_empty(self) -> str:
        """A note in words if the header claims more numbers than the file can hold; else empty."""
        size = self.path.stat().st_size
        if self.numbers <= max(MOST_NUMBERS, NUMBERS_OF_A_BYTE * size):
            return ""
        return f"{self.numbers / 10**6:.0f} million numbers in a file of {size / 10**6:.1f} MB"


@once
def describe(path: Path) -> FileInfo:
    """Size, channels and parts of a colour or depth file; no pixel is decoded."""
    head = read_head(path, 32)
    if is_exr(head):
        headers = read_headers(path)
        shown = headers[0].display
        frames = (h.display.grown(h.data.overscan(h.display)) for h in headers)
        maximum = max(frame.width * frame.height for frame in frames)
        return FileInfo(path, shown.width, shown.height, headers, maximum)
    from defocus_core.io import array_files
    from defocus_core.io.images.raster import read_pages

    if array_files.array_type(head):
        return _of_arrays(path, array_files.read_entries(path))
    pages = read_pages(path, wanted="EXR, PNG, JPEG, TIFF, WEBP, HDR, PFM or NPY")
    parts = tuple(
        _part([(name, p.type) for name in p.channels], p.width, p.height, p.page, p.deep, p.whole)
        for p in pages
    )
    first = next((page for page in pages if page.whole), pages[0])
    return FileInfo(path, first.width, first.height, parts, first.width * first.height)


def _of_arrays(path: Path, entries: Mapping[str, ArrayEntry]) -> FileInfo:
    """The information on a file of arrays; its size is that of the first array."""
    from defocus_core.io.array_files import squeezed_shape

    channels, sizes = [], []
    for name, entry in entries.items():
        shape, is_lone = squeezed_shape(entry.shape), len(entry.shape) == 2 and len(entries) == 1
        axes = "" if is_lone else f" {'×'.join(map(str, entry.shape))}"
        channels.append((f"{name or 'Z'}{axes}", entry.dtype))
        sizes.append(shape[:2] if len(shape) == 3 and shape[2] <= 4 else shape[-2:])
    (height, width), maximum = sizes[0], max(map(math.prod, sizes))
    return FileInfo(path, width, height, (_part(channels, width, height),), maximum)


def _part(
    channels: Sequence[tuple[str, str]],
    width: int,
    height: int,
    index: int = 0,
    deep: bool = False,
    whole: bool = True,
) -> Header:
    """A page or an array as an EXR part; `channels`: name and type; others: as in `Header`."""
    frame = Window(0, 0, width - 1, height - 1)
    named = tuple(Channel(name, kind, name) for name, kind in channels)
    return Header(index, "", named, frame, frame, deep=deep, whole=whole)

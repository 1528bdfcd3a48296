"""Size, channels and parts of an image file, from its header."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from defocus_core.io.exr.header import Channel, Header, is_exr, read_headers
from defocus_core.io.exr.windows import Window
from defocus_core.io.safe_files import once, read_head

if TYPE_CHECKING:
    from defocus_core.io.array_files import ArrayEntry

# Bytes of a number of each type, as the parts of a file name it.
SAMPLE_BYTES = {"half": 2, "uint": 4, "float": 4, "double": 8}
SAMPLE_BYTES |= {f"{kind}{8 * n}": n for kind in ("uint", "int", "float") for n in (1, 2, 4, 8)}
# A file of more numbers than either of these is nearly empty: real pictures pack less tightly.
MOST_NUMBERS, NUMBERS_OF_A_BYTE = 2**26, 32


@dataclass(frozen=True)
class FileInfo:
    """The header of a colour or depth file."""

    path: Path
    width: int  # of the picture shown, in px
    height: int  # in px
    parts: tuple[Header, ...]  # one, except in some EXR and TIFF files
    pixels: int  # as many as are read at most, with those beyond the picture shown

    @property
    def deep(self) -> bool:
        """Whether a part of it has deep pixels."""
        return any(part.deep for part in self.parts)

    @property
    def names(self) -> list[str]:
        """Of the channels of all parts."""
        return [channel.name for part in self.parts for channel in part.channels]

    @property
    def numbers(self) -> int:
        """Of all channels, as many as are read at most."""
        return self.pixels * len(self.names)

    @property
    def nearly_empty(self) -> str:
        """How many numbers a small file claims that can hardly tell a picture; empty of others."""
        size = self.path.stat().st_size
        if self.numbers <= max(MOST_NUMBERS, NUMBERS_OF_A_BYTE * size):
            return ""
        return f"{self.numbers / 10**6:.0f} million numbers in a file of {size / 10**6:.1f} MB"


@once
def describe(path: Path) -> FileInfo:
    """The header of a colour or depth file, of which no pixel is decoded."""
    head = read_head(path, 32)
    if is_exr(head):
        headers = read_headers(path)
        shown = headers[0].display
        frames = (h.display.grown(h.data.overscan(h.display)) for h in headers)
        maximum = max(frame.width * frame.height for frame in frames)
        return FileInfo(path, shown.width, shown.height, headers, maximum)
    return _of_no_exr(path, head)


def _of_no_exr(path: Path, head: bytes) -> FileInfo:
    from defocus_core.io import array_files as arrays
    from defocus_core.io.images.raster import read_pages

    if arrays.array_type(head):
        return _arrays(path, arrays.read_entries(path))
    known = "EXR, PNG, JPEG, TIFF, WEBP, HDR, PFM or NPY"
    pages = read_pages(path, wanted=known)
    parts = tuple(
        replace(
            _part(p.page, [(name, p.type) for name in p.channels], p.width, p.height),
            deep=p.deep,
            whole=p.whole,
        )
        for p in pages
    )
    first = next((page for page in pages if page.whole), pages[0])
    return FileInfo(path, first.width, first.height, parts, first.width * first.height)


def _arrays(path: Path, entries: Mapping[str, ArrayEntry]) -> FileInfo:
    """The arrays of a file: its size is that of the first."""
    channels, sizes = [], []
    for name, entry in entries.items():
        shape = entry.shape
        while len(shape) > 3 and shape[-1] == 1:
            shape = shape[:-1]
        axes = "" if len(shape) == 2 and len(entries) == 1 else f" {'×'.join(map(str, shape))}"
        channels.append((f"{name or 'Z'}{axes}", entry.dtype))
        sizes.append(shape[:2] if len(shape) == 3 and shape[2] <= 4 else shape[-2:])
    (height, width), maximum = sizes[0], max(map(math.prod, sizes))
    part = _part(0, channels, width, height)
    return FileInfo(path, width, height, (part,), maximum)


def _part(index: int, channels: Sequence[tuple[str, str]], width: int, height: int) -> Header:
    """A page or an array, of channels by name and type, as a part."""
    named, frame = (
        [Channel(*each, each[0]) for each in channels],
        Window(0, 0, width - 1, height - 1),
    )
    return Header(index, "", tuple(named), frame, frame, deep=False)

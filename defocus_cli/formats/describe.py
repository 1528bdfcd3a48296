"""Size, channels and parts of an image file, from its header."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from defocus_cli.formats.exr_header import is_exr, read_headers
from defocus_cli.formats.float_maps import is_float_map, read_float_map
from defocus_cli.formats.raster import read_pages
from defocus_cli.system.safe_files import read_head

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True)
class PartInfo:
    """One part of an EXR file, or page of a TIFF.

    Attributes:
        index: from 0.
        name: empty where it has none.
        channels: as (name, type).
        deep: whether its pixels are deep.
        whole: whether it is no thumbnail or mask of another one.
    """

    index: int
    name: str
    channels: tuple[tuple[str, str], ...]
    deep: bool
    whole: bool = True


@dataclass(frozen=True)
class FileInfo:
    """What a file's header says.

    Attributes:
        path: the file.
        width: of the picture shown, in px.
        height: in px.
        parts: one, except in some EXR and TIFF files.
        at_once: whether its decoder may hold all of it; else it is read in pieces.
    """

    path: Path
    width: int
    height: int
    parts: tuple[PartInfo, ...]
    at_once: bool


def describe(path: Path) -> FileInfo:
    """What a colour or depth file holds, without decoding its pixels.

    Raises:
        InputError: the file is missing, damaged or of no known kind.
    """
    head = read_head(path)
    if is_exr(head):
        headers = read_headers(path)
        parts = tuple(
            PartInfo(h.index, h.name, tuple((c.name, c.type) for c in h.channels), h.deep)
            for h in headers
        )
        shown = headers[0].display
        return FileInfo(path, shown.width, shown.height, parts, at_once=False)
    if is_float_map(head):
        values = read_float_map(path, integers=True).values
        floats = PartInfo(0, "", (("Z", values.dtype.name),), deep=False)
        return FileInfo(path, values.shape[1], values.shape[0], (floats,), at_once=False)
    known = "EXR, PNG, JPEG, TIFF, HDR, PFM or NPY"
    pages = read_pages(path, wanted=known)
    parts = tuple(
        PartInfo(p.page, "", tuple((name, p.type) for name in p.channels), p.deep, p.whole)
        for p in pages
    )
    first = next((page for page in pages if page.whole), pages[0])
    at_once = any(page.at_once for page in pages)
    return FileInfo(path, first.width, first.height, parts, at_once)

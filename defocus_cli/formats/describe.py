"""Size, channels and parts of an image file, from its header."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from defocus_cli.formats.bare_arrays import bare_type, read_bare
from defocus_cli.formats.containers import container_type, read_entries
from defocus_cli.formats.exr_header import is_exr, read_headers
from defocus_cli.formats.float_maps import is_float_map, read_float_map
from defocus_cli.formats.photo_depth import is_heic, read_heic
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
    head = read_head(path, 32)
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
    if bare_type(head):
        values = read_bare(path)
        floats = PartInfo(0, "", (("Z", values.dtype.name),), deep=False)
        return FileInfo(path, values.shape[1], values.shape[0], (floats,), at_once=False)
    if container_type(head):
        return _container(path)
    if is_heic(head):
        values = read_heic(path).values
        image = PartInfo(0, "", (("depth", values.dtype.name),), deep=False)
        return FileInfo(path, values.shape[1], values.shape[0], (image,), at_once=True)
    known = "EXR, PNG, JPEG, TIFF, HDR, PFM or NPY"
    pages = read_pages(path, wanted=known)
    parts = tuple(
        PartInfo(
            *(page.page, "", tuple((name, page.type) for name in page.channels)),
            *(page.deep, page.whole),
        )
        for page in pages
    )
    first = next((page for page in pages if page.whole), pages[0])
    at_once = any(page.at_once for page in pages)
    return FileInfo(path, first.width, first.height, parts, at_once)


def _container(path: Path) -> FileInfo:
    """The arrays of a container: its channels are those, its size that of the first."""
    entries = read_entries(path)
    arrays = tuple(
        (f"{name} {'×'.join(map(str, entry.shape))}", entry.dtype)
        for name, entry in entries.items()
    )
    shape = next(iter(entries.values())).shape
    height, width = shape[:2] if len(shape) == 3 and shape[2] <= 4 else shape[-2:]
    part = PartInfo(0, "", arrays, deep=False)
    return FileInfo(path, width, height, (part,), at_once=True)

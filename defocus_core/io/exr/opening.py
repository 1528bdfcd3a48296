"""Opening of an OpenEXR file for the pixels of its flat parts."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from defocus_core.errors import first_line
from defocus_core.io.damage import damaged
from defocus_core.io.exr.header import Header
from defocus_core.system.interrupts import put_off


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """OpenImageIO's input: to open a file reads the headers of all its parts.

    Raises:
        InputError: the file is damaged.
    """
    with put_off():
        import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    file = oiio.ImageInput.open(str(path))
    if not file:
        raise damaged(path, first_line(path, oiio.geterror()))
    try:
        yield file
    finally:
        file.close()
        oiio.geterror()  # or the next file would be blamed


def seek(path: Path, file: Any, header: Header) -> None:
    """Turn an open file to a part, whose data window is the header's.

    Raises:
        InputError: the file is damaged.
    """
    if not file.seek_subimage(header.index, 0):
        raise damaged(path, first_line(path, file.geterror()))
    spec, (x0, y0, x1, y1) = file.spec(), header.data
    if (spec.x, spec.y, spec.width, spec.height) != (x0, y0, x1 - x0 + 1, y1 - y0 + 1):
        raise damaged(path, "two sizes in its header")

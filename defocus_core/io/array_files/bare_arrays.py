"""Depth files that are rows of float32 behind a short header or none: .dpt, COLMAP, headerless.

Sintel's .dpt (its ``sintel_io.py``): the float 202021.25, width, height, then rows, all little
endian. COLMAP (``scripts/python/read_write_dense.py``): ``width&height&channels&``, then all of
the numbers, the rows of a channel one after another.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.damage import AGAIN
from defocus_core.io.safe_files import check_size, read_head

_DPT_MAGIC = b"PIEH"  # 202021.25 as float32
_COLMAP = re.compile(rb"(\d{1,7})&(\d{1,7})&(\d{1,3})&")


def bare_type(head: bytes) -> str:
    """DPT or COLMAP for a file that starts with ``head``; empty for any other."""
    if head.startswith(_DPT_MAGIC):
        return "DPT"
    return "COLMAP" if _COLMAP.match(head) else ""


def read_bare(path: Path) -> NDArray[Any]:
    """Map a .dpt or COLMAP file into memory: float32 [H, W]."""
    head = read_head(path, 32)
    if head.startswith(_DPT_MAGIC):
        if len(head) < 12:
            raise InputError("damaged", "is truncated in its header", AGAIN, path=path)
        width, height = struct.unpack("<2i", head[4:12])
        return _rows(path, 12, width, height)
    header = _COLMAP.match(head)
    assert header is not None
    width, height, channels = (int(number) for number in header.groups())
    if channels != 1:
        problem = f"has {channels} channels; depth is one"
        remedy = "name a file of depth_maps, not of normal_maps"
        raise InputError("not-one-channel", problem, remedy, path=path)
    return _rows(path, header.end(), width, height)


def read_headerless(path: Path, size: tuple[int, int]) -> NDArray[Any]:
    """Map float32 little-endian rows without a header into memory: [H, W]."""
    read_head(path)
    return _rows(path, 0, *size)


def _rows(path: Path, start: int, width: int, height: int) -> NDArray[Any]:
    check_size(path, width, height, 4)
    there, wanted = path.stat().st_size - start, width * height * 4
    if there != wanted:
        problem = f"has {there} bytes of pixels, and {width}×{height} px of float32 are {wanted}"
        raise InputError("wrong-size", problem, AGAIN, path=path)
    return np.memmap(path, "<f4", "r", start, (height, width))

"""Depth files that are bare arrays of numbers: PFM and NPY.

PFM (netpbm): ``Pf``, width, height, scale, then rows from bottom to top; a negative scale means
little endian. OpenImageIO returns the rows upside down or not depending on how it is asked.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, reason
from defocus_core.io.damage import AGAIN, damaged
from defocus_core.io.safe_files import check_size, read_head

NPY_MAGIC = b"\x93NUMPY"
# The scale ends with its line, or with one blank: the byte of a pixel may look like a blank too.
_PFM_HEADER = re.compile(rb"(Pf|PF)\s+(\S+)\s+(\S+)\s+(\S+)(?:[ \t\r]*\n|\s)")


@dataclass(frozen=True)
class FloatMap:
    """Shape, type and, lazily, the values of a PFM or NPY file."""

    values: NDArray[Any]  # float array [H, W], memory mapped; integers only if they were allowed
    format: str


def is_float_map(head: bytes) -> bool:
    """Whether a file that starts with ``head`` is one of these."""
    return head[:2] in (b"Pf", b"PF") or head.startswith(NPY_MAGIC)


def read_float_map(path: Path, *, integers: bool = False) -> FloatMap:
    """Map a PFM or NPY file of one map into memory."""
    if not read_head(path).startswith(NPY_MAGIC):
        return FloatMap(_pfm(path), "PFM")
    values = read_npy(path, integers=integers)
    while values.ndim > 2 and values.shape[0] == 1:
        values = values[0]
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[:, :, 0]
    if values.ndim != 2:
        shape = " × ".join(str(n) for n in values.shape) or "no"
        problem = f"has {shape} numbers, not height × width"
        remedy = "save one map a file, or say its ‹depth-format›"
        raise InputError("wrong-shape", problem, remedy, path=path)
    return FloatMap(values, "NPY")


def read_npy(path: Path, *, integers: bool) -> NDArray[Any]:
    """Map an NPY file of any number of axes into memory."""
    try:
        # Mapped, since np.load would allocate whatever size the header claims.
        with np.errstate(over="raise"):  # of a size that the header claims
            values: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:
        if "Python objects" in str(error):
            problem, remedy = "holds Python objects, not numbers", "save an array of floats"
            raise InputError("not-numbers", problem, remedy, path=path) from error
        raise damaged(path, reason(error), "is a truncated or damaged NPY file") from error
    if values.dtype.kind not in ("fiu" if integers else "f"):
        problem = f"holds {values.dtype} numbers, whose unit is unknown"
        whole = values.dtype.kind in "iu"
        remedy = "say ‹depth-unit› mm" if whole else "save floats"
        raise InputError("unknown-unit", problem, remedy, path=path)
    if values.size == 0 or values.ndim < 2:
        shape = " × ".join(str(n) for n in values.shape) or "no"
        problem = f"has {shape} numbers, not height × width"
        remedy = "save one map a file, or say its ‹depth-format›"
        raise InputError("wrong-shape", problem, remedy, path=path)
    check_size(path, values.shape[-1], values.size // values.shape[-1], values.itemsize)
    return values


def _pfm(path: Path) -> NDArray[Any]:
    header = _PFM_HEADER.match(read_head(path, 256))
    try:
        if header is None:
            raise ValueError("no width, height and scale")
        width, height, scale = int(header[2]), int(header[3]), float(header[4])
        if not math.isfinite(scale) or scale == 0:
            raise ValueError(f"scale {scale:g}")
    except ValueError as error:
        raise damaged(path, str(error), "has a damaged PFM header") from error
    if header[1] == b"PF":
        problem = "is a colour PFM (PF); depth has one channel (Pf)"
        raise InputError("not-one-channel", problem, "save it grey", path=path)
    check_size(path, width, height, 4)
    held, wanted = path.stat().st_size - header.end(), width * height * 4
    if held < wanted:
        problem = f"is truncated: {held} bytes of pixels, {wanted} expected"
        raise InputError("damaged", problem, AGAIN, path=path)
    if held > wanted:
        problem = f"holds {held - wanted} bytes more than the {wanted} of pixels of its header"
        raise InputError("damaged", problem, AGAIN, path=path)
    dtype = np.dtype("<f4" if scale < 0 else ">f4")
    return np.memmap(path, dtype, "r", header.end(), (height, width))[::-1]

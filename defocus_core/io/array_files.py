"""Arrays of numbers in files: PFM, NPY, .dpt, COLMAP and headerless rows; NPZ, HDF5 and MATLAB.

PFM (netpbm): ``Pf``, width, height, scale, then rows from bottom to top; a negative scale means
little endian. OpenImageIO returns the rows upside down or not depending on how it is asked.
Sintel's .dpt (its ``sintel_io.py``): the float 202021.25, width, height, then rows, all little
endian. COLMAP (``scripts/python/read_write_dense.py``): ``width&height&channels&``, then rows.
MATLAB 7.3 is HDF5 behind a block of text, its axes in reverse order as HDF5 shows them. MATLAB 5
(MathWorks, "MAT-File Format") is a list of elements, each of a type, a length and data.
"""

from __future__ import annotations

import math
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, reason
from defocus_core.io.safe_files import (
    AGAIN,
    check_size,
    damaged,
    decoding,
    needs_extra,
    read_head,
)
from defocus_core.system.text import times

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
        raise wrong_shape(path, values.shape)
    return FloatMap(values, "NPY")


def wrong_shape(path: Path, shape: tuple[int, ...]) -> InputError:
    """The error for an array that is no map."""
    problem = f"has {times(shape)} numbers, not height × width"
    remedy = "save one map a file, or say its ‹depth-format›"
    return InputError("wrong-shape", problem, remedy, path=path)


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
        raise wrong_shape(path, values.shape)
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


HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_MATLAB_5, _MATLAB_73 = b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"
_NUMERIC = "fiu"  # kinds of NumPy types
# MATLAB 5: classes of arrays of numbers, and types of elements: numbers, array and compressed.
_CLASSES = {"double": "float64", "single": "float32", "logical": "uint8"}
_CLASSES |= {f"{sign}int{bits}": f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32)}
_TYPES, _MATRIX, _COMPRESSED = {*range(1, 8), 9, 12, 13}, 14, 15
_MAX_ARRAYS = 4096
_LONGEST_HEADER = 2**16  # bytes
_LARGEST_MATLAB = 2**28  # bytes, since it is decompressed at once


@dataclass(frozen=True)
class ArrayEntry:
    """An array in a container."""

    shape: tuple[int, ...]  # of all of it
    dtype: str  # as NumPy names it, like ``float32``
    # Reads it, or with a number only that entry of its first axis
    load: Callable[[int | None], NDArray[Any]]


def container_type(head: bytes) -> str:
    """NPZ, HDF5 or MATLAB for a file that starts with ``head``; empty for any other."""
    if head.startswith(b"PK\x03\x04"):
        return "NPZ"
    if head.startswith((HDF5_MAGIC, _MATLAB_73[:16])):
        return "HDF5"
    return "MATLAB" if head.startswith(_MATLAB_5[:16]) else ""


def read_entries(path: Path) -> dict[str, ArrayEntry]:
    """The arrays of numbers in a container, by name, of two axes or more; none is loaded."""
    kind = container_type(read_head(path))
    list_entries = {"NPZ": _npz, "HDF5": _hdf5, "MATLAB": _matlab}[kind]
    with decoding(path, f"is a truncated or damaged {kind} file"):
        every = list(islice(list_entries(path), _MAX_ARRAYS + 1))
    if len(every) > _MAX_ARRAYS:
        problem = f"holds more than {_MAX_ARRAYS} arrays"
        remedy = "save one array of all frames, or several files"
        raise InputError("too-large", problem, remedy, path=path)
    entries = {
        name: entry for name, entry in every if len(entry.shape) >= 2 and min(entry.shape) > 0
    }
    if not entries:
        problem = f"is a {kind} file without an array of numbers"
        raise InputError("no-such-channel", problem, "check its name", path=path)
    return entries


def checked(path: Path, shape: tuple[int, ...], itemsize: int) -> None:
    """Refuse an array whose header claims more than its file could hold."""
    check_size(path, shape[-1], math.prod(shape[:-1]), itemsize)


def _loading(path: Path, load: Callable[[int | None], NDArray[Any]]) -> Any:
    """A loader that raises InputError if the file is damaged."""

    def guarded(index: int | None) -> NDArray[Any]:
        with decoding(path):
            return load(index)

    return guarded


def _npz(path: Path) -> Iterator[tuple[str, ArrayEntry]]:
    with zipfile.ZipFile(path) as archive:
        members = [name for name in archive.namelist() if name.endswith(".npy")]
        for member in members:
            with archive.open(member) as stored:  # a member may claim a header of any length
                file = BytesIO(stored.read(_LONGEST_HEADER))
                version = np.lib.format.read_magic(file)
                read_header = {
                    (1, 0): np.lib.format.read_array_header_1_0,
                    (2, 0): np.lib.format.read_array_header_2_0,
                }[version]
                shape, _, dtype = read_header(file)
            if dtype.kind not in _NUMERIC:
                shape = ()  # which has no axes
            load = partial(_npz_array, path, member, shape, dtype.itemsize)
            yield member.removesuffix(".npy"), ArrayEntry(shape, dtype.name, _loading(path, load))


def _npz_array(
    path: Path, member: str, shape: tuple[int, ...], itemsize: int, index: int | None
) -> NDArray[Any]:
    checked(path, shape, itemsize)
    with zipfile.ZipFile(path) as archive, archive.open(member) as file:
        values: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    return values if index is None else values[index]


def _hdf5(path: Path) -> Iterator[tuple[str, ArrayEntry]]:
    try:
        import h5py
    except ImportError:
        raise needs_extra(path, "an HDF5", "h5py", "hdf5") from None
    entries: list[tuple[str, ArrayEntry]] = []

    def load(name: str, index: int | None) -> NDArray[Any]:
        with h5py.File(path, "r") as file:
            dataset = file[name]
            shape = dataset.shape if index is None else dataset.shape[1:]
            checked(path, shape, dataset.dtype.itemsize)
            values: NDArray[Any] = dataset[()] if index is None else dataset[index]
            return values

    def visit(name: str, item: Any) -> bool | None:
        shape, dtype = getattr(item, "shape", None), getattr(item, "dtype", None)
        if shape and dtype is not None and dtype.kind in _NUMERIC and not name.startswith("#"):
            loader = _loading(path, lambda index: load(name, index))
            entries.append((name, ArrayEntry(tuple(shape), dtype.name, loader)))
        return len(entries) > _MAX_ARRAYS or None  # anything but None ends the visit

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    yield from entries


def _matlab(path: Path) -> Iterator[tuple[str, ArrayEntry]]:
    try:
        from scipy.io import loadmat, whosmat
    except ImportError:
        raise needs_extra(path, "a MATLAB 5", "scipy", "mat") from None

    def load(
        file: bytes, name: str, shape: tuple[int, ...], dtype: str, index: int | None
    ) -> NDArray[Any]:
        checked(path, shape, np.dtype(dtype).itemsize)
        values: NDArray[Any] = loadmat(BytesIO(file))[name]
        if values.dtype.kind == "c":
            problem = f"holds complex numbers in {name}"
            raise InputError("not-numbers", problem, "save real numbers", path=path)
        values = values.astype(dtype, copy=False)  # it may be stored in a smaller type
        return values if index is None else values[index]

    for file in _matlab_arrays(path):
        for name, shape, kind in whosmat(BytesIO(file)):
            if (dtype := _CLASSES.get(kind)) is not None:
                loader = _loading(path, partial(load, file, name, shape, dtype))
                yield name, ArrayEntry(shape, dtype, loader)


def _matlab_arrays(path: Path) -> Iterator[bytes]:
    """A MATLAB 5 file for each array that holds no other, without compression.

    Scipy inflates an array however large it becomes, and ends the process where the number of a
    type is none that it knows.
    """
    if (size := path.stat().st_size) > _LARGEST_MATLAB:
        problem = f"is a MATLAB file of {size} bytes"
        remedy = "save it with -v7.3, which is read in pieces"
        raise InputError("too-large", problem, remedy, path=path)
    data, room = path.read_bytes(), _LARGEST_MATLAB
    order = {b"IM": "<", b"MI": ">"}[data[126:128]]
    for kind, element in _elements(data[128:], order):
        if kind == _COMPRESSED:
            inflate = zlib.decompressobj()
            element = inflate.decompress(element[8:], room + 1)
            room -= len(element)
            if room < 0 or not inflate.eof:
                raise ValueError("arrays of more than 256 MiB, or cut short")
            kind, element = next(_elements(element, order))
        types = {part for part, _ in _elements(element[8:], order)} if kind == _MATRIX else {0}
        if types <= _TYPES:
            yield data[:128] + element


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type and bytes of each element; those of up to four bytes have all in two words."""
    place = 0
    while place < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, place)
        end = place + 8 + (0 if kind >> 16 else size)
        if end > len(data):
            raise ValueError("it ends early")
        yield kind & 0xFFFF, data[place:end]
        place = end if kind == _COMPRESSED else -(-end // 8) * 8

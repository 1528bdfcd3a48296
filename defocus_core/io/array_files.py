"""Arrays of numbers in files: NPY, PFM, .dpt, COLMAP; NPZ and HDF5.

PFM (netpbm): ``Pf``, width, height, scale, then rows from bottom to top; a negative scale means
little endian. OpenImageIO may return the rows upside down, so that PFM is read here. Sintel's .dpt
(its ``sintel_io.py``): the float 202021.25, width, height, then rows, all little endian. COLMAP
(``scripts/python/read_write_dense.py``): ``width&height&channels&``, then rows. MATLAB 7.3 is HDF5
after a block of text; HDF5 shows its axes in reverse order.
"""

from __future__ import annotations

import math
import re
import struct
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, reason
from defocus_core.io.read_files import AGAIN, check_size, damaged, decoding, needs_extra, read_head
from defocus_core.system.text import times

_MATLAB_5 = "MATLAB 5"
_MAGIC = {
    b"\x93NUMPY": "NPY",
    b"Pf": "PFM",
    b"PF": "PFM",
    b"PIEH": "DPT",  # 202021.25 as float32
    b"PK\x03\x04": "NPZ",
    b"\x89HDF\r\n\x1a\n": "HDF5",
    b"MATLAB 7.3 MAT-": "HDF5",
    b"MATLAB 5.0 MAT-": _MATLAB_5,
}
NAMED = ("NPZ", "HDF5")  # types whose arrays have names
# After the scale comes a line break or one blank, as the first byte of the pixels may look like a
# blank, too. Words are separated by blanks, and by comments that some programs write.
_PFM_HEADER = re.compile(
    rb"(Pf|PF)W(\S+)W(\S+)W(\S+)(?:[ \t\r]*\n|\s)".replace(b"W", rb"\s(?:\s|#[^\n]*\n)*")
)
_COLMAP = re.compile(rb"(\d{1,7})&(\d{1,7})&(\d{1,3})&")
_HEAD = 32  # bytes
_NUMERIC = "fiu"  # kinds of NumPy types
_MAX_ARRAYS = 4096
_LONGEST_HEADER = 2**16  # bytes


def array_of(values: Any) -> NDArray[Any]:
    """The real numbers of an array or a tensor in memory, as they are."""
    try:
        held = values.detach().cpu().numpy() if hasattr(values, "detach") else values
        array: NDArray[Any] = np.asanyarray(held)
    except (TypeError, RuntimeError) as error:  # a tensor of a type or layout that NumPy lacks
        raise ValueError(f"pictures must be arrays of numbers: {reason(error)}") from None
    if array.dtype.kind not in "uifb" or np.ma.is_masked(array):
        got = "masked ones; fill them" if array.dtype.kind in "uifb" else array.dtype
        raise ValueError(f"pictures must be arrays of numbers, got {got}")
    return array


@dataclass(frozen=True)
class ArrayEntry:
    """An array in a file, not loaded yet."""

    shape: tuple[int, ...]  # of the whole array
    dtype: str  # as NumPy names it, like ``float32``
    # Reads the whole array; given an index, only this entry of its first axis
    load: Callable[[int | None], NDArray[Any]]


def array_type(head: bytes) -> str:
    """The type of an array file that starts with ``head``, or an empty text for other files.

    The types are NPY, PFM, DPT, COLMAP, NPZ, HDF5 and MATLAB 5.
    """
    kind = next((kind for magic, kind in _MAGIC.items() if head.startswith(magic)), "")
    return "COLMAP" if _COLMAP.match(head) else kind


def has_frames(path: Path) -> bool:
    """Whether a file may hold several maps, one of which the option ``part`` chooses."""
    kind = array_type(read_head(path, _HEAD))
    if kind == "NPY":
        return any(frames_of(entry.shape) > 1 for entry in read_entries(path).values())
    return kind in (*NAMED, _MATLAB_5)


def read_entries(path: Path) -> dict[str, ArrayEntry]:
    """The numeric arrays of two or more axes in a file, by name; a single array has the name "".

    Arrays of uncompressed files are mapped into memory, not loaded. A file without any such array
    is an InputError.
    """
    kind = array_type(read_head(path, _HEAD))
    if kind == _MATLAB_5:
        remedy = "save it with -v7.3, or as NPY"
        raise InputError("unsupported", "is a MATLAB 5 file, which is not read", remedy, path=path)
    if not kind:
        remedy = "save it as NPY or NPZ"
        raise InputError("wrong-type", "is not a file of arrays", remedy, path=path)
    with decoding(path, f"is a truncated or damaged {kind} file"):
        every = list(islice(_READERS[kind](path), _MAX_ARRAYS + 1))
    if len(every) > _MAX_ARRAYS:
        problem = f"holds more than {_MAX_ARRAYS} arrays"
        remedy = "save one array of all frames, or several files"
        raise InputError("too-large", problem, remedy, path=path)
    entries = {
        name: entry for name, entry in every if len(entry.shape) >= 2 and min(entry.shape) > 0
    }
    if "indptr" in dict(every):
        problem, remedy = "holds a sparse matrix of SciPy", "save its toarray() as NPY"
        raise InputError("unsupported", problem, remedy, path=path)
    if not entries:
        problem, remedy = "holds no numbers of height × width", "save an array of floats"
        raise InputError("not-numbers", problem, remedy, path=path)
    return entries


def read_array(path: Path) -> NDArray[Any]:
    """The numbers of the only array in a file; several are an InputError."""
    entries = read_entries(path)
    if len(entries) > 1:
        problem = f"holds the arrays {', '.join(list(entries)[:20])}"
        raise InputError("ambiguous", problem, "save one array a file", path=path)
    (entry,) = entries.values()
    return entry.load(None)


def read_map(path: Path) -> NDArray[Any]:
    """The numbers [H, W] of the only map in a file; axes of length 1 are removed."""
    values = read_array(path)
    values = values.reshape(squeezed_shape(values.shape))
    if values.ndim != 2:
        raise wrong_shape(path, values.shape)
    return values


def squeezed_shape(shape: tuple[int, ...]) -> tuple[int, ...]:
    """A shape without its leading and trailing axes of length 1; at least two axes remain."""
    while len(shape) > 2 and shape[0] == 1:
        shape = shape[1:]
    while len(shape) > 2 and shape[-1] == 1:
        shape = shape[:-1]
    return shape


def frames_of(shape: tuple[int, ...]) -> int:
    """The number of maps in an array of shape [N, H, W] or [N, 1, H, W]; 1 for other shapes."""
    shape = squeezed_shape(shape)
    return shape[0] if len(shape) == 3 or (len(shape) == 4 and shape[1] == 1) else 1


def wrong_shape(path: Path, shape: tuple[int, ...]) -> InputError:
    """The error for an array that is not one map [H, W]."""
    problem = f"has {times(shape)} numbers, not height × width"
    remedy = "save one map in each file, or give ‹depth-format›"
    return InputError("wrong-shape", problem, remedy, path=path)


def _rows(path: Path, start: int, width: int, height: int, dtype: str = "<f4") -> NDArray[Any]:
    check_size(path, width, height, 4)
    there, wanted = path.stat().st_size - start, width * height * 4
    if there != wanted:
        problem = f"has {there} bytes of pixels, and {width}×{height} px of float32 are {wanted}"
        raise InputError("damaged", problem, AGAIN, path=path)
    return np.memmap(path, dtype, "r", start, (height, width))


def _mapped(values: NDArray[Any]) -> Iterator[tuple[str, ArrayEntry]]:
    dtype = values.dtype.name
    yield "", ArrayEntry(values.shape, dtype, lambda at: values if at is None else values[at])


def _pfm(path: Path) -> Iterator[tuple[str, ArrayEntry]]:
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
    dtype = "<f4" if scale < 0 else ">f4"
    yield from _mapped(_rows(path, header.end(), width, height, dtype)[::-1])


def _dpt(path: Path) -> Iterator[tuple[str, ArrayEntry]]:
    width, height = struct.unpack("<2i", read_head(path, 12)[4:])
    yield from _mapped(_rows(path, 12, width, height))


def _colmap(path: Path) -> Iterator[tuple[str, ArrayEntry]]:
    header = _COLMAP.match(read_head(path, _HEAD))
    assert header is not None
    width, height, channels = (int(number) for number in header.groups())
    if channels != 1:
        problem = f"has {channels} channels; depth is one"
        remedy = "name a file of depth_maps, not of normal_maps"
        raise InputError("not-one-channel", problem, remedy, path=path)
    yield from _mapped(_rows(path, header.end(), width, height))


def _npy_header(stored: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an NPY file; the shape is () if it holds no numbers."""
    file = BytesIO(stored.read(_LONGEST_HEADER))  # a file may claim a header of any length
    major, minor = np.lib.format.read_magic(file)
    shape, _, dtype = getattr(np.lib.format, f"read_array_header_{major}_{minor}")(file)
    return shape if dtype.kind in _NUMERIC else (), dtype


def _npy(path: Path) -> Iterator[tuple[str, ArrayEntry]]:
    with path.open("rb") as file:
        shape, dtype = _npy_header(file)
    if len(shape) > 1:
        check_size(path, shape[-1], math.prod(shape[:-1]), dtype.itemsize)
        yield from _mapped(np.load(path, mmap_mode="r", allow_pickle=False))


def _npz(path: Path) -> Iterator[tuple[str, ArrayEntry]]:
    with zipfile.ZipFile(path) as archive:
        for member in (name for name in archive.namelist() if name.endswith(".npy")):
            with archive.open(member) as stored:
                shape, dtype = _npy_header(stored)
            load = partial(_npz_array, path, member, shape, dtype)
            yield member.removesuffix(".npy"), ArrayEntry(shape, dtype.name, load)


def _npz_array(
    path: Path, member: str, shape: tuple[int, ...], dtype: np.dtype[Any], index: int | None
) -> NDArray[Any]:
    check_size(path, shape[-1], math.prod(shape[:-1]), dtype.itemsize)
    with decoding(path), zipfile.ZipFile(path) as archive, archive.open(member) as file:
        values: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    return values if index is None else values[index]


def _hdf5(path: Path) -> Iterator[tuple[str, ArrayEntry]]:
    try:
        import h5py
    except ImportError:
        raise needs_extra(path, "an HDF5", "h5py", "hdf5") from None
    entries: list[tuple[str, ArrayEntry]] = []

    def load(name: str, index: int | None) -> NDArray[Any]:
        with decoding(path), h5py.File(path, "r") as file:
            dataset = file[name]
            if dataset.is_virtual or dataset.external:
                problem = f"has {name} in other files, which are not followed"
                raise InputError("unsupported", problem, "copy the numbers into it", path=path)
            if not dataset.id.get_storage_size():
                problem = f"has numbers of {name} that were never written"
                raise InputError("damaged", problem, AGAIN, path=path)
            shape = dataset.shape if index is None else dataset.shape[1:]
            check_size(path, shape[-1], math.prod(shape[:-1]), dataset.dtype.itemsize)
            values: NDArray[Any] = dataset[()] if index is None else dataset[index]
            return values

    def visit(name: str, item: Any) -> bool | None:
        shape, dtype = getattr(item, "shape", None), getattr(item, "dtype", None)
        if shape and dtype is not None and dtype.kind in _NUMERIC and not name.startswith("#"):
            entries.append((name, ArrayEntry(tuple(shape), dtype.name, partial(load, name))))
        return len(entries) > _MAX_ARRAYS or None  # anything but None ends the visit

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    yield from entries


_READERS: dict[str, Callable[[Path], Iterator[tuple[str, ArrayEntry]]]] = {
    "NPY": _npy,
    "PFM": _pfm,
    "DPT": _dpt,
    "COLMAP": _colmap,
    "NPZ": _npz,
    "HDF5": _hdf5,
}

"""HDF5 and HEIC files for the tests: by h5py where it is installed, else by small stand-ins.

A stand-in has the few names of the library that defocus uses, and files of its own that begin as
real ones do. Scipy has none: what needs it is left out where it is not installed.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

HAS_H5PY = find_spec("h5py") is not None
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
HEIC_MAGIC = b"\0\0\0\x18ftypheic"


class _Dataset:
    def __init__(self, values: Any) -> None:
        self._values = values
        self.shape, self.dtype = values.shape, values.dtype

    def __getitem__(self, index: Any) -> Any:
        return self._values[index]


class _File:
    """As h5py.File, of files that `_write` made."""

    def __init__(self, path: Any, mode: str) -> None:
        assert mode == "r"
        data = Path(path).read_bytes()
        self._arrays = dict(np.load(io.BytesIO(data.removeprefix(HDF5_MAGIC))))

    def __enter__(self) -> _File:
        return self

    def __exit__(self, *_: object) -> None:
        self._arrays.clear()

    def __getitem__(self, name: str) -> _Dataset:
        return _Dataset(self._arrays[name])

    def visititems(self, visit: Callable[[str, Any], Any]) -> None:
        for name, values in self._arrays.items():
            visit(name, _Dataset(values))


def write_hdf5(path: Path, arrays: dict[str, Any]) -> Path:
    """Write arrays as HDF5 that the h5py of `with_hdf5` reads."""
    if HAS_H5PY:
        import h5py

        with h5py.File(path, "w") as file:
            for name, values in arrays.items():
                file[name] = values
        return path
    packed = io.BytesIO()
    np.savez(packed, **arrays)
    path.write_bytes(HDF5_MAGIC + packed.getvalue())
    return path


def with_hdf5(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let h5py be there."""
    if not HAS_H5PY:
        module: Any = ModuleType("h5py")
        module.File = _File
        monkeypatch.setitem(sys.modules, "h5py", module)


def with_heic(monkeypatch: pytest.MonkeyPatch, depth: Any, **metadata: float) -> None:
    """Let pillow_heif be there, and every HEIC file have this depth image."""

    module: Any = ModuleType("pillow_heif")
    image = SimpleNamespace(info={"metadata": metadata})
    image.__array_interface__ = depth.__array_interface__
    picture = np.full((*depth.shape, 3), 128, np.uint8)
    info = {"depth_images": [image]}
    file = SimpleNamespace(info=info, size=depth.shape[::-1], mode="RGB")
    file.__array_interface__ = picture.__array_interface__
    file.kept = picture, depth  # which the interfaces do not keep
    module.open_heif = lambda _: file
    monkeypatch.setitem(sys.modules, "pillow_heif", module)


def require_scipy() -> None:
    """Leave the test out where scipy is not installed."""
    if find_spec("scipy") is None:
        pytest.skip("scipy is not installed")

"""HDF5 and HEIC files for the tests; what a library cannot write is pretended."""

import struct
import sys
from contextlib import contextmanager
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
HEIC_MAGIC = b"\0\0\0\x18ftypheic"


def write_hdf5(path, arrays):
    with pytest.importorskip("h5py").File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values
    return path


@contextmanager
def instead(library, module):
    """Let a library be this module, or not be there where it is None."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, library, module)
        yield


def heic(depth, picture=None, **metadata):
    """Let pillow_heif be there, and every HEIC file have this depth image, and picture."""
    module: Any = ModuleType("pillow_heif")
    image = SimpleNamespace(info={"metadata": metadata})
    image.__array_interface__ = depth.__array_interface__
    picture = np.full((*depth.shape, 3), 128, np.uint8) if picture is None else picture
    file = SimpleNamespace(info={"depth_images": [image]}, size=picture.shape[1::-1], mode="RGB")
    file.__array_interface__ = picture.__array_interface__
    file.kept = picture, depth  # which the interfaces do not keep
    module.open_heif = lambda _: file
    return instead("pillow_heif", module)


def heic_with_auxiliary(path, picture, image, kind):
    """A HEIC file with an auxiliary image of a kind: as its alpha is written, under a new name."""
    pixels = np.dstack([picture, image]).astype(np.uint8)
    heif = pytest.importorskip("pillow_heif").from_bytes(
        "RGBA", image.shape[::-1], pixels.tobytes()
    )
    heif.save(str(path), quality=95)
    data, alpha = path.read_bytes(), b"urn:mpeg:hevc:2015:auxid:1"
    grown = bytearray(data)
    more = len(kind) - len(alpha)
    lengths = [data.index(box) - 4 for box in (b"meta", b"iprp", b"ipco", b"auxC")]
    places = [data.index(b"iloc") + 16 + 18 * item for item in (0, 1)]
    for at in lengths + places:
        struct.pack_into(">I", grown, at, struct.unpack_from(">I", data, at)[0] + more)
    path.write_bytes(bytes(grown).replace(alpha, kind.encode()))
    return path

"""Motion vectors of an EXR: where the surface of each pixel is in the frames before and after.

Blender's pass has channels X, Y, Z and W: the place in the frame before less the place in this one,
and the place in this frame less the one after, in px, y upwards (Cycles' kernel). Nuke's layers
``forward`` and ``backward`` have u and v: the place in the other frame less the one in this, v
upwards. Without vectors to the frame before, a surface moves on as it did.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.exr.header import is_exr, read_headers
from defocus_core.io.exr.reading import read_parts
from defocus_core.io.exr.windows import NO_OVERSCAN, Overscan
from defocus_core.io.safe_files import read_head

_FORWARD, _BACKWARD = "forward", "backward"


class Motion(NamedTuple):
    """Vectors [2, H, W] in px, right and down, from each pixel to its surface's other places."""

    to_previous: NDArray[np.float32]
    to_next: NDArray[np.float32]


def read_motion(files: Iterable[Path], channel: str, overscan: Overscan = NO_OVERSCAN) -> Motion:
    """The motion of a frame."""
    names: list[str] = []
    for path in dict.fromkeys(files):
        if not is_exr(read_head(path)):
            continue
        there = [c.name for header in read_headers(path) for c in header.channels]
        wanted = _vectors(there, channel)
        if wanted:
            return _motion(path, wanted, overscan)
        names += there
    layers = ", ".join(sorted({name.rpartition(".")[0] for name in names} - {""})) or "none"
    problem = f"has no motion vectors '{channel}'"
    remedy = f"its layers are {layers}; name one with ‹motion›"
    raise InputError("no-such-channel", problem, remedy, path=path)


def _vectors(names: list[str], channel: str) -> dict[str, str]:
    """The channel of each component: x, y to the frame after; back_x, back_y to the one before."""
    by_lower = {name.lower(): name for name in names}
    layer = channel.lower().removesuffix(".")

    def components(of_layer: str, *ends: str) -> list[str] | None:
        every = [by_lower.get(f"{of_layer}.{end}") for end in ends]
        return None if None in every else [str(name) for name in every]

    if (blender := components(layer, "x", "y", "z", "w")) is not None:
        return dict(zip(("back_x", "back_y", "x", "y"), blender, strict=True)) | {"blender": ""}
    head, _, last = layer.rpartition(".")
    before = f"{head}.{_BACKWARD}" if head else _BACKWARD
    after = f"{head}.{_FORWARD}" if last == _BACKWARD and head else layer
    after = _FORWARD if layer == _BACKWARD else after
    forward = components(after, "u", "v")
    if forward is None:
        return {}
    backward = components(before, "u", "v") if after.endswith(_FORWARD) else None
    vectors = dict(zip(("x", "y"), forward, strict=True))
    return vectors | dict(zip(("back_x", "back_y"), backward or (), strict=False))


def _motion(path: Path, vectors: dict[str, str], overscan: Overscan) -> Motion:
    named = set(vectors.values())
    planes: dict[str, Any] = {}
    for part in read_parts(path, wanted=lambda _, name: name in named, overscan=overscan):
        planes |= {name: plane[:].astype(np.float32) for name, plane in part.channels.items()}

    def pair(x: str, y: str, sign: float) -> NDArray[np.float32]:
        return np.stack([sign * planes[vectors[x]], -sign * planes[vectors[y]]])

    to_next = pair("x", "y", -1.0 if "blender" in vectors else 1.0)
    if "back_x" not in vectors:
        return Motion(-to_next, to_next)
    return Motion(pair("back_x", "back_y", 1.0), to_next)

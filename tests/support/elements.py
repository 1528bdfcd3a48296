"""Elements for the tests: a disc with smooth edges at one depth, and nothing around it."""

import numpy as np
import OpenEXR
from image_files import SCANLINE, box

SIZE = (40, 60)  # height, width
METRES = 1.5


def disc(radius=11.0, center=(19.5, 29.5)):
    """Coverage [H, W] of a disc whose edge is two px wide; centre as row and column."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    distance = np.hypot(y - center[0], x - center[1])
    return np.clip((radius - distance) / 2 + 0.5, 0, 1).astype(np.float32)


def element(alpha, color=(0.8, 0.5, 0.2), depth=METRES):
    """The channels of an element of one depth: premultiplied colour, alpha, Z of 0 in nothing."""
    planes = {name: alpha * np.float32(value) for name, value in zip("RGB", color, strict=True)}
    metres = np.where(alpha > 0, np.float32(depth), np.float32(0))
    return {**planes, "A": alpha, "Z": metres}


def write(path, planes, **attributes):
    path.parent.mkdir(parents=True, exist_ok=True)
    channels = {name: np.ascontiguousarray(plane) for name, plane in planes.items()}
    OpenEXR.File({**SCANLINE, **attributes}, channels).write(str(path))
    return path


def write_within(path, planes, window):
    """The planes cut to a data window inside of a display window of their size."""
    x0, y0, x1, y1 = window
    height, width = next(iter(planes.values())).shape
    cut = {name: plane[y0 : y1 + 1, x0 : x1 + 1] for name, plane in planes.items()}
    display = box(0, 0, width - 1, height - 1)
    return write(path, cut, dataWindow=box(*window), displayWindow=display)

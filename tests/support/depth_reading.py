"""Depth in memory, and files read by options that the door lacks or names otherwise."""

from pathlib import Path

import numpy as np

from defocus_core.io.depth_formats.depth import Depth, read_depth
from defocus_core.io.depth_formats.reading import DepthReading


def decoded(path, lens_focal=None, **reading):
    """The depth of a file by options of reading; holes are kept unless `invalid` says otherwise."""
    return read_depth(path, DepthReading(**reading), lens_focal=lens_focal)


def depth_of(metres, path="depth.exr", channel="Z", **kind):
    """Depth [H, W] as if it had been read from a file."""
    return Depth(np.asarray(metres, np.float32), Path(path), channel, "", **kind)

"""Depth files read by options that `read_depth` of the door does not have, or under other names."""

from defocus_core.io.depth_formats.depth import read_depth
from defocus_core.io.depth_formats.reading import DepthReading


def decoded(path, lens_focal=None, **reading):
    """The depth of a file by options of reading; holes are kept unless `invalid` says otherwise."""
    return read_depth(path, DepthReading(**reading), lens_focal=lens_focal)

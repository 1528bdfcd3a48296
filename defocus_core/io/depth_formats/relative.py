"""Depth files that hold relative depth: numbers whose unit nothing says."""

from __future__ import annotations

from pathlib import Path

from defocus_core.io.depth_formats.photo_depth import holds_gdepth, is_heic, read_gdepth
from defocus_core.io.depth_formats.reading import DepthReading
from defocus_core.io.exr.header import is_exr
from defocus_core.io.images.describe import describe
from defocus_core.io.images.raster import choose_page
from defocus_core.io.safe_files import read_head


def is_relative(path: Path, reading: DepthReading) -> bool:
    """Whether a depth file names no unit: whole numbers of 8 or 16 bits, HEIC, some GDepth."""
    head = read_head(path)
    if reading.says_scale or is_exr(head):
        return reading.relative
    if is_heic(head):
        return True
    if holds_gdepth(path):
        return "Units" not in read_gdepth(path).metadata
    part = choose_page(path, describe(path).parts, reading.part)
    return all(kind in ("uint8", "uint16") for _, kind in part.channels)

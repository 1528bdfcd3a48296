"""The report of ``defocus depth``, as JSON and in words."""

from __future__ import annotations

from typing import Any

from defocus_core.batch.depth.conversion import Converted
from defocus_core.system.text import counted


def record(converted: Converted) -> dict[str, Any]:
    """A conversion in plain values."""
    height, width = converted.depth.metres.shape
    return {
        "file": str(converted.place.file),
        "out": str(converted.place.out),
        "size": [width, height],
        "range_m": converted.range_m,
        "sky_pixels": converted.sky,
        "replaced_pixels": converted.depth.replaced,
        "note": converted.depth.note,
        "warnings": list(converted.warnings),
    }


def line(converted: Converted) -> str:
    """A conversion in words."""
    ends = converted.range_m
    reach = "all sky" if ends is None else f"{ends[0]:.6g} m to {ends[1]:.6g} m"
    sky = f", {counted(converted.sky, 'sky pixel')}" if converted.sky else ""
    place = converted.place
    return f"{place.file} → {place.out}: {reach}{sky} ({converted.depth.note})"

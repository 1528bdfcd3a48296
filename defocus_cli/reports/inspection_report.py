"""The report of ``defocus info``, as JSON and in words."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from defocus_cli.jobs.job import lens_record, lens_words
from defocus_cli.system.console import counted

if TYPE_CHECKING:
    from defocus_cli.reports.inspection import DepthFound, Inspection, MapFound


def record(inspection: Inspection) -> dict[str, Any]:
    """What is in a file."""
    document: dict[str, Any] = {
        "file": str(inspection.info.path),
        "size": [inspection.info.width, inspection.info.height],
        "parts": [
            {"index": p.index, "name": p.name, "deep": p.deep, "channels": dict(p.channels)}
            for p in inspection.info.parts
        ],
        "color": None,
        "color_note": inspection.color_note,
        "depth": None,
        "depth_note": inspection.depth_note,
        "maps": [_map_record(map_found) for map_found in inspection.maps],
    }
    if inspection.color is not None:
        document["color_note"] = inspection.color.note
        document["color"] = {
            "channels": list(inspection.color.channels),
            "nonfinite_pixels": inspection.color.nonfinite,
        }
    if (depth := inspection.depth) is not None:
        document["depth_note"] = depth.note
        document["depth"] = {
            "range_m": depth.range_m,
            "sky_pixels": depth.sky,
            "invalid_pixels": depth.invalid,
            "lens": lens_record(depth.lens) if depth.lens else None,
            "coc_px": depth.coc_px,
            "repair": depth.repair,
        }
    return document


def _map_record(map_found: MapFound) -> dict[str, Any]:
    unit = map_found.kind.unit
    return {"kind": map_found.kind.name, f"range_{unit}" if unit else "range": map_found.range}


def lines(inspection: Inspection) -> Iterator[str]:
    """What is in a file, in words."""
    info = inspection.info
    yield f"{info.path}: {info.width}x{info.height}"
    for part in info.parts:
        named = f"part {part.index}{f' ({part.name})' if part.name else ''}: "
        channels = ", ".join(f"{name} {kind}" for name, kind in part.channels)
        yield f"  {named if len(info.parts) > 1 else ''}{channels}{', deep' if part.deep else ''}"
    for map_found in inspection.maps:
        reach = "no finite pixel"
        if map_found.range is not None:
            least, greatest = map_found.range
            reach = f"{least:.2f} to {greatest:.2f} {map_found.kind.unit}".rstrip()
        yield f"  {map_found.kind.title}: {reach}"
    if inspection.maps and inspection.color is None and inspection.depth is None:
        return
    if inspection.color is None:
        yield f"  no colour: {inspection.color_note}"
    else:
        bad = inspection.color.nonfinite
        holes = f", {counted(bad, 'pixel')} not finite" if bad else ""
        yield f"  colour: {', '.join(inspection.color.channels)}{holes} ({inspection.color.note})"
    if inspection.depth is None:
        yield f"  no depth: {inspection.depth_note}"
    else:
        yield from _depth_lines(inspection.depth)


def _depth_lines(depth: DepthFound) -> Iterator[str]:
    reach = "no finite depth"
    if depth.range_m is not None:
        reach = f"{depth.range_m[0]:.6g} m to {depth.range_m[1]:.6g} m"
    invalid = counted(depth.invalid, "invalid pixel")
    yield f"  depth: {reach}, {depth.sky} sky and {invalid} ({depth.note})"
    if depth.lens is not None and depth.coc_px is not None:
        near, far = depth.coc_px
        yield f"  CoC: {near:.2f} to {far:.2f} px ({lens_words(depth.lens)})"
        if depth.repair:
            yield f"  rendered: {depth.repair}"

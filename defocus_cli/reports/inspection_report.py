"""The report of ``defocus info``, as JSON and in words."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from defocus_cli.jobs.job import lens_record, lens_words
from defocus_cli.system.console import counted

if TYPE_CHECKING:
    from defocus_cli.reports.inspection import DepthFound, Inspection, MapFound


def record(found: Inspection) -> dict[str, Any]:
    """What is in a file."""
    told: dict[str, Any] = {
        "file": str(found.info.path),
        "size": [found.info.width, found.info.height],
        "parts": [
            {"index": p.index, "name": p.name, "deep": p.deep, "channels": dict(p.channels)}
            for p in found.info.parts
        ],
        "color": None,
        "color_note": found.color_note,
        "depth": None,
        "depth_note": found.depth_note,
        "evidence": list(found.evidence),
        "maps": [_map_record(shown) for shown in found.maps],
    }
    if found.color is not None:
        told["color_note"] = found.color.note
        told["color"] = {
            "channels": list(found.color.channels),
            "nonfinite_pixels": found.color.nonfinite,
        }
    if (depth := found.depth) is not None:
        told["depth_note"] = depth.note
        told["depth"] = {
            "range_m": depth.range_m,
            "sky_pixels": depth.sky,
            "invalid_pixels": depth.invalid,
            "lens": lens_record(depth.lens) if depth.lens else None,
            "coc_px": depth.coc_px,
            "repair": depth.repair,
        }
    return told


def _map_record(shown: MapFound) -> dict[str, Any]:
    unit = shown.kind.unit
    return {"kind": shown.kind.name, f"range_{unit}" if unit else "range": shown.range}


def lines(found: Inspection) -> Iterator[str]:
    """What is in a file, in words."""
    info = found.info
    yield f"{info.path}: {info.width}x{info.height}"
    for part in info.parts:
        named = f"part {part.index}{f' ({part.name})' if part.name else ''}: "
        channels = ", ".join(f"{name} {kind}" for name, kind in part.channels)
        yield f"  {named if len(info.parts) > 1 else ''}{channels}{', deep' if part.deep else ''}"
    for shown in found.maps:
        reach = "no finite pixel"
        if shown.range is not None:
            reach = f"{shown.range[0]:.2f} to {shown.range[1]:.2f} {shown.kind.unit}".rstrip()
        yield f"  {shown.kind.title}: {reach}"
    if found.maps and found.color is None and found.depth is None:
        return
    if found.color is None:
        yield f"  no colour: {found.color_note}"
    else:
        bad = found.color.nonfinite
        holes = f", {counted(bad, 'pixel')} not finite" if bad else ""
        yield f"  colour: {', '.join(found.color.channels)}{holes} ({found.color.note})"
    if found.depth is None:
        yield f"  no depth: {found.depth_note}"
    else:
        yield from _depth_lines(found.depth)
    for told in found.evidence:
        yield f"  {told}"


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

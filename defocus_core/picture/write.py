"""Write: the images and maps of a job, all files or none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from defocus_core.batch.jobs.output_kinds import Kind
from defocus_core.batch.lenses.lens import Lens
from defocus_core.batch.lenses.parameters import RECORDED
from defocus_core.errors import InputError, with_dashes
from defocus_core.io.arrays import LazyArray, stacked
from defocus_core.io.exr.compression import codec_of
from defocus_core.io.exr.writing import write_exr
from defocus_core.io.images.color_space import PROFILE
from defocus_core.io.images.encode import write_image, write_map
from defocus_core.io.images.primaries import PRIMARIES
from defocus_core.io.safe_files import written_together
from defocus_core.picture.contents import Contents, contents_of
from defocus_core.picture.repair_words import repair_attribute
from defocus_core.picture.take import Take
from defocus_core.system.text import version

_OF_COLORS = {PRIMARIES, PROFILE}


def write(take: Take) -> Take:
    """Write the files of a job, all or none; it, with warnings of what they cannot hold."""
    outputs = take.job.outputs
    if not outputs.root.is_dir():  # created again, it would have no journal
        problem = "was removed while jobs were done"
        raise InputError("unwritable", problem, "run the same command again", path=outputs.root)
    with written_together(outputs.root):
        warnings = [warning for kind in outputs.rows for warning in _write_kind(take, kind)]
    if outputs.format == "exr" and any(kind.image for kind in outputs.rows):
        warnings += take.inputs.color.left_out
    return replace(take, warnings=(*take.warnings, *warnings))


def _write_kind(take: Take, kind: Kind) -> list[str]:
    """Write the file of a kind, and its preview if there is to be one; the warnings."""
    job, contents = take.job, contents_of(take, kind)
    path, preview = job.paths[kind.name], job.previews.get(kind.name)
    attributes, warnings = _attributes(take, kind), []
    compression = job.outputs.compression
    if compression == "input":
        compression = take.inputs.color.compression
    if kind.image:
        left_out = {"view"} if kind.views else _OF_COLORS if kind.source == "focus" else set()
        if job.outputs.color_space == "srgb":
            left_out = {*left_out, PROFILE}
        every = take.inputs.color.attributes
        carried = {name: value for name, value in every.items() if name not in left_out}
        lost = write_image(
            path,
            contents.planes,
            contents.names,
            exr_type=job.outputs.exr_type,
            compression=compression,
            bits=16 if job.outputs.format == "png16" else 8,
            jpeg_quality=job.outputs.jpeg_quality,
            attributes={**carried, **attributes},
            extras=contents.extras,
            layout=contents.layout,
            clamped=take.clamped.get(kind.name, 0),
            has_clipped=not take.inputs.color.within_white,
        )
        warnings = [f"{kind.name}: {warning}" for warning in lost]
    elif job.outputs.map_format == "tiff":
        write_map(path, contents.planes[0])
    else:
        channel = kind.channel or kind.name
        exact = "zip" if codec_of(compression)[0].lossy else compression
        write_exr(path, {channel: contents.planes[0]}, attributes, contents.layout, exact)
    if preview is not None:
        _write_preview(preview, contents)
    return warnings


def _write_preview(path: Path, contents: Contents) -> None:
    """Write the preview of a file."""
    from defocus_core.picture import preview

    kind, planes = contents.kind, contents.planes
    if kind.of_radius:
        preview.write_signed_preview(path, planes[0])
    elif kind.source == "depth":
        preview.write_depth_preview(path, planes[0])
    else:
        pictures = _side_by_side(planes, len(kind.rendered_as))
        preview.write_preview(path, pictures, contents.take.inputs.color.attributes)


def _side_by_side(planes: Sequence[Any], views: int) -> LazyArray:
    """The planes [H, W] of views side by side, [H, views * W, C]."""
    count = len(planes) // views
    pictures = [stacked(planes[n : n + count]) for n in range(0, len(planes), count)]
    height, width = planes[0].shape

    def read(rows: slice) -> Any:
        return np.concatenate([picture[rows] for picture in pictures], axis=1)

    return LazyArray((height, width * views, count), planes[0].dtype, read)


def _attributes(take: Take, kind: Kind) -> dict[str, str]:
    """Attributes of an EXR output; no directory and no time, so that its bytes are repeatable."""
    job, lens = take.job, take.lens
    others = {
        role: f"{other.color.name} {other.depth.name}" for role, other in job.picture.others.items()
    }
    values = {
        "version": version(),
        "kind": kind.name,
        "color": job.picture.color.name,
        "depth": job.picture.depth.name,
        "hidden": others.pop("hidden", ""),
        **others,
        "color_read_as": take.color_note,
        "depth_read_as": take.depth_words(rendered=kind.rendered),
        **_repair(take, kind),
        **_of_any_lens(lens),
        **{name: str(value) for name, value in lens.effects.items()},
        "coc_px": " ".join(f"{radius:.6g}" for radius in take.limits),
        "quality": take.quality,
        "device": take.device,
    }
    return {f"defocus:{name}": value for name, value in values.items()}


def _repair(take: Take, kind: Kind) -> dict[str, str]:
    """What was asked of the repair of depth, and what it did; nothing where neither is unusual."""
    if not kind.rendered:
        return {}
    reading = take.job.reading
    asked = [f"‹depth-repair› {reading.depth_repair}"] * (reading.depth_repair != "auto")
    if reading.edge_width is not None:
        asked.append(f"‹edge-width› {reading.edge_width:g}px")
    values = {
        "depth_repair_asked": with_dashes(" ".join(asked)),
        "depth_repair": repair_attribute(take.repair),
    }
    return {name: value for name, value in values.items() if value}


def _of_any_lens(lens: Lens) -> dict[str, str]:
    """What every lens has; nothing of what decides the radii where a file holds them."""
    values = {row: getattr(lens, row.field) for row in RECORDED.values()}
    return {
        row.name.replace("-", "_"): "" if value is None else row.shown(value, 9) + row.optional_unit
        for row, value in values.items()
        if not (row.is_optics and lens.is_shape)
    }

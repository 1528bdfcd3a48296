"""Writing the images and maps of a job: all files or none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
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
from defocus_core.picture.contents import contents_of, without_empty_border
from defocus_core.picture.preview import write_depth_preview, write_preview, write_signed_preview
from defocus_core.picture.repair_words import repair_attribute
from defocus_core.picture.take import Rendered
from defocus_core.system.text import version

_OF_COLORS = {PRIMARIES, PROFILE}


def write(rendered: Rendered) -> Rendered:
    """Write the files of a job, all or none; it, with warnings of what they cannot hold.

    Raises:
        InputError: a file cannot be written.
    """
    outputs = rendered.job.outputs
    if not outputs.root.is_dir():  # created again, it would have no journal
        problem = "was removed while jobs were done"
        raise InputError("unwritable", problem, "run the same command again", path=outputs.root)
    with written_together(outputs.root):
        warnings = [warning for kind in outputs.rows for warning in _write_kind(rendered, kind)]
    if outputs.format == "exr" and any(kind.image for kind in outputs.rows):
        warnings += rendered.inputs.color.left_out
    return replace(rendered, warnings=(*rendered.warnings, *warnings))


def _write_kind(rendered: Rendered, kind: Kind) -> list[str]:
    """Write the file of a kind, and its preview if there is to be one; the warnings."""
    job, contents = rendered.job, contents_of(rendered, kind)
    path, preview = job.paths[kind.name], job.previews.get(kind.name)
    attributes, warnings = _attributes(rendered, kind), []
    compression = job.outputs.compression
    if compression == "input":
        compression = rendered.inputs.color.compression
    if kind.image:
        left_out = {"view"} if kind.views else _OF_COLORS if kind.source == "focus" else set()
        if job.outputs.color_space == "srgb":
            left_out = {*left_out, PROFILE}
        every = rendered.inputs.color.attributes
        carried = {name: value for name, value in every.items() if name not in left_out}
        if job.outputs.format == "exr":
            contents = without_empty_border(rendered, kind, contents)
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
            clamped=rendered.clamped.get(kind.name, 0),
            has_clipped=not rendered.inputs.color.within_white,
        )
        warnings = [f"{kind.name}: {warning}" for warning in lost]
    elif job.outputs.map_format == "tiff":
        write_map(path, contents.planes[0])
    else:
        channel = kind.channel or kind.name
        exact = "zip" if codec_of(compression)[0].lossy else compression
        write_exr(path, {channel: contents.planes[0]}, attributes, contents.layout, exact)
    if preview is not None and kind.of_radius:
        write_signed_preview(preview, contents.planes[0])
    elif preview is not None and kind.source == "depth":
        write_depth_preview(preview, contents.planes[0])
    elif preview is not None:
        pictures = _beside(contents.planes, len(kind.rendered_as))
        write_preview(preview, pictures, rendered.inputs.color.attributes)
    return warnings


def _beside(planes: Sequence[Any], views: int) -> LazyArray:
    """The planes [H, W] of views side by side, [H, views * W, C]."""
    count = len(planes) // views
    pictures = [stacked(planes[n : n + count]) for n in range(0, len(planes), count)]
    height, width = planes[0].shape

    def read(rows: slice) -> Any:
        return np.concatenate([picture[rows] for picture in pictures], axis=1)

    return LazyArray((height, width * views, count), planes[0].dtype, read)


def _attributes(rendered: Rendered, kind: Kind) -> dict[str, str]:
    """Attributes of an EXR output; no directory and no time, so that its bytes are repeatable."""
    job, lens = rendered.job, rendered.lens
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
        "color_read_as": rendered.color_note,
        "depth_read_as": rendered.depth_words(rendered=kind.rendered),
        **_repair(rendered, kind),
        **_of_any_lens(lens),
        **{name: str(value) for name, value in lens.effects.items()},
        "coc_px": " ".join(f"{radius:.6g}" for radius in rendered.radii.limits),
        "quality": rendered.quality,
        "device": rendered.device,
    }
    return {f"defocus:{name}": value for name, value in values.items()}


def _repair(rendered: Rendered, kind: Kind) -> dict[str, str]:
    """What was asked of the repair of depth, and what it did; nothing where neither is unusual."""
    if not kind.rendered:
        return {}
    reading = rendered.job.reading
    asked = [f"‹depth-repair› {reading.depth_repair}"] * (reading.depth_repair != "auto")
    if reading.edge_width is not None:
        asked.append(f"‹edge-width› {reading.edge_width:g}px")
    values = {
        "depth_repair_asked": with_dashes(" ".join(asked)),
        "depth_repair": repair_attribute(rendered.repair),
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

"""Conversion of depth files to EXR, with the choice of output paths and optional previews."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from defocus_core.errors import InputError, UsageProblem
from defocus_core.io.depth_formats.depth import read_depth, require_valid
from defocus_core.io.exr.writing import write_exr
from defocus_core.io.images.describe import describe
from defocus_core.io.write_files import identities, require_replaceable, written_together
from defocus_core.picture.preview import write_depth_preview
from defocus_core.picture.radii import of_file
from defocus_core.request.job import Reading
from defocus_core.request.output_kinds import PICTURES
from defocus_core.system.text import versions

_RADII = "give such files to 'defocus render'"


@dataclass(frozen=True)
class DepthTarget:
    """A depth file to convert, the EXR to write, and the preview to write, if any."""

    file: Path
    out: Path
    preview: Path | None


def targets(files: Sequence[Path], out: Path, *, preview: bool) -> list[DepthTarget]:
    """The files to write for each depth file: `out` if it ends in .exr, else ``out/<stem>.exr``."""
    if (suffix := out.suffix.lower()) in PICTURES - {".exr"}:
        problem = f"ends in {suffix}, and depth is written as EXR"
        remedy = "end it in .exr, or name a directory"
        raise UsageProblem("malformed", problem, remedy, field="out")
    if suffix == ".exr":
        if len(files) > 1:
            problem = f"is one file, and there are {len(files)} to convert"
            raise UsageProblem("one-file", problem, "name a directory, without .exr", field="out")
        outs = [out]
    else:
        outs = [out / f"{file.stem}.exr" for file in files]
    first: dict[Path, Path] = {}
    for file, target in zip(files, outs, strict=True):
        if first.setdefault(target, file) is not file:
            problem = f"would be written to {target}, and so would {first[target]}"
            raise UsageProblem("duplicate", problem, "convert them to two directories", path=file)
    return [
        DepthTarget(file, target, target.with_suffix(".preview.png") if preview else None)
        for file, target in zip(files, outs, strict=True)
    ]


def refuse_existing(wanted: Sequence[DepthTarget], *, overwrite: bool) -> None:
    """Raise an error if an output would replace an input or, without ``overwrite``, any file."""
    inputs = identities(place.file for place in wanted)
    for path in (path for place in wanted for path in (place.out, place.preview)):
        if path is not None:
            require_replaceable(path, overwrite=overwrite, inputs=inputs)


def convert(place: DepthTarget, reading: Reading) -> dict[str, Any]:
    """Convert a depth file to an EXR in metres; returns size, range and notes for JSON."""
    if reading.row.rule == "radius":
        problem, remedy = "holds radii of a lens, and no depth", _RADII
        raise UsageProblem("radii", problem, remedy, field="depth-format")
    try:
        claimed = describe(place.file).nearly_empty
    except InputError:  # the decoder reports the problem
        claimed = ""
    if claimed:
        remedy = "cut it into smaller pictures"
        raise InputError("too-large", f"has {claimed}", remedy, path=place.file)
    depth = read_depth(place.file, reading)
    require_valid(depth)
    attributes = {
        "defocus:version": versions(),
        "defocus:kind": "depth",
        "defocus:depth": place.file.name,
        "defocus:depth_read_as": depth.note,
    }
    with written_together():
        write_exr(place.out, {"Z": depth.metres}, attributes)
        if place.preview is not None:
            write_depth_preview(place.preview, depth.metres)
    finite = depth.metres[np.isfinite(depth.metres)]
    return {
        "file": str(place.file),
        "out": str(place.out),
        "size": list(depth.metres.shape[::-1]),
        "range_m": [float(finite.min()), float(finite.max())] if finite.size else None,
        "sky_pixels": depth.metres.size - finite.size,
        "replaced_pixels": depth.replaced,
        "note": depth.note,
        "warnings": [*of_file(depth, declared=reading.says_scale), *depth.warnings],
    }

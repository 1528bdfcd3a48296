"""Samples of a finished batch for training scripts, without torch and without pixels.

::

    from defocus_core import samples

    for sample in samples("out"):
        sample.files["render"], sample.files["coc"], sample.lens.fnum
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from defocus_core.batch.datasets.sample_index import NAME
from defocus_core.errors import InputError, Place, cannot_read, reason
from defocus_core.io.below import Folder, path_fault
from defocus_core.io.safe_files import MALFORMED
from defocus_core.request.lens import Lens
from defocus_core.request.parameters import EFFECT_OPTIONS, LENS_FILES


@dataclass(frozen=True)
class Sample:
    """One picture as one lens took it.

    Attributes:
        sample_id: name of the sample, the stem of its files.
        files: the file of each kind.
        inputs: the input file of each role: color, depth, those of hidden and over, and
            depth_sidecar, depth_mask of depth formats that have them.
        lens: the lens, with the focus distance in mm.
        size: width and height in px.
        coc_px: smallest and largest signed radius of the blur.
        quality: of the rendering.
        record: its whole line of the index.
    """

    sample_id: str
    files: Mapping[str, Path]
    inputs: Mapping[str, Path]
    lens: Lens
    size: tuple[int, int]
    coc_px: tuple[float, float]
    quality: str
    record: Mapping[str, Any]


def samples(out: str | os.PathLike[str]) -> Iterator[Sample]:
    """The samples of a finished batch in ``out``, sorted by name.

    Raises:
        InputError: there is no index in ``out``, or a line of it is broken.
    """
    root = Path(out)
    path = root / NAME
    try:
        with Folder(root).open(NAME) as lines:
            for number, line in enumerate(lines, 1):
                yield _sample(root, line, Place(path, f"line {number}"))
    except OSError as error:
        raise cannot_read(path, error, "it is written when a batch ends") from None


def _sample(root: Path, line: bytes, where: Place) -> Sample:
    try:
        record = json.loads(line)
        if fault := next(filter(None, map(path_fault, record["outputs"].values())), None):
            raise ValueError(f"the path of an output {fault}")
        return Sample(
            sample_id=record["sample_id"],
            files={kind: root / path for kind, path in record["outputs"].items()},
            inputs={role: root / path for role, path in record["inputs"].items()},
            lens=_lens(record["lens"], record["inputs"]),
            size=(record["width"], record["height"]),
            coc_px=(record["coc_min_px"], record["coc_max_px"]),
            quality=record["quality"],
            record=record,
        )
    except MALFORMED as error:
        problem = f"is no sample: {type(error).__name__} {reason(error)}"
        raise InputError("malformed", problem, "let the batch write it again", path=where) from None


def _lens(entry: Mapping[str, Any], inputs: Mapping[str, str]) -> Lens:
    shape = {"blades": entry["blades"], "blade_rotation": entry["blade_rotation_deg"]}
    shape |= {
        name: row.parse(entry[name]) if row.separator else entry[name]
        for name, row in EFFECT_OPTIONS.items()
        if entry.get(name) is not None
    }
    shape |= {name: Path(inputs[name]) for name in LENS_FILES if name in inputs}
    if entry["focal_length_mm"] is None:  # the radii came from a file
        return Lens(math.nan, math.nan, None, **shape)
    return Lens(
        foclen=entry["focal_length_mm"],
        fnum=entry["fnumber"],
        foc_dist=math.inf if entry["focus_mm"] is None else entry["focus_mm"],
        focus_at=tuple(entry["focus_at_px"]) if entry["focus_at_px"] else None,
        sensor_width=entry["sensor_width_mm"],
        focus_percentile=entry["focus_percentile"],
        **shape,
    )

"""The samples of a finished batch, for training scripts; reads no pixels and imports no torch.

::

    from defocus_core import samples

    for sample in samples("out"):
        sample.files["render"], sample.files["coc"], sample.lens.fnum
"""

from __future__ import annotations

import json
import math
import os
from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from defocus_core.batch.datasets.sample_index import NAME
from defocus_core.errors import InputError, Place, cannot_read, reason
from defocus_core.io.read_files import MALFORMED
from defocus_core.io.write_files import Folder, path_fault
from defocus_core.request.lens import LensValues
from defocus_core.request.parameters import EFFECT_OPTIONS, LENS_FILES


@dataclass(frozen=True)
class Sample:
    """One picture rendered through one lens."""

    sample_id: str  # its name, the stem of its files
    files: Mapping[str, Path]  # by kind and label
    inputs: Mapping[str, Path]  # by role: color, depth, hidden_color, depth_sidecar, …
    lens: LensValues  # with the focus distance in mm
    size: tuple[int, int]  # width and height in px
    coc_px: tuple[float, float]  # smallest and largest signed radius of the blur
    quality: str
    record: Mapping[str, Any]  # its line of the index


def samples(out: str | os.PathLike[str]) -> Iterator[Sample]:
    """Iterate over the samples of a finished batch in the folder ``out``, sorted by name.

    Raises:
        InputError: There is no index in ``out``, as after an interrupted batch, or one of its lines
            is invalid.
    """
    with _opened(Path(out)) as lines:
        for number, line in enumerate(lines, 1):
            yield _sample(Path(out), line, f"line {number}")


class SampleList:
    """A sequence of samples of a finished batch, each read from the index on access."""

    def __init__(self, out: Path, wanted: Callable[[Mapping[str, Any]], bool]) -> None:
        """Read the index in the folder ``out``; list the samples whose entry satisfies `wanted`."""
        self._out, offset, offsets = out, 0, array("q")
        with _opened(out) as lines:
            self._stamp = _stamp(lines)
            for number, line in enumerate(lines, 1):
                with _told(out, f"line {number}"):
                    entry = _entry(line)
                if wanted(entry):
                    offsets.append(offset)
                offset += len(line)
        self._offsets = offsets

    def __len__(self) -> int:
        return len(self._offsets)

    def __getitem__(self, index: int) -> Sample:
        """Read a sample; an error if the file of the index was written again since this list."""
        offset = self._offsets[index]
        with _opened(self._out) as lines:
            if _stamp(lines) != self._stamp:
                problem = "was written again since its samples were listed"
                raise InputError("changed", problem, "read the list again", path=self._out / NAME)
            lines.seek(offset)
            return _sample(self._out, lines.readline(), f"byte {offset}")


@contextmanager
def _opened(root: Path) -> Iterator[BinaryIO]:
    try:
        with Folder(root).open(NAME) as lines:
            yield lines
    except OSError as error:
        remedy = "it is written when a batch ends"
        if any(root.glob("journal*.jsonl")):
            told = f"'defocus status {root}' says what is left"
            remedy = f"give the command of the batch again, {told}"
        raise cannot_read(root / NAME, error, remedy) from None


def _stamp(file: BinaryIO) -> tuple[int, int, int]:
    """Inode, size and modification time of a file, which change when it is replaced."""
    status = os.fstat(file.fileno())
    return status.st_ino, status.st_size, status.st_mtime_ns


@contextmanager
def _told(root: Path, where: str) -> Iterator[None]:
    """Turn errors of a malformed sample into an InputError that names its line in the index."""
    try:
        yield
    except MALFORMED as error:
        problem = f"is not a sample: {type(error).__name__} {reason(error)}"
        remedy, place = "let the batch write it again", Place(root / NAME, where)
        raise InputError("malformed", problem, remedy, path=place) from None


def _entry(line: bytes) -> dict[str, Any]:
    entry: dict[str, Any] = json.loads(line)
    entry["outputs"].keys(), entry["width"], entry["height"]
    return entry


def _sample(root: Path, line: bytes, where: str) -> Sample:
    with _told(root, where):
        entry = _entry(line)
        if fault := next(filter(None, map(path_fault, entry["outputs"].values())), None):
            raise ValueError(f"the path of an output {fault}")
        return Sample(
            sample_id=entry["sample_id"],
            files={kind: root / path for kind, path in entry["outputs"].items()},
            inputs={role: root / path for role, path in entry["inputs"].items()},
            lens=_lens(entry["lens"], entry["inputs"]),
            size=(entry["width"], entry["height"]),
            coc_px=(entry["coc_min_px"], entry["coc_max_px"]),
            quality=entry["quality"],
            record=entry,
        )


def _lens(entry: Mapping[str, Any], inputs: Mapping[str, str]) -> LensValues:
    shape = {"blades": entry["blades"], "blade_rotation": entry["blade_rotation_deg"]}
    shape |= {
        name: row.parse(entry[name]) if row.separator else entry[name]
        for name, row in EFFECT_OPTIONS.items()
        if entry.get(name) is not None
    }
    shape |= {name: Path(inputs[name]) for name in LENS_FILES if name in inputs}
    if entry["focal_length_mm"] is None:  # the radii came from a file
        return LensValues(math.nan, math.nan, None, **shape)
    return LensValues(
        foclen=entry["focal_length_mm"],
        fnum=entry["fnumber"],
        foc_dist=math.inf if entry["focus_mm"] is None else entry["focus_mm"],
        focus_at=tuple(entry["focus_at_px"]) if entry["focus_at_px"] else None,
        sensor_width=entry["sensor_width_mm"],
        focus_percentile=entry["focus_percentile"],
        **shape,
    )

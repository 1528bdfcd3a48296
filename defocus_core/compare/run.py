"""The comparison of all pairs, in several processes if there are many; difference images.

``NAME.diff.exr`` has B − A of each channel, float. ``NAME.diff.png`` shows the difference of the
colour, amplified, around middle grey; pixels that are NaN or infinite on one side are magenta.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.comparison import compare_pair
from defocus_core.compare.pairing import FilePair
from defocus_core.compare.pixels import Pixels
from defocus_core.compare.record import DIFFERENT, SAME, CompareSettings, Comparison
from defocus_core.compare.thresholds import Thresholds
from defocus_core.io.exr.writing import write_exr
from defocus_core.io.images.encode import write_samples
from defocus_core.io.write_files import DIFFERENCE, KIND, identities, require_replaceable
from defocus_core.system.process import spread

FIRST = 20  # failing pairs whose causes are sought by default
# Number of failing pairs whose causes are sought, by ``--causes``.
CAUSES = {"first": FIRST, "all": math.inf, "none": 0}
_GREY, _HALF = 128, 127  # levels of no difference, and of the greatest on either side
_MAGENTA = (255, 0, 255)
_AMPLIFICATION = "defocus:amplification"


def _write_differences(folder: Path, record: Comparison, pixels: Pixels) -> tuple[Path, ...]:
    """Write both difference images of a pair, named after it."""
    exr, png = _difference_files(folder, record.name)
    with np.errstate(all="ignore"):  # differences may overflow
        signed = {name: pixels.difference(name).astype(np.float32) for name in pixels.names}
        factor, shown = _amplified(pixels, signed)
    apart = None if record.nonfinite is None else record.nonfinite.apart
    if apart is not None:
        shown[apart] = _MAGENTA
        for plane in signed.values():
            plane[apart] = np.float32(np.nan)
    write_exr(exr, signed, {KIND: DIFFERENCE})
    write_samples(png, shown, "png", {KIND: DIFFERENCE, _AMPLIFICATION: f"{factor:g}"})
    return exr, png


def _difference_files(folder: Path, name: str) -> tuple[Path, Path]:
    """The signed and the amplified difference image of a pair."""
    return folder / f"{name}.diff.exr", folder / f"{name}.diff.png"


def _amplified(
    pixels: Pixels, signed: Mapping[str, NDArray[Any]]
) -> tuple[float, NDArray[np.uint8]]:
    """The power of 2 that makes the difference visible, and the amplified picture [H, W, 3]."""
    names = pixels.color[0] if pixels.color else pixels.names[:1]
    if not any(signed[name].any() for name in names):  # the others differ
        names = tuple(name for name in pixels.names if signed[name].any())[:3] or names
        names = names if len(names) == 3 else names[:1]
    difference = np.stack([signed[name] for name in names] * (3 // len(names)), axis=2)
    greatest = np.abs(difference).max(axis=2)
    maximum = float(np.percentile(greatest, 99.9)) or float(greatest.max())
    factor = 2.0 ** np.floor(np.log2(1 / maximum)) if maximum else 1.0
    levels = _GREY + np.rint(np.clip(difference * factor, -1.0, 1.0) * _HALF)
    return float(factor), levels.astype(np.uint8)


@dataclass(frozen=True)
class Task:
    """What to do with each pair."""

    thresholds: Thresholds
    settings: CompareSettings
    images: Path | None = None
    causes: str = "first"

    def require_room(self, pairs: Sequence[FilePair]) -> None:
        """Raise an error if difference images would replace other files, or files to compare."""
        if self.images is not None:
            inputs = identities(path for pair in pairs for path in (pair.a, pair.b) if path)
            for pair in pairs:
                for path in _difference_files(self.images, pair.name):
                    require_replaceable(path, DIFFERENCE, inputs=inputs)

    def carry_out(self, piece: tuple[FilePair, bool]) -> Comparison:
        """Compare a pair, and write its difference images if it differs and they are wanted.

        `piece`: the pair, and whether to search the cause of a difference.
        """
        pair, sought = piece
        settings = replace(self.settings, diagnose=self.settings.diagnose and sought)
        record, pixels = compare_pair(pair, self.thresholds.rules_of(pair.name), settings)
        if self.images is not None and pixels is not None and record.differing:
            return replace(record, images=_write_differences(self.images, record, pixels))
        if self.images is not None and pixels is None and record.status == DIFFERENT:
            note = "no difference images, for no channel has one size in A and B"
            return replace(record, notes=(*record.notes, note))
        return record


def compare_all(pairs: Sequence[FilePair], task: Task, processes: int) -> Iterator[Comparison]:
    """Yield the records of all pairs in order, each as soon as it is known.

    Causes are searched only for the first failing pairs. Which pairs these are does not depend on
    the number of processes.
    """
    most = CAUSES[task.causes]
    pieces = [(pair, number < most) for number, pair in enumerate(pairs)]
    failing = 0
    records = spread(partial(Task.carry_out, task), pieces, processes, "compare")
    for (pair, sought), record in zip(pieces, records, strict=True):
        fails = record.differing > 0 and record.status != SAME
        yield task.carry_out((pair, True)) if fails and not sought and failing < most else record
        failing += fails

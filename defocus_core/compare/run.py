"""All pairs compared, by several processes where there are many."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from defocus_core.compare.comparison import compare_pair
from defocus_core.compare.differences import write_differences
from defocus_core.compare.pairing import FilePair
from defocus_core.compare.record import SAME, CompareSettings, Comparison
from defocus_core.compare.thresholds import Thresholds
from defocus_core.system.process import spread

FIRST = 20  # failing pairs whose causes are sought, where not all are asked for
# How many failing pairs have their causes sought, by what ``--causes`` says.
CAUSES = {"first": FIRST, "all": math.inf, "none": 0}


@dataclass(frozen=True)
class Task:
    """What is to be done with each pair."""

    thresholds: Thresholds
    settings: CompareSettings
    images: Path | None = None
    causes: str = "first"

    def carry_out(self, piece: tuple[FilePair, bool]) -> Comparison:
        """Compare a pair, and write its difference images if it differs and they are wanted."""
        pair, sought = piece
        settings = replace(self.settings, diagnose=self.settings.diagnose and sought)
        record, pixels = compare_pair(pair, self.thresholds.of(pair.name), settings)
        if self.images is not None and pixels is not None and record.differing:
            return replace(record, images=write_differences(self.images, record, pixels))
        return record


def compare_all(pairs: Sequence[FilePair], task: Task, processes: int) -> Iterator[Comparison]:
    """The records of all pairs, in their order, each when it is there.

    Of the first pairs causes are sought at once; of a later one if it fails and is among the first
    that do, so that the same pairs have causes whatever number of processes there is.
    """
    most = CAUSES[task.causes]
    pieces = [(pair, number < most) for number, pair in enumerate(pairs)]
    failing = 0
    records = spread(partial(Task.carry_out, task), pieces, processes, "compare")
    for (pair, sought), record in zip(pieces, records, strict=True):
        fails = record.differing > 0 and record.status != SAME
        yield task.carry_out((pair, True)) if fails and not sought and failing < most else record
        failing += fails

"""All pairs compared, by several processes where there are many."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from defocus_core.compare.comparison import compare_pair
from defocus_core.compare.differences import write_differences
from defocus_core.compare.pairing import FilePair
from defocus_core.compare.record import CompareSettings, Comparison
from defocus_core.compare.thresholds import Thresholds
from defocus_core.system.spreading import spread


@dataclass(frozen=True)
class Task:
    """What is to be done with each pair."""

    thresholds: Thresholds
    settings: CompareSettings
    images: Path | None = None

    def carry_out(self, pair: FilePair) -> Comparison:
        """Compare a pair, and write its difference images if it differs and they are wanted.

        Raises:
            InputError: a difference image cannot be written.
            UsageProblem: the region is not within the picture.
        """
        record, pixels = compare_pair(pair, self.thresholds.of(pair.name), self.settings)
        if self.images is not None and pixels is not None and record.differing:
            return replace(record, images=write_differences(self.images, record, pixels))
        return record


def compare_all(pairs: Sequence[FilePair], task: Task, processes: int) -> Iterator[Comparison]:
    """The records of all pairs, in their order, each when it is there.

    Raises:
        InputError: a process died, or a difference image cannot be written.
        UsageProblem: the region is not within a picture.
    """
    return spread(partial(Task.carry_out, task), pairs, processes, "compare")

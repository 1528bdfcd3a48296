"""All pairs compared, by several processes where there are many."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from defocus_cli.compare.comparison import compare_pair
from defocus_cli.compare.differences import write_differences
from defocus_cli.compare.pairing import Pair
from defocus_cli.compare.record import Comparison, Settings
from defocus_cli.compare.thresholds import Thresholds
from defocus_cli.system.errors import InputError

_FEW = 8  # pairs, for which a process is not worth its start
_AT_ONCE = 4  # pairs that a process is given


@dataclass(frozen=True)
class Task:
    """What is to be done with each pair."""

    thresholds: Thresholds
    settings: Settings
    images: Path | None = None

    def carry_out(self, pair: Pair) -> Comparison:
        """Compare a pair, and write its difference images if it differs and they are wanted.

        Raises:
            InputError: a difference image cannot be written.
            UsageProblem: the region is not within the picture.
        """
        record, pixels = compare_pair(pair, self.thresholds.of(pair.name), self.settings)
        if self.images is not None and pixels is not None and record.differing:
            return replace(record, images=write_differences(self.images, record, pixels))
        return record


def compare_all(pairs: Sequence[Pair], task: Task, processes: int) -> Iterator[Comparison]:
    """The records of all pairs, in their order, each when it is there.

    Raises:
        InputError: a process died, or a difference image cannot be written.
        UsageProblem: the region is not within a picture.
    """
    if processes < 2 or len(pairs) < _FEW:
        yield from map(task.carry_out, pairs)
        return
    context = multiprocessing.get_context("spawn")
    workers = min(processes, -(-len(pairs) // _AT_ONCE))
    with ProcessPoolExecutor(workers, context, initializer=_begin) as pool:
        try:
            yield from pool.map(partial(Task.carry_out, task), pairs, chunksize=_AT_ONCE)
        except BrokenProcessPool:
            problem = "a process that compares died, perhaps for want of memory"
            raise InputError("compare", problem, "use fewer --processes") from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _begin() -> None:
    """Leave Ctrl-C to the process that started this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

"""Work spread over processes, where there is enough of it."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from defocus_core.errors import InputError

_FEW = 8  # pieces, for which a process is not worth its start
_AT_ONCE = 4  # pieces that a process is given

T = TypeVar("T")
R = TypeVar("R")


def spread(
    work: Callable[[T], R], pieces: Sequence[T], processes: int, subject: str
) -> Iterator[R]:
    """The result of each piece, in their order, each when it is there."""
    if processes < 2 or len(pieces) < _FEW:
        yield from map(work, pieces)
        return
    context = multiprocessing.get_context("spawn")
    workers = min(processes, -(-len(pieces) // _AT_ONCE))
    with ProcessPoolExecutor(workers, context, initializer=_begin) as pool:
        try:
            yield from pool.map(work, pieces, chunksize=_AT_ONCE)
        except BrokenProcessPool:
            problem = f"a process of {subject} died, perhaps for want of memory"
            remedy = "use fewer ‹processes›"
            raise InputError("worker-died", problem, remedy, path=subject) from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _begin() -> None:
    """Leave Ctrl-C to the process that started this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

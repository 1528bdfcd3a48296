"""Settings of a process that renders, and work spread over processes where there is enough of it.

Each thread works on tiles, and torch uses one thread inside it: more would only wait for each
other. The interpreter switches threads more often than usual, since the steps of a tile are short
and a thread that waits 5 ms misses many. The memory of one tile is kept for the next.
"""

from __future__ import annotations

import atexit
import gc
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from defocus_core.errors import InputError
from defocus_core.system import memory

_SWITCH_SECONDS = 5e-4


def cores() -> int:
    """The number of cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def set_to_render() -> None:
    """Set this process up for rendering; harmless when called again."""
    import torch

    torch.set_num_threads(1)
    sys.setswitchinterval(_SWITCH_SECONDS)
    memory.keep_freed()


@contextmanager
def imports() -> Iterator[None]:
    """Exclude the modules imported in the block from later garbage collections."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if not gc.get_freeze_count():  # a second time, there may be garbage to keep
            gc.freeze()
            atexit.register(gc.unfreeze)  # libraries expect to be cleared away at the end
        if collecting:
            gc.enable()


@contextmanager
def settings_kept() -> Iterator[None]:
    """Leave torch's threads and the interpreter's switching after the block as they were."""
    import torch

    threads, interval = torch.get_num_threads(), sys.getswitchinterval()
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        sys.setswitchinterval(interval)


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
    import multiprocessing
    from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor

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
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)

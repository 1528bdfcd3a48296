"""A process that renders: its settings, and the signals that end it.

Each thread works on tiles, and torch uses a single thread within it, as more threads would wait for
each other. The interpreter switches threads more often than usual, since the steps of a tile are
short and a thread that waits 5 ms misses many. The memory of one tile is kept for the next.

After the first Ctrl-C the pictures that were begun are finished; the second one stops at once.
SIGTERM and SIGHUP stop at once, since their sender may not wait: no file is left half written.
"""

from __future__ import annotations

import atexit
import ctypes
import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

from defocus_core.errors import InputError
from defocus_core.system import memory
from defocus_core.system.text import note

_SWITCH_SECONDS = 5e-4


def cores() -> int:
    """The number of cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def set_to_render() -> None:
    """Set this process up for rendering; harmless when called again."""
    load_torch()
    sys.setswitchinterval(_SWITCH_SECONDS)
    memory.keep_freed()


def is_torch_loaded() -> bool:
    """Whether torch was imported, which takes a second and is not needed by compiled loops."""
    return "torch" in sys.modules


def load_torch() -> None:
    """Import torch, and let it use one thread for each operation."""
    with delayed_signals(), imports():
        import torch
    if _TorchThreads.threads is None:
        _TorchThreads.threads = torch.get_num_threads()
    torch.set_num_threads(1)


def may_have_gpu() -> bool:
    """Whether a driver is installed with which torch may find a GPU; torch is not imported."""
    if is_torch_loaded() or Path("/dev/kfd").exists():
        return True
    for name in ("libcuda.so.1", "nvcuda.dll"):
        with suppress(OSError):
            ctypes.CDLL(name)
            return True
    return False


class _TorchThreads:
    """The number of torch's threads before the first `set_to_render`; None until then."""

    threads: int | None = None


@contextmanager
def imports() -> Iterator[None]:
    """Exclude the modules imported in the block from later garbage collections."""
    with memory.without_collections():
        yield
        if not gc.get_freeze_count():  # there may be garbage the second time
            gc.freeze()
            atexit.register(gc.unfreeze)  # libraries expect to be collected at the end


@contextmanager
def settings_kept() -> Iterator[None]:
    """Restore torch's threads and the interpreter's switch interval after the block."""
    threads, interval = None, sys.getswitchinterval()
    if is_torch_loaded():
        threads = sys.modules["torch"].get_num_threads()
    try:
        yield
    finally:
        if count := threads or _TorchThreads.threads:
            sys.modules["torch"].set_num_threads(count)
        sys.setswitchinterval(interval)


_FEW = 8  # pieces, below which a process is not worth its start
_AT_ONCE = 4  # pieces that a process is given at once

T = TypeVar("T")
R = TypeVar("R")


def spread(
    work: Callable[[T], R], pieces: Sequence[T], processes: int, subject: str
) -> Iterator[R]:
    """Yield the result of each piece of work, in the order of the pieces.

    Args:
        work: Computes the result of a piece.
        pieces: What to compute.
        processes: Number of processes; below 2, or with few pieces, this process does the work.
        subject: What the pieces are, for the error if a process dies.
    """
    if processes < 2 or len(pieces) < _FEW:
        yield from map(work, pieces)
        return
    import multiprocessing
    from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor

    context = multiprocessing.get_context("spawn")
    workers = min(processes, -(-len(pieces) // _AT_ONCE))
    # Ctrl-C is left to this process
    ignoring = signal.SIGINT, signal.SIG_IGN
    with ProcessPoolExecutor(workers, context, signal.signal, ignoring) as pool:
        try:
            yield from pool.map(work, pieces, chunksize=_AT_ONCE)
        except BrokenProcessPool:
            problem = f"a process of {subject} died, perhaps for want of memory"
            remedy = "use fewer ‹processes›"
            raise InputError("worker-died", problem, remedy, path=subject) from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


class Terminated(BaseException):
    """Raised for a signal of the system that ends this process; ``number`` is its number."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number

    @property
    def signal_name(self) -> str:
        """The name of the signal, like SIGTERM."""
        return signal.Signals(self.number).name


@contextmanager
def terminations() -> Iterator[None]:
    """Raise `Terminated` in the block at the first signal that would end the process."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, _: FrameType | None) -> None:
        for other in before:
            signal.signal(other, signal.SIG_IGN)
        raise Terminated(number)

    # A signal that nohup ignores stays ignored.
    before = [number for number in _ENDING if signal.getsignal(number) == signal.SIG_DFL]
    for number in before:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in before:
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def delayed_signals() -> Iterator[None]:
    """Delay signals that arrive in the block until its end, as they could break an import."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: arrived.append(number))
        for number in (signal.SIGINT, *_ENDING)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for number in arrived:
        signal.raise_signal(number)


class Interrupts:
    """A context in which the first Ctrl-C sets ``asked``, and the second one raises.

    If it is not `patient`, the first one raises, too.
    """

    def __init__(self, *, patient: bool) -> None:
        self.asked = False
        self._patient = patient
        self._before: Any = None

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._pressed)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _pressed(self, number: int, frame: FrameType | None) -> None:
        if self.asked or not self._patient:
            raise KeyboardInterrupt
        self.asked = True
        note("finishing what is being rendered; press Ctrl-C again to stop at once")

"""The renderer's own modes of torch, whatever the caller's are."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import wraps
from typing import ParamSpec, TypeVar

import torch

P = ParamSpec("P")
R = TypeVar("R")


def graph_break(function: Callable[P, R]) -> Callable[P, R]:
    """The same function, which `torch.compile` of a caller leaves as it is.

    What it does hangs on the values of tensors: to compile it takes minutes, and fails.
    """
    uncompiled: Callable[P, R] | None = None

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        nonlocal uncompiled
        if "_dynamo" not in vars(torch):  # nobody compiles, and to load it takes a second
            return function(*args, **kwargs)
        if uncompiled is None:
            uncompiled = torch.compiler.disable(function)  # type: ignore[no-untyped-call]
        return uncompiled(*args, **kwargs)

    return call


@contextmanager
def own_modes(device: torch.device | None = None) -> Iterator[None]:
    """No autocast on the CPU and on a device, the CPU as default device, and torch in one thread.

    Autocast would round to 8 or 11 bits, and only in the thread in which it is switched on.
    """
    kinds = {"cpu", device.type if device else "cpu"}
    with ExitStack() as modes:
        modes.enter_context(_one_thread())
        for kind in kinds:
            if torch.amp.is_autocast_available(kind):
                modes.enter_context(torch.autocast(kind, enabled=False))
        if torch.get_default_device().type != "cpu":
            modes.enter_context(torch.device("cpu"))
        yield


class _Threads(threading.local):
    """Whether a thread is in `own_modes`; and, of the process, the callers' number of threads."""

    lock = threading.Lock()
    inside = 0  # calls of all threads that have not returned yet
    callers = 1
    alone = False  # of this thread: torch uses one thread in it


_THREADS = _Threads()


@contextmanager
def _one_thread() -> Iterator[None]:
    """One thread for each operation of torch; the caller's number afterwards.

    The operations are small, and there are thousands: threads that share one wait for each other,
    up to 18 times as long as the operation takes. torch keeps the number for each thread, and one
    for new threads, which the last call that returns sets back.
    """
    if _THREADS.alone:
        yield
        return
    with _Threads.lock:
        if not _Threads.inside:
            _Threads.callers = torch.get_num_threads()
        _Threads.inside += 1
        torch.set_num_threads(1)
    _THREADS.alone = True
    try:
        yield
    finally:
        _THREADS.alone = False
        with _Threads.lock:
            _Threads.inside -= 1
            torch.set_num_threads(_Threads.callers)

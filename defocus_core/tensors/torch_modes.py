"""The renderer's own modes of torch, and what a backward pass repeats in them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import wraps
from typing import ParamSpec, TypeVar, cast

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

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


T = TypeVar("T")
S = TypeVar("S")


def recomputed(work: Callable[[T], S]) -> Callable[[T], S]:
    """The same work, repeated by a backward pass where gradients are enabled.

    A backward pass then holds the tensors of one piece of work, not of all (Chen et al. 2016).
    """
    if not torch.is_grad_enabled():
        return work

    def in_own_modes(piece: T) -> S:
        with own_modes():  # of the caller's modes, checkpoint restores autocast alone
            return work(piece)

    def again(piece: T) -> S:
        result = checkpoint(in_own_modes, piece, use_reentrant=False, preserve_rng_state=False)
        return cast(S, result)

    return again


def recorded_for(*given: object) -> AbstractContextManager[None]:
    """Gradients, if the caller has enabled them and any of some tensors or options needs one."""
    return torch.set_grad_enabled(torch.is_grad_enabled() and any(map(requires_grad, given)))


def requires_grad(given: object) -> bool:
    """Whether a tensor needs a gradient, or one in a tuple, or an attribute of an object."""
    if isinstance(given, Tensor):
        return given.requires_grad
    if isinstance(given, tuple | list):
        return any(map(requires_grad, given))
    return any(map(requires_grad, getattr(given, "__dict__", {}).values()))


def unrecorded(device: torch.device) -> AbstractContextManager[None]:
    """Inference mode on a CPU unless gradients are enabled: faster than without gradients alone.

    Elsewhere tensors may be of classes that are no part of torch, which inference mode refuses.

    Tensors computed within can take no part in a later backward pass; results are joined outside.
    """
    if torch.is_grad_enabled() or device.type != "cpu":
        return nullcontext()
    return torch.inference_mode()

"""Work in threads, and the torch modes in which it runs, also when a backward pass repeats it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import wraps
from typing import ParamSpec, TypeVar, cast

from defocus_core.tensors.later import Tensor, torch

T = TypeVar("T")
R = TypeVar("R")
P = ParamSpec("P")


def threaded(work: Callable[[T], R], pieces: Sequence[T], threads: int) -> Iterator[R]:
    """Yield the result of `work` on each piece, in order, computed by `threads` threads.

    Each thread has the torch modes of the calling thread.
    """
    return in_threads(carried(work), pieces, threads)


def in_threads(work: Callable[[T], R], pieces: Sequence[T], threads: int) -> Iterator[R]:
    """Yield the result of `work`, which must not use torch, on each piece, in order.

    `threads`: number of threads.
    """
    if threads == 1 or len(pieces) < 2:
        yield from map(work, pieces)
        return
    with ThreadPoolExecutor(threads) as pool:
        yield from pool.map(work, pieces)


def carried(work: Callable[[T], R]) -> Callable[[T], R]:
    """`work`, wrapped to run in the caller's present gradient and inference modes on any thread."""
    gradient, inference = torch.is_grad_enabled(), torch.is_inference_mode_enabled()

    def in_modes(piece: T) -> R:
        torch.get_num_threads()  # a new thread would run transforms on all cores
        with torch.inference_mode(inference), torch.set_grad_enabled(gradient):
            return work(piece)

    return in_modes


def graph_break(function: Callable[P, R]) -> Callable[P, R]:
    """`function`, excluded from a caller's `torch.compile`.

    What it does depends on the values of tensors, so that compiling takes minutes, and fails.
    """
    uncompiled: Callable[P, R] | None = None

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        nonlocal uncompiled
        import torch

        if "_dynamo" not in vars(torch):  # importing torch._dynamo takes a second
            return function(*args, **kwargs)
        if uncompiled is None:
            uncompiled = torch.compiler.disable(function)  # type: ignore[no-untyped-call]
        return uncompiled(*args, **kwargs)

    return call


@contextmanager
def own_modes(device: torch.device | None = None) -> Iterator[None]:
    """Run a block without autocast, with the CPU as default device, and with torch in one thread.

    Autocast is off on the CPU and on `device`: it would round to 8 or 11 bits, and only in the
    thread in which it was switched on.
    """
    kinds = {"cpu", getattr(device, "type", "cpu")}
    with ExitStack() as modes:
        modes.enter_context(_one_thread())
        for kind in kinds:
            if torch.amp.is_autocast_available(kind):
                modes.enter_context(torch.autocast(kind, enabled=False))
        if torch.get_default_device().type != "cpu":
            modes.enter_context(torch.device("cpu"))
        yield


class _Threads(threading.local):
    """State of `_one_thread`: `alone` is kept per thread, the other attributes per process."""

    lock = threading.Lock()
    inside = 0  # calls of all threads that have not returned yet
    callers = 1
    alone = False  # of this thread: torch uses one thread in it


_THREADS = _Threads()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Run each torch operation of a block in one thread; then restore the caller's number.

    There are thousands of small operations: threads that share an operation wait for each other, up
    to 18 times as long as it takes. torch keeps a number for each thread, and a number for new
    threads, which the last block to end restores.
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


def recomputed(work: Callable[[T], R]) -> Callable[[T], R]:
    """`work`, whose tensors are not kept for the backward pass, but computed again in it.

    The backward pass then holds the tensors of one piece of work at a time (Chen et al. 2016). If
    gradients are disabled, it is `work` itself.
    """
    if not torch.is_grad_enabled():
        return work

    def in_own_modes(piece: T) -> R:
        with own_modes():  # of the caller's modes, checkpoint restores autocast alone
            return work(piece)

    def again(piece: T) -> R:
        result = torch.utils.checkpoint.checkpoint(
            in_own_modes, piece, use_reentrant=False, preserve_rng_state=False
        )
        return cast(R, result)

    return again


def refuse_second_derivatives(gradient: Tensor) -> None:
    """As a hook of rendered tensors, raise ValueError in a backward pass with create_graph=True."""
    if torch.is_grad_enabled():
        problem = "what is rendered has no second derivatives"
        raise ValueError(f"create_graph must be False, got True; {problem}")


def recorded_for(*given: object) -> AbstractContextManager[None]:
    """Enable gradients if the caller has enabled them, and a tensor or an option requires one."""
    return torch.set_grad_enabled(torch.is_grad_enabled() and any(map(requires_grad, given)))


def requires_grad(given: object) -> bool:
    """Whether a tensor requires a gradient.

    For a tuple, a list or another object: whether any tensor in it or in its attributes does.
    """
    if isinstance(given, Tensor):
        return given.requires_grad
    if isinstance(given, tuple | list):
        return any(map(requires_grad, given))
    return any(map(requires_grad, getattr(given, "__dict__", {}).values()))

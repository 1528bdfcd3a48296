"""Independent pieces of work on a few threads, in the caller's gradient and inference modes.

At most some results wait to be taken: whoever takes them slowly is not overrun. Who renders may
share pieces out to others than threads, too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Protocol, TypeVar

import torch

# Pieces for each thread that are begun before the first of them is taken.
AHEAD = 3

T = TypeVar("T")
R = TypeVar("R")


class Sharing(Protocol):
    """How pieces of work are shared out. It is not asked again for what a piece itself shares."""

    def __call__(
        self, work: Callable[[Any], Any], pieces: Sequence[Any], threads: int, last: bool
    ) -> Iterator[Any]:
        """The results of work on each piece, in order; the arguments are those of `threaded`."""


_SHARING: ContextVar[Sharing | None] = ContextVar("sharing", default=None)


@contextmanager
def shared(sharing: Sharing | None) -> Iterator[None]:
    """In the block, pieces of work are shared out like this; None is by threads."""
    before = _SHARING.set(sharing)
    try:
        yield
    finally:
        _SHARING.reset(before)


def threaded(
    work: Callable[[T], R], pieces: Sequence[T], threads: int, *, last: bool = False
) -> Iterator[R]:
    """The results of work on each piece, in order, `threads` pieces at a time.

    Args:
        work: What is done.
        pieces: What it is done with.
        threads: How many at once.
        last: Whether nothing that is computed later depends on the results.
    """
    if threads == 1 or len(pieces) < 2:
        yield from map(work, pieces)
        return
    if (sharing := _SHARING.get()) is not None:
        yield from sharing(work, pieces, threads, last)
        return
    with ThreadPoolExecutor(threads) as pool:
        begun: deque[Future[R]] = deque()
        in_modes = carried(work)
        try:
            for piece in pieces:
                begun.append(pool.submit(in_modes, piece))
                if len(begun) > AHEAD * threads:
                    yield begun.popleft().result()
            while begun:
                yield begun.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


def carried(work: Callable[[T], R]) -> Callable[[T], R]:
    """Work in the modes of the thread that calls this, on whatever thread it is done."""
    gradient, inference = torch.is_grad_enabled(), torch.is_inference_mode_enabled()

    def in_modes(piece: T) -> R:
        torch.get_num_threads()  # before that a new thread transforms with those of all cores
        with torch.inference_mode(inference), torch.set_grad_enabled(gradient):
            return work(piece)

    return in_modes

"""Independent pieces of work on a few threads, with the caller's gradient mode."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch

T = TypeVar("T")
R = TypeVar("R")


def threaded(work: Callable[[T], R], pieces: Sequence[T], threads: int) -> Iterator[R]:
    """The results of work on each piece, in order, `threads` pieces at a time."""
    if threads == 1 or len(pieces) < 2:
        yield from map(work, pieces)
        return
    gradient = torch.is_grad_enabled()

    def piece_of_work(piece: T) -> R:
        with torch.set_grad_enabled(gradient):  # the mode belongs to the thread
            return work(piece)

    with ThreadPoolExecutor(threads) as pool:
        try:
            yield from pool.map(piece_of_work, pieces)
        finally:
            pool.shutdown(cancel_futures=True)

"""Work in threads, in the caller's gradient and inference modes.

The number of results that wait for the caller is bounded.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import torch

# Pieces for each thread that are begun before the first result is taken.
AHEAD = 3

T = TypeVar("T")
R = TypeVar("R")


def threaded(work: Callable[[T], R], pieces: Sequence[T], threads: int) -> Iterator[R]:
    """The results of work on each piece, in order, `threads` pieces at a time."""
    if threads == 1 or len(pieces) < 2:
        return map(work, pieces)
    return _in_threads(work, pieces, threads)


def _in_threads(work: Callable[[T], R], pieces: Sequence[T], threads: int) -> Iterator[R]:
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
    """The same work in the modes of the calling thread, on any thread."""
    gradient, inference = torch.is_grad_enabled(), torch.is_inference_mode_enabled()

    def in_modes(piece: T) -> R:
        torch.get_num_threads()  # else a new thread runs transforms on all cores
        with torch.inference_mode(inference), torch.set_grad_enabled(gradient):
            return work(piece)

    return in_modes

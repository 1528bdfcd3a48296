"""Independent pieces of work on a few threads, in the caller's gradient and inference modes.

At most some results wait to be taken: whoever takes them slowly is not overrun.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import torch

# Pieces for each thread that are begun before the first of them is taken.
AHEAD = 3

T = TypeVar("T")
R = TypeVar("R")


def threaded(work: Callable[[T], R], pieces: Sequence[T], threads: int) -> Iterator[R]:
    """The results of work on each piece, in order, `threads` pieces at a time."""
    if threads == 1 or len(pieces) < 2:
        yield from map(work, pieces)
        return
    gradient, inference = torch.is_grad_enabled(), torch.is_inference_mode_enabled()

    def piece_of_work(piece: T) -> R:
        # modes belong to the thread
        with torch.inference_mode(inference), torch.set_grad_enabled(gradient):
            return work(piece)

    with ThreadPoolExecutor(threads) as pool:
        begun: deque[Future[R]] = deque()
        try:
            for piece in pieces:
                begun.append(pool.submit(piece_of_work, piece))
                if len(begun) > AHEAD * threads:
                    yield begun.popleft().result()
            while begun:
                yield begun.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)

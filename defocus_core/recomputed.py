"""Work whose intermediate results a backward pass computes again instead of keeping them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import torch
from torch.utils.checkpoint import checkpoint

T = TypeVar("T")
R = TypeVar("R")


def recomputed(work: Callable[[T], R]) -> Callable[[T], R]:
    """The same work; where gradients are wanted it is done again when they are.

    A backward pass then holds what one piece of work needs, not what all do (Chen et al. 2016).
    """
    if not torch.is_grad_enabled():
        return work

    def again(piece: T) -> R:
        result = checkpoint(work, piece, use_reentrant=False, preserve_rng_state=False)
        return cast(R, result)

    return again

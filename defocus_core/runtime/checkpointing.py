"""Checkpointing: what is recomputed, not kept, for a backward pass."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TypeVar, cast

import torch
from torch.utils.checkpoint import checkpoint

from defocus_core.runtime.torch_modes import own_modes

T = TypeVar("T")
R = TypeVar("R")


def recomputed(work: Callable[[T], R]) -> Callable[[T], R]:
    """The same work; where gradients are wanted it is done again when they are.

    A backward pass then holds what one piece of work needs, not what all do (Chen et al. 2016).
    """
    if not torch.is_grad_enabled():
        return work

    def worked(piece: T) -> R:
        with own_modes():  # a backward pass comes in others, but for autocast
            return work(piece)

    def again(piece: T) -> R:
        result = checkpoint(worked, piece, use_reentrant=False, preserve_rng_state=False)
        return cast(R, result)

    return again


def unrecorded() -> AbstractContextManager[None]:
    """Where no gradients are wanted, work is faster still in torch's inference mode.

    What is made within can take no part in a later backward pass: it is put together outside.
    """
    return torch.inference_mode(not torch.is_grad_enabled())

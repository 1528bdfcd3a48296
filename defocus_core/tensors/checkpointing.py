"""Checkpointing: recompute tensors in a backward pass instead of keeping them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TypeVar, cast

import torch
from torch.utils.checkpoint import checkpoint

from defocus_core.tensors.torch_modes import own_modes

T = TypeVar("T")
R = TypeVar("R")


def recomputed(work: Callable[[T], R]) -> Callable[[T], R]:
    """The same work, repeated by a backward pass where gradients are enabled.

    A backward pass then holds the tensors of one piece of work, not of all (Chen et al. 2016).
    """
    if not torch.is_grad_enabled():
        return work

    def in_own_modes(piece: T) -> R:
        with own_modes():  # of the caller's modes, checkpoint restores autocast alone
            return work(piece)

    def again(piece: T) -> R:
        result = checkpoint(in_own_modes, piece, use_reentrant=False, preserve_rng_state=False)
        return cast(R, result)

    return again


def unrecorded() -> AbstractContextManager[None]:
    """Inference mode unless gradients are enabled: faster than without gradients alone.

    Tensors computed within can take no part in a later backward pass; results are joined outside.
    """
    return torch.inference_mode(not torch.is_grad_enabled())

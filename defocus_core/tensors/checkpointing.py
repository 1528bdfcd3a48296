"""Checkpointing: recompute tensors in a backward pass instead of keeping them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import TypeVar, cast

import torch
from torch import Tensor
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

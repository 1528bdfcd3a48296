"""Devices that are not the CPU, for tests: the pretended one, and a GPU where there is one."""

from collections.abc import Callable
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import NamedTuple

import pytest
import torch
import torch.utils.checkpoint
from launches import Launches
from pretended_device import NAME, here, pretended, there
from torch import Tensor

# What was counted since `elsewhere` was entered, in the forward and in each backward pass.
_counted: list[Launches] = []


def waits():
    """How often the host waited for the pretended device."""
    return sum(counts.waits for counts in _counted)


@contextmanager
def elsewhere():
    """Where the pretended device is known."""
    _counted.clear()
    with _known(), pytest.MonkeyPatch.context() as patch:
        # views of what was made in another mode have no version, of subclasses
        patch.setattr(torch, "inference_mode", lambda mode=True: nullcontext())
        checkpoint = torch.utils.checkpoint.checkpoint

        def again(work, *args, **options):
            def worked(*pieces):
                with _known():  # modes are those of whom the backward pass belongs to
                    return work(*pieces)

            return checkpoint(worked, *args, **options)

        patch.setattr(torch.utils.checkpoint, "checkpoint", again)
        yield


@contextmanager
def _known():
    with pretended(), Launches(NAME) as counts:
        _counted.append(counts)
        yield


class Device(NamedTuple):
    """A device that is not the CPU, pretended or real."""

    name: str  # as torch has it
    there: Callable[[Tensor], Tensor]  # takes a tensor to it
    here: Callable[[Tensor], Tensor]  # takes a tensor of it to the CPU
    known: Callable[[], AbstractContextManager[None]]  # where it is known
    within: float  # greatest difference from pictures of the CPU, by rounding


PRETENDED = Device(NAME, there, here, elsewhere, 2e-6)
CPU = Device("cpu", lambda x: x, lambda x: x, nullcontext, 1e-6)
CUDA = Device("cuda", lambda x: x.to("cuda"), lambda x: x.cpu(), nullcontext, 1e-4)
DEVICES = [
    pytest.param(PRETENDED, id="pretended"),
    pytest.param(
        CUDA,
        id="cuda",
        marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU"),
    ),
]

"""The renderer's own modes of torch, whatever the caller's are."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import torch


@contextmanager
def own_modes(device: torch.device | None = None) -> Iterator[None]:
    """No autocast on the CPU and on a device, and the CPU as default device.

    Autocast would round to 8 or 11 bits, and only in the thread in which it is switched on.
    """
    kinds = {"cpu", device.type if device else "cpu"}
    with ExitStack() as modes:
        for kind in kinds:
            if torch.amp.is_autocast_available(kind):
                modes.enter_context(torch.autocast(kind, enabled=False))
        if torch.get_default_device().type != "cpu":
            modes.enter_context(torch.device("cpu"))
        yield

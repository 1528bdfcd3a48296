"""Settings of a process that renders: torch threads, the allocator, garbage collection.

Threads work on tiles, torch itself uses one: its own threads inside each would only wait for one
another. The interpreter is handed on more often than usual: steps of a tile are short, and a thread
that waits 5 ms misses many. And memory of one tile is kept for the next.
"""

from __future__ import annotations

import atexit
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from defocus_cli.system import memory

_SWITCH_SECONDS = 5e-4


def set_to_render() -> None:
    """To be called before anything is rendered; again is harmless."""
    import torch

    torch.set_num_threads(1)
    sys.setswitchinterval(_SWITCH_SECONDS)
    memory.keep_freed(True)


@contextmanager
def imports() -> Iterator[None]:
    """What is imported within, and all that is there by then, is not looked through any more."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if not gc.get_freeze_count():  # later there may be garbage among it
            gc.freeze()
            atexit.register(gc.unfreeze)  # libraries expect to be cleared away at the end
        if collecting:
            gc.enable()

"""How the threads of this process share the machine: they work on tiles, torch itself uses one.

Torch's own threads inside each would only wait for one another. The interpreter is handed on more
often than usual: steps of a tile are short, and a thread that waits 5 ms misses many.
"""

from __future__ import annotations

import sys

_SWITCH_SECONDS = 5e-4


def leave_threads_to_tiles() -> None:
    """To be called before anything is rendered; again is harmless."""
    import torch

    torch.set_num_threads(1)
    sys.setswitchinterval(_SWITCH_SECONDS)

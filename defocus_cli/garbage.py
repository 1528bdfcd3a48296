"""When the interpreter looks for garbage: not while modules are imported, nor among what they made.

That is hundreds of thousands of objects, and none of them garbage. Python looks through them again
and again as they become more, which takes a tenth of the time that PyTorch's import does.
"""

from __future__ import annotations

import atexit
import gc
from collections.abc import Iterator
from contextlib import contextmanager


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

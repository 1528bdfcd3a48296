"""The coverage of an element, computed where it is read."""

from __future__ import annotations

from typing import Any

import numpy as np

from defocus_core.io.arrays import computed


def coverage(shape: tuple[int, int], alpha: Any) -> Any:
    """The share of each pixel that a picture covers: its alpha within 0 … 1, or 1 without one."""
    if alpha is None:
        return np.broadcast_to(np.float32(1), shape)
    return computed(lambda a: np.clip(np.asarray(a, np.float32), 0, 1), alpha, dtype=np.float32)

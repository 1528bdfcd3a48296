"""Arrays [H, W] of an element and its plate, computed where they are read."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from defocus_core.io.arrays import computed

if TYPE_CHECKING:
    from numpy.typing import NDArray


def coverage(shape: tuple[int, int], alpha: Any) -> Any:
    """The share of each pixel that a picture covers: its alpha within 0 … 1, or 1 without one."""
    import numpy as np

    if alpha is None:
        return np.broadcast_to(np.float32(1), shape)
    return computed(lambda a: np.clip(np.asarray(a, np.float32), 0, 1), alpha, dtype=np.float32)


class Either:
    """The first of two arrays, and the second where the first has nothing.

    Attributes:
        arrays: both.
    """

    def __init__(self, first: Any, nothing: Any, second: Any) -> None:
        self.arrays, self._nothing = (first, second), nothing
        self.shape, self.dtype = first.shape, first.dtype

    def __getitem__(self, window: Any) -> NDArray[Any]:
        import numpy as np

        first, second = (array[window] for array in self.arrays)
        if self._nothing is not None:
            first = np.where(self._nothing[window], second, first)
        return np.asarray(first)

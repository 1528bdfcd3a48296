"""Arrays [H, W] of an element and its plate, computed where they are read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from defocus_core.tensors.source import Pixels


class Coverage:
    """The share of each pixel that a picture covers: its alpha within 0 … 1, or 1 without one."""

    def __init__(self, shape: tuple[int, int], alpha: Any) -> None:
        import numpy as np

        self.shape, self.dtype, self._alpha = shape, np.dtype(np.float32), alpha

    def __getitem__(self, window: Any) -> NDArray[Any]:
        import numpy as np

        if self._alpha is not None:
            return np.clip(np.asarray(self._alpha[window], np.float32), 0, 1)
        cuts = window if isinstance(window, tuple) else (window, slice(None))
        sizes = (len(range(*cut.indices(n))) for cut, n in zip(cuts, self.shape, strict=True))
        return np.ones(tuple(sizes), np.float32)


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


class Both:
    """Where two pictures have nothing."""

    def __init__(self, first: Any, second: Any) -> None:
        self._arrays = (first, second)
        self.shape, self.dtype = first.shape, first.dtype

    def __getitem__(self, window: Any) -> NDArray[Any]:
        first, second = self._arrays
        result: NDArray[Any] = first[window] & second[window]
        return result


class LayerWindows:
    """Sources [..., H, W] of one size as one of `defocus_core`: [L, ..., H, W] of float32."""

    def __init__(self, pictures: Sequence[Pixels]) -> None:
        import torch

        self._pictures = pictures
        self.shape = (len(pictures), *pictures[0].shape)
        self.dtype, self.device = torch.float32, pictures[0].device

    def __getitem__(self, window: Any) -> torch.Tensor:
        import torch

        return torch.stack([picture[window].to(self.dtype) for picture in self._pictures])

"""Pictures as the torch folders read them: tensors of windows, made where they are needed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.io.arrays import LazyArray

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from defocus_core.tensors.source import Pixels


def windows(planes: Sequence[Any], device: str) -> LazyArray:
    """NumPy's arrays [H, W] as a picture [C, H, W] on a device."""
    planes = tuple(planes)
    shape = len(planes), *planes[0].shape
    return _source(shape, planes[0].dtype, device, lambda at: np.stack([p[at] for p in planes]))


def map_windows(plane: Any, device: str) -> LazyArray:
    """An array [H, W] of NumPy as tensors on a device."""
    return _source(plane.shape, plane.dtype, device, lambda at: plane[at])


def _source(shape: Sequence[int], dtype: Any, device: str, read: Callable[..., Any]) -> LazyArray:
    """Tensors of a type of NumPy's, of what is read in slices of rows and columns."""
    import torch

    on = torch.device(device)

    def tensor(window: Any) -> Tensor:
        cuts = window if isinstance(window, tuple) else (window,)
        return to_device(read(tuple(cut for cut in cuts if cut is not Ellipsis)), on)

    return LazyArray(shape, torch.from_numpy(np.empty(0, dtype)).dtype, tensor, on)


def layer_windows(pictures: Sequence[Pixels]) -> LazyArray:
    """Pictures [..., H, W] of one size as one [L, ..., H, W] of float32."""
    import torch

    def read(window: Any) -> Tensor:
        return torch.stack([picture[window].to(torch.float32) for picture in pictures])

    shape = (len(pictures), *pictures[0].shape)
    return LazyArray(shape, torch.float32, read, pictures[0].device)


def to_device(values: Any, device: torch.device) -> Tensor:
    """An array as a tensor on a device; the copy to a GPU goes on while the CPU works."""
    import torch

    tensor = torch.from_numpy(values)
    if device.type != "cuda":
        return tensor.to(device)
    return tensor.pin_memory().to(device, non_blocking=True)


def to_array(values: Tensor) -> Any:
    """A tensor as an array in memory, after waiting for the work on the GPU that it needs."""
    import torch

    if not values.is_cuda:
        return values.cpu().numpy()
    held = torch.empty(values.shape, dtype=values.dtype, pin_memory=True)
    held.copy_(values, non_blocking=True)
    torch.cuda.current_stream(values.device).synchronize()
    return held.numpy()

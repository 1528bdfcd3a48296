"""Samples of data sets, as transforms pass them on: mappings of pictures, depth, masks and more.

A picture is a tensor [C, H, W], of a class of `torchvision.tv_tensors` or plain, or an array
[H, W, C] as of albumentations; a map is [1, H, W] or [H, W]. Results are of the same kinds.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

Sample = dict[str, Any]


def planes_of(name: str, value: Any) -> Tensor:
    """A picture or a map of a sample as a plain tensor [C, H, W]."""
    try:
        planes = value.as_subclass(Tensor) if isinstance(value, Tensor) else torch.as_tensor(value)
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(
            f"{name} of a sample must be a tensor or an array, got {type(value).__name__}"
        ) from None
    if planes.ndim == 2:
        return planes[None]
    if planes.ndim != 3:
        raise ValueError(
            f"{name} of a sample must be one picture, got {list(planes.shape)}; a batch goes by "
            "image, depth and seeds"
        )
    return planes if isinstance(value, Tensor) else planes.movedim(-1, 0)


def restored(value: Any, planes: Tensor) -> Any:
    """A tensor [C, H, W] converted to the class, order of axes and number of axes of `value`."""
    planes = planes[0] if value.ndim == 2 else planes
    if isinstance(value, Tensor):
        return planes.as_subclass(type(value))
    return (planes if planes.ndim == 2 else planes.movedim(0, -1)).numpy(force=True)


def mirrored(sample: Mapping[str, Any], p: float = 1.0) -> Sample:
    """A sample mirrored from side to side, with left and right exchanged.

    Args:
        sample: Pictures and maps by name, the dual-pixel images as ``left`` and ``right``; all
            other entries are unchanged.
        p: The probability of mirroring, drawn by torch's generator, which a loader seeds in each
            worker.
    """
    if not 0.0 <= p <= 1.0:
        raise ValueError(f"p must be a probability, 0 to 1, got {p}")
    if p < 1.0 and float(torch.rand(())) >= p:
        return dict(sample)
    turned = {name: _mirrored(value) for name, value in sample.items()}
    if turned.keys() >= {"left", "right"}:
        turned["left"], turned["right"] = turned["right"], turned["left"]
    return turned


def _mirrored(value: Any) -> Any:
    if isinstance(value, Tensor):
        return value.flip(-1).as_subclass(type(value)) if value.ndim > 1 else value
    return value[:, ::-1].copy() if getattr(value, "ndim", 0) > 1 else value

"""Bands of rows of a picture, which are computed one after another or in threads."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import torch
from torch import Tensor

from defocus_core.tensors.device_plan import launches_cost, pieces

# Greatest number of pixels and of rows in a band on a CPU, and bytes that a pixel takes elsewhere.
_PIXELS, _ROWS, _BYTES = 1 << 19, 256, 100

Scalar = float | Tensor


def bands_of(
    size: tuple[int, int], device: torch.device, minimum: int = 1
) -> list[tuple[int, int]]:
    """First row and end of each band of a frame; bands have at least so many rows."""
    height, width = size
    rows = pieces(device, _BYTES, _PIXELS) // width
    rows = max(minimum, rows if launches_cost(device) else min(_ROWS, rows))
    return list(pairwise([*range(0, height, rows), height]))


def bands(picture: Tensor) -> list[tuple[int, int]]:
    """First row and end of each band of a picture [..., H, W]."""
    return bands_of((picture.shape[-2], picture.shape[-1]), picture.device)


def banded(picture: Tensor) -> Iterator[Tensor]:
    """A picture [..., H, W] band by band, without its gradient."""
    for first, last in bands(picture):
        yield picture[..., first:last, :].detach()

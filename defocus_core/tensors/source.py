"""Picture sources: tensors, or files read through one window at a time."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, Protocol

import torch
from torch import Tensor

# Greatest number of pixels and of rows in a band.
_PIXELS, _ROWS = 1 << 19, 256


class Source(Protocol):
    """A picture [..., H, W] that is sliced like a tensor; each slice reads its window anew."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the whole picture."""

    @property
    def dtype(self) -> torch.dtype:
        """Type of the numbers."""

    @property
    def device(self) -> torch.device:
        """Device of the windows."""

    def __getitem__(self, window: Any) -> Tensor:
        """A window: slices of rows and columns, after ``...`` or alone."""


Pixels = Tensor | Source
Scalar = float | Tensor


def bands(height: int, width: int, least: int = 1) -> list[tuple[int, int]]:
    """First row and end of each band of a frame; bands have at least so many rows."""
    rows = max(least, min(_ROWS, _PIXELS // width))
    return list(pairwise([*range(0, height, rows), height]))


def banded(picture: Pixels) -> Iterator[Tensor]:
    """A picture [..., H, W] band by band, without its gradient."""
    height, width = picture.shape[-2:]
    for first, last in bands(height, width):
        yield picture[..., first:last, :].detach()

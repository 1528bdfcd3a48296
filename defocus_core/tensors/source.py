"""Picture sources: tensors, or files read through one window at a time."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, Protocol

import torch
from torch import Tensor

from defocus_core.tensors.device_plan import launches_cost, pieces

# Greatest number of pixels and of rows in a band on a CPU, and bytes that a pixel takes elsewhere.
_PIXELS, _ROWS, _BYTES = 1 << 19, 256, 100


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


def bands(picture: Pixels, minimum: int = 1) -> list[tuple[int, int]]:
    """First row and end of each band of a frame; bands have at least so many rows."""
    height, width = picture.shape[-2:]
    rows = pieces(picture.device, _BYTES, _PIXELS) // width
    rows = max(minimum, rows if launches_cost(picture.device) else min(_ROWS, rows))
    return list(pairwise([*range(0, height, rows), height]))


def banded(picture: Pixels) -> Iterator[Tensor]:
    """A picture [..., H, W] band by band, without its gradient."""
    for first, last in bands(picture):
        yield picture[..., first:last, :].detach()

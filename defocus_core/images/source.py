"""Picture sources: tensors, or files read through one window at a time."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, Protocol

import torch
from torch import Tensor

# Pixels and rows looked at at once, at most.
_PIXELS, _ROWS = 1 << 19, 256


class Source(Protocol):
    """What is cut like a tensor [..., H, W]; each cut reads that window anew."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the whole."""

    @property
    def dtype(self) -> torch.dtype:
        """Of the numbers."""

    @property
    def device(self) -> torch.device:
        """Where windows come to lie."""

    def __getitem__(self, window: Any) -> Tensor:
        """A window: slices of rows and columns, after ``...`` or alone."""


Pixels = Tensor | Source


def bands(height: int, width: int) -> list[tuple[int, int]]:
    """First and last row + 1 of the bands of a frame."""
    rows = max(1, min(_ROWS, _PIXELS // width))
    return list(pairwise([*range(0, height, rows), height]))


def spread(length: int, every: int, first: int = 0, end: int | None = None) -> list[int]:
    """Some numbers from 0 to `length`, as many of each end: every so many, and the mirrored ones.

    Of these the ones between two numbers, counted from the first.
    """
    end = length if end is None else end
    found = {start % every for start in (-first, length - 1 - first)}
    return sorted(i for start in found for i in range(start, end - first, every))


def banded(picture: Pixels) -> Iterator[Tensor]:
    """A picture [..., H, W] band by band, without its gradient."""
    height, width = picture.shape[-2:]
    for first, last in bands(height, width):
        yield picture[..., first:last, :].detach()

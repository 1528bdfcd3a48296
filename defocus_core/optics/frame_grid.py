"""What changes over the frame, measured at the places of a grid.

The frame is divided into rows and columns of equal rectangles, each with its own in its middle.
Between the places of the grid light is mixed, bilinear in the place; beyond the outer ones it
stays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.tensors.source import Scalar


class FrameGrid:
    """One of something for each place of a grid over the frame."""

    grid: tuple[int, int]  # the rows and the columns

    def view(self, x: Scalar, y: Scalar, frame: tuple[int, int]) -> GridMix:
        """What points of a frame (height, width) see, x and y px from its left upper corner."""
        down, across = (
            _tents(position, length, count)
            for position, length, count in zip((y, x), frame, self.grid, strict=True)
        )
        return GridMix(self, (down[..., :, None] * across[..., None, :]).flatten(-2))


class GridMix(NamedTuple):
    """The mix that points of the frame see."""

    field: FrameGrid
    weights: Tensor  # [G] or [n, G] the share of the light of each place

    @property
    def points(self) -> int:
        """The number of points that see it."""
        return math.prod(self.weights.shape[:-1])

    @classmethod
    def joined(cls, mixes: Sequence[GridMix]) -> GridMix:
        """Mixes of one field as one, as so many points see it."""
        return cls(mixes[0].field, torch.stack([mix.weights for mix in mixes]))

    def of(self, which: Tensor | slice) -> GridMix:
        """The mix as the points of these indices see it."""
        return self._replace(weights=self.weights[which])


def _tents(position: Scalar, length: int, count: int) -> Tensor:
    """Weights [..., count] of the places of a grid along an axis."""
    at = torch.as_tensor(position, dtype=torch.float64) * (count / length) - 0.5
    number = torch.arange(count, dtype=at.dtype, device=at.device)
    return (1 - (at.clamp(0, count - 1)[..., None] - number).abs()).clamp(min=0)

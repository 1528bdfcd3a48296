"""Blobs: connected areas of a mask [H, W], held as runs of pixels in rows.

A run lies in one row. Runs that share a side or a corner are of one blob. The sky is few runs, so
that a mask of any size takes little memory; rows are added band by band.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Runs(NamedTuple):
    """The runs of a mask, in order of their first pixels."""

    row: Tensor  # [n] row of each run
    first: Tensor  # [n] column of its first pixel
    end: Tensor  # [n] column after its last pixel

    @classmethod
    def of(cls, mask: Tensor, top: int) -> Runs:
        """The runs of rows [h, W] of a mask, of which the first is row `top`."""
        steps = torch.nn.functional.pad(mask.to(torch.int8), (1, 1)).diff(dim=1)
        row, first = torch.nonzero(steps > 0).unbind(1)
        return cls(row + top, first, torch.nonzero(steps < 0)[:, 1])

    @classmethod
    def joined(cls, bands: list[Runs]) -> Runs:
        """The runs of bands from the top on."""
        return cls(*(torch.cat(part) for part in zip(*bands, strict=True)))

    @property
    def area(self) -> Tensor:
        """The number of pixels of each run."""
        return self.end - self.first

    def holding(self, row: Tensor, column: Tensor, width: int) -> Tensor:
        """The number of the run that holds each pixel of the mask, in a frame of some width."""
        firsts = self.row * width + self.first
        return torch.searchsorted(firsts, row * width + column, right=True) - 1

    def blobs(self, width: int) -> Tensor:
        """For each run the number of its blob, from 0 on, in a frame of some width."""
        one, other = self._touching(width)
        label = torch.arange(len(self.row), device=self.row.device)
        while True:
            first, second = label[one], label[other]
            apart = first != second
            if not bool(apart.any()):
                number: Tensor = torch.unique(label, return_inverse=True)[1]
                return number
            one, other, first, second = (x[apart] for x in (one, other, first, second))
            minimum = torch.minimum(first, second)
            # of two trees of runs the root of one is below that of the other from now on
            label = label.scatter_reduce(0, torch.maximum(first, second), minimum, "amin")
            while not torch.equal(root := label[label], label):
                label = root

    def _touching(self, width: int) -> tuple[Tensor, Tensor]:
        """Pairs of runs of neighbouring rows that share a side or a corner."""
        stride = width + 2
        firsts, limits = self.row * stride + self.first, self.row * stride + self.end
        low = torch.searchsorted(limits, firsts + stride)
        high = torch.searchsorted(firsts, limits + stride, right=True)
        count = (high - low).clamp(min=0)
        one = torch.arange(len(low), device=low.device).repeat_interleave(count)
        before = (count.cumsum(0) - count).repeat_interleave(count)
        rank = torch.arange(len(one), device=low.device) - before
        return one, low.repeat_interleave(count) + rank

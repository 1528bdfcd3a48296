"""Planar slices: those of one slope all over, whose kernel is tilted instead.

Blocks of one slope tell it for the slices that are in them. In blocks of several, like those of a
floor behind wires, each slice is asked for its own pixels.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from defocus_core.images.box import Box
from defocus_core.images.tiling import BLOCK
from defocus_core.layers.block_index import block_ends, of_blocks

# Slopes that differ by less are the same: pictures change by less than 2e-6 for that.
_SAME = 1.5e-5


class Planes:
    """The slopes of slices in the blocks of a frame.

    Attributes:
        tilted: [rows, columns] bool, blocks in which something has a slope, on the CPU.
    """

    def __init__(
        self,
        slopes: Tensor,
        places: Tensor,
        blocks: Tensor,
        side: int = BLOCK,
        level: Tensor | None = None,
    ) -> None:
        """Look for slices that are planes.

        Args:
            slopes: [2, H, W], x and y, px per px.
            places: [H, W] positions on the ladder.
            blocks: [K, rows, columns] bool, where slices are, on the CPU.
            side: Px of a block of these slopes.
            level: [K, rows, columns] bool, where slices have further samples, which have no slope.
        """
        lowest, highest = block_ends(slopes, side)
        mixed = (highest - lowest).amax(0) > _SAME
        self._lowest, self._highest, self._blocks = lowest.cpu(), highest.cpu(), blocks
        self.tilted: Tensor = ((self._lowest < 0) | (self._highest > 0)).any(0)
        self._alone: Tensor | None = None
        everywhere = (list(range(len(blocks))), slice(None), slice(None))
        some_mixed = bool(mixed.any())
        self._own = self._common(blocks & ~mixed.cpu() if some_mixed else blocks, *everywhere)
        mixed = mixed.cpu() & blocks[self._own.abs().sum(1) > 0].any(0)  # of what has a slope
        if bool(mixed.any()):
            self._alone = torch.zeros_like(blocks)
            self._alone[:, mixed] = self._fitting(slopes, places, mixed, side).cpu()
            if level is not None:
                self._alone &= ~level.cpu()
        of_all = self._common(blocks, *everywhere) if some_mixed else self._own
        self._everywhere = _told(of_all)

    def _fitting(self, slopes: Tensor, places: Tensor, mixed: Tensor, side: int) -> Tensor:
        """Whether all pixels of slices in some blocks have the slopes of these: [K, n]."""
        row, column = torch.nonzero(mixed.to(places.device)).unbind(1)
        own = self._own.T.to(slopes)
        lean, at = (of_blocks(values, row, column, side) for values in (slopes, places))
        number = torch.arange(len(row), device=at.device)[:, None, None].expand_as(at)
        fits = torch.ones(len(self._own) * len(row), dtype=torch.bool, device=at.device)
        for rung in (at.floor().long(), at.ceil().long()):
            same = ((lean - own[:, rung]).abs() <= _SAME).all(0)  # not where one is unknown
            fits.index_fill_(0, (rung * len(row) + number)[~same], False)
        return fits.view(len(self._own), len(row))

    def slopes(self, numbers: list[int], box: Box) -> list[tuple[float, float] | None]:
        """The slope of slices, x and y; None for one that has not the same all over a rectangle.

        Args:
            numbers: Of the slices, each of which is there.
            box: The rectangle.
        """
        if any(self._everywhere[number] is None for number in numbers):
            top, left = max(box.top // BLOCK, 0), max(box.left // BLOCK, 0)
            below, beside = -(-(box.top + box.height) // BLOCK), -(-(box.left + box.width) // BLOCK)
            rows, columns = slice(top, below), slice(left, beside)
            found = _told(self._common(self._blocks, numbers, rows, columns))
        else:
            found = [None] * len(numbers)
        return [self._everywhere[number] or one for number, one in zip(numbers, found, strict=True)]

    def _common(self, blocks: Tensor, numbers: list[int], rows: slice, columns: slice) -> Tensor:
        """The slopes [n, 2] of slices in some blocks [K, rows, columns], NaN for several."""
        lowest, highest = (x[:, rows, columns] for x in (self._lowest, self._highest))
        if not lowest.numel():
            return lowest.new_full((len(numbers), 2), torch.nan)
        if self._alone is not None:
            alone, own = self._alone[numbers, rows, columns], self._own[numbers]
            lowest, highest = (
                torch.where(alone[:, None], own[..., None, None], x) for x in (lowest, highest)
            )
        some = blocks[numbers, rows, columns][:, None]
        low = torch.where(some, lowest, torch.inf).flatten(2).amin(2)
        high = torch.where(some, highest, -torch.inf).flatten(2).amax(2)
        same = (high - low <= _SAME).all(1, keepdim=True) & (low < torch.inf)  # it is there
        return torch.where(same, (low + high) / 2, torch.nan)


def _told(slopes: Tensor) -> list[tuple[float, float] | None]:
    """Slopes [n, 2] of slices, None for those of several."""
    return [None if math.isnan(x) else (x, y) for x, y in slopes.tolist()]

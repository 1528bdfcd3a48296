"""Planar slices: slices of one slope, for which the kernel is tilted instead of the pixels.

In a block of one slope every slice has this slope. In a block of several slopes, like that of a
floor behind wires, the slope of each slice is looked up in its own pixels.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from defocus_core.images.box import Box
from defocus_core.images.tiling import BLOCK
from defocus_core.layers.block_index import block_ends, of_blocks

# Slopes in px per px that differ by less are equal: pictures change by less than 2e-6.
_SAME = 1.5e-5


class Planes:
    """The slopes of slices in the blocks of a frame.

    Attributes:
        tilted: [rows, columns] bool, the blocks that hold a slope other than 0, on the CPU.
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
            side: Width of a block in pixels of `slopes`.
            level: [K, rows, columns] bool, where slices have fringe samples, which have no slope.
        """
        lowest, highest = block_ends(slopes, side)
        mixed = (highest - lowest).amax(0) > _SAME
        self._lowest, self._highest, self._blocks = lowest.cpu(), highest.cpu(), blocks
        self.tilted: Tensor = ((self._lowest < 0) | (self._highest > 0)).any(0)
        self._alone: Tensor | None = None
        everywhere = (list(range(len(blocks))), slice(None), slice(None))
        some_mixed = bool(mixed.any())
        self._own = self._common(blocks & ~mixed.cpu() if some_mixed else blocks, *everywhere)
        mixed = mixed.cpu() & blocks[self._own.abs().sum(1) > 0].any(0)  # only slices with a slope
        if bool(mixed.any()):
            self._alone = torch.zeros_like(blocks)
            self._alone[:, mixed] = self._fitting(slopes, places, mixed, side).cpu()
            if level is not None:
                self._alone &= ~level.cpu()
        of_all = self._common(blocks, *everywhere) if some_mixed else self._own
        self._everywhere = _pairs(of_all)

    def _fitting(self, slopes: Tensor, places: Tensor, mixed: Tensor, side: int) -> Tensor:
        """Whether in n mixed blocks all pixels of a slice have this slice's own slope: [K, n]."""
        row, column = torch.nonzero(mixed.to(places.device)).unbind(1)
        own = self._own.T.to(slopes)
        pixel_slopes, pixel_places = (
            of_blocks(values, row, column, side) for values in (slopes, places)
        )
        number = torch.arange(len(row), device=pixel_places.device)[:, None, None].expand_as(
            pixel_places
        )
        fits = torch.ones(len(self._own) * len(row), dtype=torch.bool, device=pixel_places.device)
        for rung in (pixel_places.floor().long(), pixel_places.ceil().long()):
            same = ((pixel_slopes - own[:, rung]).abs() <= _SAME).all(
                0
            )  # False where the slope is NaN
            fits.index_fill_(0, (rung * len(row) + number)[~same], False)
        return fits.view(len(self._own), len(row))

    def slopes(self, numbers: list[int], box: Box) -> list[tuple[float, float] | None]:
        """The slopes of slices, x and y; None for a slice of several slopes within the rectangle.

        Args:
            numbers: Numbers of slices that have pixels in the rectangle.
            box: The rectangle.
        """
        if any(self._everywhere[number] is None for number in numbers):
            top, left = max(box.top // BLOCK, 0), max(box.left // BLOCK, 0)
            below, beside = -(-(box.top + box.height) // BLOCK), -(-(box.left + box.width) // BLOCK)
            rows, columns = slice(top, below), slice(left, beside)
            local = _pairs(self._common(self._blocks, numbers, rows, columns))
        else:
            local = [None] * len(numbers)
        return [
            self._everywhere[number] or local_slope
            for number, local_slope in zip(numbers, local, strict=True)
        ]

    def _common(self, blocks: Tensor, numbers: list[int], rows: slice, columns: slice) -> Tensor:
        """The slopes [n, 2] of slices in blocks [K, rows, columns]; NaN if there are several."""
        lowest, highest = (x[:, rows, columns] for x in (self._lowest, self._highest))
        if not lowest.numel():
            return lowest.new_full((len(numbers), 2), torch.nan)
        if self._alone is not None:
            alone, own = self._alone[numbers, rows, columns], self._own[numbers]
            lowest, highest = (
                torch.where(alone[:, None], own[..., None, None], x) for x in (lowest, highest)
            )
        occupied = blocks[numbers, rows, columns][:, None]
        low = torch.where(occupied, lowest, torch.inf).flatten(2).amin(2)
        high = torch.where(occupied, highest, -torch.inf).flatten(2).amax(2)
        same = (high - low <= _SAME).all(1, keepdim=True) & (low < torch.inf)  # infinite: no block
        return torch.where(same, (low + high) / 2, torch.nan)


def _pairs(slopes: Tensor) -> list[tuple[float, float] | None]:
    """Slopes [n, 2] as pairs; None for NaN, which stands for several slopes."""
    return [None if math.isnan(x) else (x, y) for x, y in slopes.tolist()]

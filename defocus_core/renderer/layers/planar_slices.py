"""Planar slices: slices of one slope, for which the kernel is tilted instead of the pixels.

In a block of one slope every slice has this slope; a slice in a block of several slopes has none
in common, even if its own pixels do.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.renderer.layers.block_index import block_ranges
from defocus_core.tensors.box import Box
from defocus_core.tensors.tiling import BLOCK

# Slopes in px per px that differ by less are equal: pictures change by less than 2e-6.
_SAME = 1.5e-5


class Planes:
    """The slopes of slices in the blocks of a frame.

    Attributes:
        tilted: [rows, columns] bool, the blocks that hold a slope other than 0, on the CPU.
    """

    def __init__(self, slopes: Tensor, blocks: Tensor) -> None:
        """Look for slices that are planes.

        `slopes`: [2, ..., H, W], x and y, px per px; `blocks`: [K, rows, columns] bool, where
        slices are, on the CPU.
        """
        lowest, highest = block_ranges(slopes)
        if slopes.dim() > 3:  # of all pictures of a batch
            lowest, highest = lowest.amin(1), highest.amax(1)
        self._lowest, self._highest = lowest.cpu(), highest.cpu()
        self._blocks = blocks
        self.tilted: Tensor = ((self._lowest < 0) | (self._highest > 0)).any(0)
        every, all_blocks = list(range(len(blocks))), slice(None)
        self._everywhere = self._common(every, all_blocks, all_blocks)

    def slopes(self, slice_indices: list[int], box: Box) -> list[tuple[float, float] | None]:
        """Slopes of slices, x and y; None for a slice of several slopes within the rectangle."""
        everywhere = [self._everywhere[number] for number in slice_indices]
        if None not in everywhere:
            return everywhere
        rows, columns = (
            slice(max(side.first // BLOCK, 0), -(-side.end // BLOCK)) for side in box.sides
        )
        local = self._common(slice_indices, rows, columns)
        return [common or in_window for common, in_window in zip(everywhere, local, strict=True)]

    def _common(
        self, slice_indices: list[int], rows: slice, columns: slice
    ) -> list[tuple[float, float] | None]:
        """The slopes of slices, x and y, in a rectangle of blocks; None if there are several."""
        lowest, highest = (x[:, rows, columns] for x in (self._lowest, self._highest))
        if not lowest.numel():
            return [None] * len(slice_indices)
        occupied = self._blocks[slice_indices, rows, columns][:, None]
        low = torch.where(occupied, lowest, torch.inf).flatten(2).amin(2)
        high = torch.where(occupied, highest, -torch.inf).flatten(2).amax(2)
        same = (high - low <= _SAME).all(1) & (low < torch.inf).all(1)  # infinite: no block
        middle = ((low + high) / 2).tolist()
        return [(x, y) if one else None for one, (x, y) in zip(same.tolist(), middle, strict=True)]

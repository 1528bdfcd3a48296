"""Samples of a layer beside its pixels: parts of nearer surfaces in pixels on an edge."""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.halving import Axis
from defocus_core.tiling import Box

# Samples on a side of the blocks by which points are found.
_BLOCK = 32


class Points:
    """The further samples of a layer, sorted by blocks."""

    def __init__(self, at: Tensor, layer: Tensor, places: Tensor, size: tuple[int, int]) -> None:
        """Sort them.

        Args:
            at: [n, 2] rows and columns.
            layer: [n, C + 1].
            places: [n] positions on the ladder.
            size: (height, width) of the layer.
        """
        self._at, self._layer, self._places = at, layer, places
        rows, columns = (-(-n // _BLOCK) for n in size)
        self._rows, self._columns = rows, columns
        block = self._at.div(_BLOCK, rounding_mode="floor")
        block = block[:, 0] * columns + block[:, 1]
        self._order = block.argsort(stable=True)
        counts = torch.bincount(block, minlength=rows * columns)
        self._starts = [0, *counts.cumsum(0).tolist()]

    def _near(self, corner: tuple[int, int], size: tuple[int, int]) -> Tensor:
        """Indices of the points in the blocks that a window touches."""
        above, first = (max(n // _BLOCK, 0) for n in corner)
        below = min((corner[0] + size[0] - 1) // _BLOCK + 1, self._rows)
        last = min((corner[1] + size[1] - 1) // _BLOCK + 1, self._columns)
        starts = [y * self._columns for y in range(above, below)]
        return torch.cat(
            [self._order[self._starts[s + first] : self._starts[s + last]] for s in starts]
        )

    def added(
        self,
        pixels: Tensor,
        corner: tuple[int, int],
        rungs: list[int],
        count: int,
    ) -> Tensor:
        """Slices [k, C + 1, height, width] of a window with the points that lie in it.

        Args:
            pixels: Without; overwritten.
            corner: First row and column of the window.
            rungs: Of the slices.
            count: Rungs in all.
        """
        if self._starts[-1] == 0:
            return pixels
        channels, height, width = pixels.shape[1:]
        near = self._near(corner, (height, width))
        if not len(near):
            return pixels
        y = self._at[near, 0] - corner[0]
        x = self._at[near, 1] - corner[1]
        inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        layer = self._layer.index_select(0, near) * inside[:, None]
        places = self._places.index_select(0, near)
        spot = torch.where(inside, y * width + x, 0)[:, None]
        channel = torch.arange(channels, device=pixels.device) * (height * width)
        slots = torch.full((count + 1,), -1, device=pixels.device)
        slots[rungs] = torch.arange(len(rungs), device=pixels.device)
        lower = places.detach().floor()
        flat = pixels.view(-1)
        for rung in (lower, lower + 1):
            slot = slots[rung.long()][:, None]
            share = (1 - (places - rung).abs())[:, None] * (slot >= 0)
            target = slot.clamp(min=0) * (channels * height * width) + channel + spot
            flat.index_add_(0, target.flatten(), (layer * share).flatten())
        return pixels

    def averaged(
        self, pixels: Tensor, rung: int, step: int, cells: Box, middle: tuple[Axis, Axis]
    ) -> None:
        """Add the points of a slice to it at reduced resolution.

        Args:
            pixels: [C + 1, height, width] without; changed.
            rung: Of the slice.
            step: Px between cells.
            cells: What the pixels are, counted from the first at or after the middle of the frame.
            middle: Of the frame, counted from the first sample.
        """
        share = 1 - (self._places - rung).abs()
        here = torch.nonzero(share.detach() > 0)[:, 0]
        if not len(here):
            return
        layer = self._layer[here] * share[here, None] / step**2
        sides = []  # of each axis the cells that have shares in a pixel, and the shares
        for dim, (axis, start) in enumerate(zip(middle, cells[:2], strict=True)):
            offset = self._at[here, dim] - axis.middle
            lower = offset.div(step, rounding_mode="floor")
            upper = (offset - lower * step).to(layer.dtype) / step
            sides.append(
                [(lower - start, 1 - upper), (lower + 1 - start, upper)]
                if axis.odd
                else [(lower - start, torch.ones_like(upper))]
            )
        for y, of_row in sides[0]:
            for x, of_column in sides[1]:
                inside = (y >= 0) & (y < cells.height) & (x >= 0) & (x < cells.width)
                some = layer * (of_row * of_column * inside)[:, None]
                spot = torch.where(inside, y * cells.width + x, 0)
                pixels.view(len(pixels), -1).index_add_(1, spot, some.T)

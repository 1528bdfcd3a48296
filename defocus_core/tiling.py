"""A fixed grid of tiles, and which slices each of them can see.

The grid depends on nothing but the frame, so that a pixel is computed in the same way whatever
else was asked for. A slice is worth computing for a tile if it has a pixel within its own radius
of the tile.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

TILE = 96
# Px on a side of the blocks in which the presence of slices is recorded.
_BLOCK = 16


class Tile(NamedTuple):
    """A rectangle of the frame."""

    top: int
    left: int
    height: int
    width: int


def tiles(height: int, width: int, side: int = TILE) -> list[Tile]:
    """The grid of tiles over a frame, row by row."""
    return [
        Tile(y, x, min(side, height - y), min(side, width - x))
        for y in range(0, height, side)
        for x in range(0, width, side)
    ]


def visible_slices(
    places: Tensor, present: Tensor | None, reaches: list[int], grid: list[Tile]
) -> list[list[int]]:
    """For each tile the indices of the slices that reach it, nearest first.

    Args:
        places: [H, W] positions of pixels on the ladder.
        present: [H, W] bool, which pixels exist; None if all do.
        reaches: Px that each slice spreads.
        grid: The tiles.
    """
    count = _block_counts(places.detach(), present, len(reaches))
    rows, columns = count.shape[1] - 1, count.shape[2] - 1
    top, left, height, width = (torch.tensor(x)[:, None] for x in zip(*grid, strict=True))
    reach = torch.tensor(reaches)[None]  # [1, K]
    y0 = ((top - reach).clamp(min=0) // _BLOCK).clamp(max=rows)
    x0 = ((left - reach).clamp(min=0) // _BLOCK).clamp(max=columns)
    y1 = ((top + height + reach + _BLOCK - 1) // _BLOCK).clamp(max=rows)
    x1 = ((left + width + reach + _BLOCK - 1) // _BLOCK).clamp(max=columns)
    k = torch.arange(len(reaches))[None]
    inside = count[k, y1, x1] - count[k, y0, x1] - count[k, y1, x0] + count[k, y0, x0]
    return [torch.nonzero(row)[:, 0].tolist() for row in inside > 0]


def _block_counts(places: Tensor, present: Tensor | None, slices: int) -> Tensor:
    """Summed-area table [K, rows + 1, columns + 1] of blocks that hold a pixel of each slice."""
    H, W = places.shape
    rows, columns = -(-H // _BLOCK), -(-W // _BLOCK)
    down = torch.arange(H, device=places.device) // _BLOCK * columns
    block = down[:, None] + torch.arange(W, device=places.device) // _BLOCK
    found = torch.zeros(slices * rows * columns, dtype=torch.int32, device=places.device)
    for slice_ in (places.floor(), places.ceil()):
        key = slice_.long() * (rows * columns) + block
        found[key if present is None else key[present]] = 1
    table = found.reshape(slices, rows, columns).cpu()
    return torch.nn.functional.pad(table, (1, 0, 1, 0)).cumsum(1).cumsum(2)

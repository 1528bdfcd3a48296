"""A fixed grid of tiles, and which slices each of them can see.

The grid depends on nothing but the frame, so that a pixel is computed in the same way whatever
else was asked for. A slice is worth computing for a tile if it has a pixel within its own radius
of the tile.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

TILE = 128
# Px on a side of the blocks in which the presence of slices is recorded.
BLOCK = 16


class Tile(NamedTuple):
    """A rectangle of the frame."""

    top: int
    left: int
    height: int
    width: int


class Grid(NamedTuple):
    """All tiles of a frame, row by row.

    Attributes:
        tiles: The tiles; the last of a row or column may be smaller.
        side: Px of the others.
        columns: Tiles in a row.
    """

    tiles: list[Tile]
    side: int
    columns: int


def grid_over(height: int, width: int, side: int = TILE) -> Grid:
    """The grid of tiles over a frame."""
    tiles = [
        Tile(y, x, min(side, height - y), min(side, width - x))
        for y in range(0, height, side)
        for x in range(0, width, side)
    ]
    return Grid(tiles, side, -(-width // side))


def visible_slices(blocks: Tensor, reaches: list[int], tiles: list[Tile]) -> list[list[int]]:
    """For each tile the indices of the slices that reach it, nearest first.

    Args:
        blocks: [K, rows, columns] bool, from `blocks_of` and `blocks_at`.
        reaches: Px that each slice spreads.
        tiles: The tiles.
    """
    padded = torch.nn.functional.pad(blocks.to(torch.int32).cpu(), (1, 0, 1, 0))
    count = padded.cumsum(1).cumsum(2)
    rows, columns = blocks.shape[1:]
    top, left, height, width = (torch.tensor(x)[:, None] for x in zip(*tiles, strict=True))
    reach = torch.tensor(reaches)[None]  # [1, K]
    y0 = ((top - reach).clamp(min=0) // BLOCK).clamp(max=rows)
    x0 = ((left - reach).clamp(min=0) // BLOCK).clamp(max=columns)
    y1 = ((top + height + reach + BLOCK - 1) // BLOCK).clamp(max=rows)
    x1 = ((left + width + reach + BLOCK - 1) // BLOCK).clamp(max=columns)
    k = torch.arange(len(reaches))[None]
    inside = count[k, y1, x1] - count[k, y0, x1] - count[k, y1, x0] + count[k, y0, x0]
    return [torch.nonzero(row)[:, 0].tolist() for row in inside > 0]


def blocks_of(places: Tensor, slices: int, present: Tensor | None = None) -> Tensor:
    """Blocks [K, rows, columns] bool of 16 px that hold a pixel of each slice.

    Args:
        places: [H, W] positions of pixels on the ladder.
        slices: K.
        present: [H, W] bool, which pixels exist; None if all do.
    """
    H, W = places.shape
    down = torch.arange(H, dtype=torch.int32, device=places.device) // BLOCK
    across = torch.arange(W, dtype=torch.int32, device=places.device) // BLOCK
    block = down[:, None] * _blocks(W) + across
    if present is not None:
        places, block = places[present], block[present]
    return _marked(places, block, slices, (H, W))


def blocks_at(places: Tensor, at: Tensor, slices: int, size: tuple[int, int]) -> Tensor:
    """The same of points of positions [n] at rows and columns [n, 2] of a frame."""
    block = at[:, 0] // BLOCK * _blocks(size[1]) + at[:, 1] // BLOCK
    return _marked(places, block, slices, size)


def _blocks(length: int) -> int:
    return -(-length // BLOCK)


def _marked(places: Tensor, block: Tensor, slices: int, size: tuple[int, int]) -> Tensor:
    rows, columns = map(_blocks, size)
    lower = places.detach().floor()
    between = places.detach() > lower  # the rung above has a share too
    key = (2 * lower + between).to(torch.int32) * (rows * columns) + block
    found = torch.zeros((2 * slices, rows * columns), dtype=torch.bool, device=places.device)
    found.view(-1)[key.flatten().long()] = True
    alone, both = found.reshape(slices, 2, rows, columns).unbind(1)
    marked = alone | both
    marked[1:] |= both[:-1]
    return marked

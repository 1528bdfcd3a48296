"""Blocks of 16 px that hold a slice, and the tiles that these blocks reach."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from defocus_core.images.box import (
    Box,
    Span,
)
from defocus_core.images.tiling import (
    BLOCK,
)

# Blocks that are counted at once: bounds memory.
_COUNTED = 1 << 21


def visible_slices(blocks: Tensor, reaches: list[int], tiles: list[Box]) -> list[list[int]]:
    """For each tile the indices of the slices that reach it, nearest first.

    Args:
        blocks: [K, rows, columns] bool, from `blocks_of` and `blocks_at`.
        reaches: Px that each slice spreads.
        tiles: The tiles.
    """
    found = []
    down, across = ([tile.sides[d] for tile in tiles] for d in (0, 1))
    rows, columns = list(dict.fromkeys(down)), list(dict.fromkeys(across))
    for some in torch.split(torch.arange(len(reaches)), max(1, _COUNTED // blocks[0].numel())):
        held = blocks[some[0] : some[-1] + 1].float().cpu()
        reach = torch.tensor(reaches)[some, None]
        near = _reached(rows, reach, held.shape[1]), _reached(columns, reach, held.shape[2])
        found.append(near[0] @ held @ near[1].mT > 0)  # [K, rows, columns] of tiles
    seen = torch.cat(found).permute(1, 2, 0)
    return [
        torch.nonzero(seen[rows.index(y), columns.index(x)])[:, 0].tolist()
        for y, x in zip(down, across, strict=True)
    ]


def _reached(sides: list[Span], reach: Tensor, count: int) -> Tensor:
    """Which blocks of so many along an axis are within reach [K, 1] px of sides: [K, n, count]."""
    first, end = (
        torch.tensor([getattr(side, name) for side in sides]) for name in ("first", "end")
    )
    start, stop = (first - reach) // BLOCK, -((-end - reach) // BLOCK)
    block = torch.arange(count)
    return ((block >= start[..., None]) & (block < stop[..., None])).float()


def blocks_of(places: Tensor, slices: int, present: Tensor | None = None) -> Tensor:
    """Blocks [K, rows, columns] bool of 16 px that hold a pixel of each slice.

    Args:
        places: [H, W] positions of pixels on the ladder.
        slices: K.
        present: [H, W] bool, which pixels exist; None if all do.
    """
    places = places.detach()
    if present is not None:
        at = torch.nonzero(present)
        return blocks_at(places[at[:, 0], at[:, 1]], at, slices, (places.shape[0], places.shape[1]))
    ends = block_ends(places)
    found = torch.zeros((*ends[0].shape, slices), dtype=torch.bool, device=places.device)
    (first, above), (below, last) = ((end.floor().long(), end.ceil().long()) for end in ends)
    for rung in (first, above, below, last):
        found.scatter_(2, rung[..., None], True)
    # of those in between, which?
    row, column = torch.nonzero(below - above > 1).unbind(1)
    if len(row):
        cells = of_blocks(places, row, column, BLOCK).flatten(1)
        some = torch.zeros((len(row), slices), dtype=torch.bool, device=places.device)
        some.scatter_(1, cells.floor().long(), True).scatter_(1, cells.ceil().long(), True)
        found[row, column] = some
    return found.permute(2, 0, 1)


def block_ends(values: Tensor, side: int = BLOCK) -> tuple[Tensor, Tensor]:
    """The least and the greatest [..., rows, columns] of values [..., H, W] in square blocks."""
    least, most = values, values
    for dim in (-2, -1):
        least, most = _picked(least, side, dim, torch.amin), _picked(most, side, dim, torch.amax)
    return least, most


def _picked(values: Tensor, side: int, dim: int, pick: Callable[..., Tensor]) -> Tensor:
    """What is picked of each so many values along an axis; of the last ones there may be fewer."""
    n = values.shape[dim]
    whole = n - n % side
    blocks = torch.unflatten(values.narrow(dim, 0, whole), dim, (n // side, side))
    found = pick(blocks, dim)
    if whole == n:
        return found
    return torch.cat([found, pick(values.narrow(dim, whole, n - whole), dim, keepdim=True)], dim)


def of_blocks(values: Tensor, row: Tensor, column: Tensor, side: int) -> Tensor:
    """Values [..., n, side, side] in some blocks [n] of [..., H, W]; the last ones are repeated."""
    inner = torch.arange(side, device=values.device)
    y, x = (
        (side * number[:, None] + inner).clamp_(max=size - 1)
        for number, size in zip((row, column), values.shape[-2:], strict=True)
    )
    return values[..., y[:, :, None], x[:, None]]


def blocks_at(places: Tensor, at: Tensor, slices: int, size: tuple[int, int]) -> Tensor:
    """The same of points of positions [n] at rows and columns [n, 2] of a frame."""
    rows, columns = (-(-n // BLOCK) for n in size)
    found = torch.zeros(slices * rows * columns, dtype=torch.bool, device=places.device)
    block = at.div(BLOCK, rounding_mode="floor")
    number = block[:, 0] * columns + block[:, 1]
    for rung in (places.detach().floor(), places.detach().ceil()):
        found.index_fill_(0, rung.long() * (rows * columns) + number, True)
    return found.view(slices, rows, columns)

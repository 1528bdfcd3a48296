"""A fixed grid of tiles, regions of them, and which slices each tile can see.

The grid depends on nothing but the frame and the side of a tile, so that a pixel is computed in
the same way whatever else was asked for. A slice is worth computing for a tile if it has a pixel
within its own radius of the tile.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.source import Pixels
from defocus_core.spans import Span

TILE = 192
# Px on a side of the blocks in which the presence of slices is recorded.
BLOCK = 16
# Least px on a side of a region, unless the frame is smaller: what tiles share is computed once.
_REGION = 960
# Margins of light from outside may enlarge a region by so much on each side, as a share of it.
_MARGIN = 0.15
# Blocks that are counted at once: bounds memory.
_COUNTED = 1 << 21


class Box(NamedTuple):
    """A rectangle of a picture."""

    top: int
    left: int
    height: int
    width: int

    @classmethod
    def over(cls, down: Span, across: Span) -> Box:
        """The rectangle of some rows and columns."""
        return cls(down.first, across.first, down.length, across.length)

    @property
    def sides(self) -> tuple[Span, Span]:
        """Its rows and its columns."""
        return Span(self.top, self.top + self.height), Span(self.left, self.left + self.width)

    @property
    def area(self) -> int:
        """Its pixels."""
        return self.height * self.width

    def grown(self, by: int, within: Box) -> Box:
        """Larger by some px on all sides, cut to what there is."""
        top, left = max(self.top - by, within.top), max(self.left - by, within.left)
        below = min(self.top + self.height + by, within.top + within.height)
        beside = min(self.left + self.width + by, within.left + within.width)
        return Box(top, left, below - top, beside - left)

    def around(self, by: int) -> Box:
        """Larger by some px on all sides, wherever that is."""
        return Box(self.top - by, self.left - by, self.height + 2 * by, self.width + 2 * by)

    def shrunk(self, by: int) -> Box:
        """Smaller by some px on all sides; its size may become negative."""
        return self.around(-by)

    def seen_from(self, other: Box) -> Box:
        """The same rectangle counted from the corner of another."""
        return Box(self.top - other.top, self.left - other.left, self.height, self.width)

    def of(self, picture: Pixels) -> Tensor:
        """What it holds of a picture [..., H, W]."""
        return picture[..., self.top : self.top + self.height, self.left : self.left + self.width]


class Grid(NamedTuple):
    """Tiles in rows.

    Attributes:
        tiles: The tiles; the first and the last of a row or column may be smaller.
        side: Px of the others.
        columns: Tiles in a row.
    """

    tiles: list[Box]
    side: int
    columns: int

    @property
    def box(self) -> Box:
        """All tiles together."""
        first, last = self.tiles[0], self.tiles[-1]
        height, width = last.top + last.height - first.top, last.left + last.width - first.left
        return Box(first.top, first.left, height, width)

    def within(self, box: Box) -> Grid | None:
        """Its tiles, cut to a rectangle; None if nothing is left."""
        cut = [tile.grown(0, box) for tile in self.tiles]
        left = [tile for tile in cut if min(tile[2:]) > 0]
        return (
            self._replace(tiles=left, columns=sum(tile.top == left[0].top for tile in left))
            if left
            else None
        )

    def seen_from(self, other: Box) -> Grid:
        """The same tiles counted from the corner of another rectangle."""
        return self._replace(tiles=[tile.seen_from(other) for tile in self.tiles])


def grid_over(height: int, width: int, side: int = TILE) -> Grid:
    """The grid of tiles over a frame."""
    tiles = [
        Box(y, x, min(side, height - y), min(side, width - x))
        for y in range(0, height, side)
        for x in range(0, width, side)
    ]
    return Grid(tiles, side, -(-width // side))


def regions(grid: Grid, margin: int) -> list[list[Grid]]:
    """Rows of regions of the tiles of a frame, about equally large.

    Args:
        grid: Of the frame.
        margin: Px around a region from which its tiles take light.
    """
    rows, columns = len(grid.tiles) // grid.columns, grid.columns
    least = max(_REGION, round(margin / _MARGIN))
    down, across = (_shared_out(n, -(-n * grid.side // least)) for n in (rows, columns))
    return [
        [
            Grid(
                [grid.tiles[y * columns + x] for y in range(*vertical) for x in range(*horizontal)],
                grid.side,
                horizontal[1] - horizontal[0],
            )
            for horizontal in across
        ]
        for vertical in down
    ]


def largest(rows: list[list[Grid]]) -> tuple[int, int]:
    """The greatest height and the greatest width of regions."""
    boxes = [grid.box for row in rows for grid in row]
    return max(box.height for box in boxes), max(box.width for box in boxes)


def _shared_out(count: int, parts: int) -> list[tuple[int, int]]:
    """Some ranges of nearly equal length that together are range(count)."""
    cuts = [round(count * i / parts) for i in range(parts + 1)]
    return [(a, b) for a, b in pairwise(cuts) if a < b]


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

"""Rectangles of pixels, spans of rows or columns, and the fixed grid of tiles and regions.

The grid depends only on the size of the frame and the side of a tile, so that a pixel is computed
in the same way whichever outputs are asked for. A slice is computed for a tile only if a pixel of
the slice is no farther from the tile than the slice's blur radius.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

from defocus_core.allowed_values import MIN_TILE
from defocus_core.tensors.later import Tensor


class Box(NamedTuple):
    """A rectangle of pixels; `top` and `left` are the row and column of its first pixel."""

    top: int
    left: int
    height: int
    width: int

    @classmethod
    def from_spans(cls, down: Span, across: Span) -> Box:
        """The rectangle of the rows `down` and the columns `across`."""
        return cls(down.first, across.first, down.length, across.length)

    @property
    def sides(self) -> tuple[Span, Span]:
        """The spans of the rows and of the columns, in this order."""
        return Span(self.top, self.top + self.height), Span(self.left, self.left + self.width)

    @property
    def area(self) -> int:
        """The number of pixels."""
        return self.height * self.width

    def grown(self, by: int, within: Box) -> Box:
        """This rectangle enlarged by `by` px on all sides, then clipped to `within`."""
        top, left = max(self.top - by, within.top), max(self.left - by, within.left)
        below = min(self.top + self.height + by, within.top + within.height)
        beside = min(self.left + self.width + by, within.left + within.width)
        return Box(top, left, below - top, beside - left)

    def enlarged(self, by: int) -> Box:
        """This rectangle enlarged by `by` px on all sides, without clipping."""
        return Box(self.top - by, self.left - by, self.height + 2 * by, self.width + 2 * by)

    def seen_from(self, other: Box) -> Box:
        """This rectangle with its position relative to the upper left corner of `other`."""
        return Box(self.top - other.top, self.left - other.left, self.height, self.width)

    def crop(self, picture: Tensor) -> Tensor:
        """The pixels [..., height, width] of a picture [..., H, W] that lie in this rectangle."""
        return picture[..., self.top : self.top + self.height, self.left : self.left + self.width]


class Span(NamedTuple):
    """A range of indices along an axis, from `first` up to but not including `end`."""

    first: int
    end: int

    @property
    def length(self) -> int:
        """The number of indices; 0 or negative if the range is empty."""
        return self.end - self.first


# Default side of a tile in px: pixels far from a tile are not blurred over it.
TILE = 128
# Greatest side in px of a frame that is a single tile: more tiles would read more surroundings.
_ALONE = 128
# Width in px of the blocks in which the presence of slices is recorded.
BLOCK = MIN_TILE
# Least px on a side of a region, unless the frame is smaller: tiles of a region share work.
REGION = 960
# Greatest margin of a region, in which light from outside is read, as a share of its width.
MARGIN = 0.15


class Grid(NamedTuple):
    """Tiles of the fixed grid, listed row by row."""

    tiles: list[Box]  # the tiles; the first and the last of a row or column may be smaller
    sides: tuple[int, int]  # (height, width) in px of the other tiles
    columns: int  # tiles in a row
    region: int = REGION  # least px on a side of a region, unless the frame is smaller

    @property
    def box(self) -> Box:
        """The smallest rectangle that contains all tiles."""
        first, last = self.tiles[0], self.tiles[-1]
        height, width = last.top + last.height - first.top, last.left + last.width - first.left
        return Box(first.top, first.left, height, width)

    def seen_from(self, other: Box) -> Grid:
        """The same tiles with positions relative to the upper left corner of `other`."""
        return self._replace(tiles=[tile.seen_from(other) for tile in self.tiles])


def grid_over(height: int, width: int, side: int | tuple[int, int] | None = None) -> Grid:
    """The grid of tiles over a frame of `height` by `width` px.

    `side`: the side of square tiles, or the (height, width) of tiles, in px; None for 128 px, or
    for a single tile if the frame is no larger than that.
    """
    if side is None:
        side = (max(height, 1), max(width, 1)) if max(height, width) <= _ALONE else TILE
    rows, columns = side if isinstance(side, tuple) else (side, side)
    tiles = [
        Box(y, x, min(rows, height - y), min(columns, width - x))
        for y in range(0, height, rows)
        for x in range(0, width, columns)
    ]
    return Grid(tiles, (rows, columns), -(-width // columns))


def few_tiles(height: int, width: int, pixels: int) -> tuple[int, int]:
    """The (height, width) of equal tiles of about `pixels` px that cover a frame.

    Both are rounded up to multiples of 16 px.
    """
    count = -(-height * width // pixels)
    across = -(-count // -(-height // BLOCK))
    rows, columns = -(-height // -(-count // across)), -(-width // across)
    return -(-rows // BLOCK) * BLOCK, -(-columns // BLOCK) * BLOCK


def regions(grid: Grid, margin: int) -> list[list[Grid]]:
    """The tiles of a frame, grouped into rows of rectangular regions of about equal size.

    `margin`: greatest distance in px from which light is blurred into a region.
    """
    rows, columns = len(grid.tiles) // grid.columns, grid.columns
    minimum = max(grid.region, round(margin / MARGIN))
    counts = zip((rows, columns), grid.sides, strict=True)
    down, across = (_shared_out(n, -(-n * side // minimum)) for n, side in counts)
    return [
        [
            grid._replace(
                tiles=[
                    grid.tiles[y * columns + x]
                    for y in range(*vertical)
                    for x in range(*horizontal)
                ],
                columns=horizontal[1] - horizontal[0],
            )
            for horizontal in across
        ]
        for vertical in down
    ]


def largest(rows: list[list[Grid]]) -> tuple[int, int]:
    """The greatest height and the greatest width, in px, among all regions."""
    boxes = [grid.box for row in rows for grid in row]
    return max(box.height for box in boxes), max(box.width for box in boxes)


def _shared_out(count: int, parts: int) -> list[tuple[int, int]]:
    """range(count) divided into at most `parts` ranges [first, end) of nearly equal length."""
    cuts = [round(count * i / parts) for i in range(parts + 1)]
    return [(a, b) for a, b in pairwise(cuts) if a < b]

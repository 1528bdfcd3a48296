"""Rectangles of pixels, spans of rows or columns, and the fixed grid of tiles and regions.

The grid depends on nothing but the frame and the side of a tile, so that a pixel is computed in
the same way whatever else was asked for. A slice is computed for a tile if it has a pixel within
its own radius of the tile.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

from defocus_core.allowed_values import MIN_TILE
from defocus_core.tensors.later import Tensor


class Box(NamedTuple):
    """A rectangle of a picture."""

    top: int
    left: int
    height: int
    width: int

    @classmethod
    def from_spans(cls, down: Span, across: Span) -> Box:
        """The rectangle of a span of rows and a span of columns."""
        return cls(down.first, across.first, down.length, across.length)

    @property
    def sides(self) -> tuple[Span, Span]:
        """The span of rows and the span of columns."""
        return Span(self.top, self.top + self.height), Span(self.left, self.left + self.width)

    @property
    def area(self) -> int:
        """The number of pixels."""
        return self.height * self.width

    def grown(self, by: int, within: Box) -> Box:
        """The rectangle enlarged by `by` px on all sides, cut to the rectangle `within`."""
        top, left = max(self.top - by, within.top), max(self.left - by, within.left)
        below = min(self.top + self.height + by, within.top + within.height)
        beside = min(self.left + self.width + by, within.left + within.width)
        return Box(top, left, below - top, beside - left)

    def enlarged(self, by: int) -> Box:
        """The rectangle enlarged by `by` px on all sides, not cut."""
        return Box(self.top - by, self.left - by, self.height + 2 * by, self.width + 2 * by)

    def shrunk(self, by: int) -> Box:
        """The rectangle reduced by `by` px on all sides; its size may become negative."""
        return self.enlarged(-by)

    def seen_from(self, other: Box) -> Box:
        """The same rectangle, with its place counted from the upper left corner of another."""
        return Box(self.top - other.top, self.left - other.left, self.height, self.width)

    def crop(self, picture: Tensor) -> Tensor:
        """The window of a picture [..., H, W] in this rectangle."""
        return picture[..., self.top : self.top + self.height, self.left : self.left + self.width]


class Span(NamedTuple):
    """Samples from `first` to before `end` along an axis."""

    first: int
    end: int

    @property
    def length(self) -> int:
        """The number of samples; 0 or negative if there are none."""
        return self.end - self.first

    def intersection(self, other: Span) -> Span:
        """The intersection with another span."""
        return Span(max(self.first, other.first), min(self.end, other.end))

    def grown(self, by: int) -> Span:
        """The span extended by `by` samples at both ends."""
        return Span(self.first - by, self.end + by)


# Side in px of a tile, where none is given: what is far from a tile is not blurred over it.
TILE = 128
# Side in px up to which a frame is one tile: several would read more light from around.
_ALONE = 128
# Width in px of the blocks in which the presence of slices is recorded.
BLOCK = MIN_TILE
# Least px on a side of a region, unless the frame is smaller: tiles of a region share work.
REGION = 960
# Greatest margin of a region, in which light from outside is read, as a share of its width.
MARGIN = 0.15


class Grid(NamedTuple):
    """Tiles in rows."""

    tiles: list[Box]  # the tiles; the first and the last of a row or column may be smaller
    sides: tuple[int, int]  # (height, width) in px of the other tiles
    columns: int  # tiles in a row
    region: int = REGION  # least px on a side of a region, unless the frame is smaller

    @property
    def box(self) -> Box:
        """The rectangle of all tiles."""
        first, last = self.tiles[0], self.tiles[-1]
        height, width = last.top + last.height - first.top, last.left + last.width - first.left
        return Box(first.top, first.left, height, width)

    def seen_from(self, other: Box) -> Grid:
        """The same tiles, with places counted from the upper left corner of a rectangle."""
        return self._replace(tiles=[tile.seen_from(other) for tile in self.tiles])


def grid_over(height: int, width: int, side: int | tuple[int, int] | None = None) -> Grid:
    """The grid of tiles of a side, or of a (height, width), over a frame."""
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
    """The (height, width) of the fewest tiles of at most `pixels` px, about equally large."""
    count = -(-height * width // pixels)
    across = -(-count // -(-height // BLOCK))
    rows, columns = -(-height // -(-count // across)), -(-width // across)
    return -(-rows // BLOCK) * BLOCK, -(-columns // BLOCK) * BLOCK


def regions(grid: Grid, margin: int) -> list[list[Grid]]:
    """Rows of regions of the tiles of a frame, about equally large.

    `margin`: distance in px around a region from which its tiles take light.
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
    """The greatest height and the greatest width in px of regions."""
    boxes = [grid.box for row in rows for grid in row]
    return max(box.height for box in boxes), max(box.width for box in boxes)


def _shared_out(count: int, parts: int) -> list[tuple[int, int]]:
    """Consecutive ranges [first, end) of nearly equal length that make range(count)."""
    cuts = [round(count * i / parts) for i in range(parts + 1)]
    return [(a, b) for a, b in pairwise(cuts) if a < b]

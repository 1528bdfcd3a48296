"""What a continuation computes at once: rectangles of cells around the pixels that ask.

Of each border either the rectangle around all that ask for it, as far as the frame goes, or those
of a fixed grid of blocks that hold any: whichever are fewer cells.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.halving import Axis

# Cells of the coarsest level on a side of a block, and those around it from which light comes.
_CELLS = 8
_AROUND = 3
_BLOCK = _CELLS + 2 * _AROUND
# Samples continued at once: bounds memory.
_SAMPLES = 1 << 18


class Piece(NamedTuple):
    """A rectangle of cells, and the border beyond which its values come from.

    Attributes:
        first: Row and column of the first cell, counted from the middle of the frame.
        cells: Rows and columns.
        border: Its number.
    """

    first: tuple[int, int]
    cells: tuple[int, int]
    border: int

    def corner(self, middle: tuple[Axis, Axis], level: int) -> tuple[int, int]:
        """Row and column of its first pixel."""
        y, x = (
            (first << level) + axis.middle for first, axis in zip(self.first, middle, strict=True)
        )
        return y, x

    def size(self, middle: tuple[Axis, Axis], level: int) -> tuple[int, int]:
        """(height, width) in pixels."""
        height, width = (
            (count << level) + axis.odd for count, axis in zip(self.cells, middle, strict=True)
        )
        return height, width


def block_px(level: int) -> tuple[int, int]:
    """Px from one block to the next, and on a side of one with what is around it."""
    return _CELLS << level, _BLOCK << level


def pieces(
    at: Tensor,
    which: Tensor,
    borders: int,
    size: tuple[int, int],
    middle: tuple[Axis, Axis],
    level: int,
) -> tuple[list[Piece], Tensor]:
    """What is to be continued.

    Args:
        at: [n, 2] rows and columns of the pixels that ask.
        which: [n] number of the border of each.
        borders: How many there are.
        size: (height, width) of the picture.
        middle: Of the frame.
        level: Cells are 2^level px.

    Returns:
        The pieces, and [n] in which of them each pixel is.
    """
    ends = [axis.middle - (0.0 if axis.odd else 0.5) for axis in middle]
    centre = torch.tensor(ends, dtype=torch.float64, device=at.device)
    cells = ((at - centre) / (1 << level)).floor().long()
    low, high = _ends(cells, which, borders, size, middle, level)
    blocks = cells.div(_CELLS, rounding_mode="floor")
    first = blocks.amin(0)
    blocks -= first
    rows, columns = (blocks.amax(0) + 1).tolist()
    key = (which * rows + blocks[:, 0]) * columns + blocks[:, 1]
    keys, of = torch.unique(key, return_inverse=True)
    border = keys.div(rows * columns, rounding_mode="floor")
    one = (high - low).prod(1) <= torch.bincount(border, minlength=borders) * _BLOCK**2
    # blocks of a border that is taken as one rectangle come one after another
    begins = ~one[border]
    begins[0] = True
    begins[1:] |= border.diff() > 0
    number = begins.cumsum(0) - 1
    keys, border = keys[begins], border[begins]
    row = keys.div(columns, rounding_mode="floor") % rows
    block = torch.stack([row, keys % columns], 1) + first
    one = one[border, None]
    corner = torch.where(one, low[border], block * _CELLS - _AROUND)
    extent = torch.where(one, (high - low)[border], _BLOCK)
    found = [
        Piece((y, x), (height, width), n)
        for (y, x), (height, width), n in zip(
            corner.tolist(), extent.tolist(), border.tolist(), strict=True
        )
    ]
    return found, number[of]


def _ends(
    cells: Tensor,
    which: Tensor,
    borders: int,
    size: tuple[int, int],
    middle: tuple[Axis, Axis],
    level: int,
) -> tuple[Tensor, Tensor]:
    """The first cells of the rectangle around each border's own and the ends, [borders, 2] both.

    A cell beyond the picture is in it: its values are read between this and the next.
    """
    number = which[:, None].expand(-1, 2)
    low, high = (
        cells.new_zeros(borders, 2).scatter_reduce(0, number, cells, how, include_self=False)
        for how in ("amin", "amax")
    )
    first = [(-axis.middle >> level) - 1 for axis in middle]
    end = [1 - ((axis.middle - length) >> level) for length, axis in zip(size, middle, strict=True)]
    return (
        torch.maximum(low - _AROUND, cells.new_tensor(first)),
        torch.minimum(high + 1 + _AROUND, cells.new_tensor(end)),
    )


def alike(some: list[Piece], level: int) -> Iterator[slice]:
    """Pieces of equal size, as many as are continued at once."""
    first = 0
    while first < len(some):
        rows, columns = some[first].cells
        most = first + max(1, _SAMPLES // (rows * columns << 2 * level))
        end = first + 1
        while end < min(most, len(some)) and some[end].cells == (rows, columns):
            end += 1
        yield slice(first, end)
        first = end

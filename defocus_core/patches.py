"""Where a layer lies around a tile, and where it shows: each is blurred within that rectangle."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.spans import Span, least_transform
from defocus_core.tiling import BLOCK, Box


class Patch(NamedTuple):
    """A layer that a tile sees.

    Attributes:
        lit: Where it lies, as far as it reaches the tile.
        seen: Where in the tile it shows.
        margin: Px that it spreads.
    """

    lit: Box
    seen: Box
    margin: int

    @property
    def least(self) -> tuple[int, int]:
        """(height, width) of the transform that it needs."""
        down, across = (
            least_transform(lit, seen, self.margin)
            for lit, seen in zip(self.lit.sides, self.seen.sides, strict=True)
        )
        return down, across

    @property
    def corner(self) -> tuple[int, int]:
        """The first row and column of both."""
        return min(self.lit.top, self.seen.top), min(self.lit.left, self.seen.left)

    def transformed(self, size: tuple[int, int], tile: Box, most: tuple[int, int]) -> Box:
        """The rectangle that a transform of some (height, width) takes.

        It lies within that of the whole tile, whose size is the most there is.
        """
        top, left = (min(self.corner[d], tile[d] - self.margin + most[d] - size[d]) for d in (0, 1))
        return Box(top, left, *size)


def patch_of(held: tuple[Span, Span], wanted: tuple[Span, Span], margin: int) -> Patch | None:
    """What shows of a layer, None if nothing.

    Args:
        held: Rows and columns in which it lies.
        wanted: Those that are looked at.
        margin: Px that it spreads.
    """
    lit = [one.within(other.grown(margin)) for one, other in zip(held, wanted, strict=True)]
    seen = [one.grown(margin).within(other) for one, other in zip(lit, wanted, strict=True)]
    if min(span.length for span in (*lit, *seen)) <= 0:
        return None
    return Patch(Box.over(*lit), Box.over(*seen), margin)


def patches(
    some: Tensor, tiles: list[Box], margin: int, size: tuple[int, int]
) -> list[Patch | None]:
    """What each tile sees of a layer, None if nothing.

    Args:
        some: [rows, columns] bool, the blocks in which the layer is.
        tiles: Counted from the first sample of the layer.
        margin: Px that it spreads.
        size: (height, width) of the layer in px.
    """
    whole = Box(0, 0, *size)
    near = [tile.grown(margin, whole).sides for tile in tiles]
    ends = [
        torch.tensor([(span.first // BLOCK, -(-span.end // BLOCK)) for span in spans]).clamp(min=0)
        for spans in zip(*near, strict=True)
    ]
    found: list[Patch | None] = []
    for tile, rows, columns in zip(
        tiles, _extents(some, *ends), _extents(some.T, *reversed(ends)), strict=True
    ):
        down, across = (
            Span(first * BLOCK, end * BLOCK).within(side)
            for (first, end), side in zip((rows, columns), whole.sides, strict=True)
        )
        found.append(patch_of((down, across), tile.sides, margin))
    return found


def _extents(some: Tensor, along: Tensor, beside: Tensor) -> list[list[int]]:
    """The first row that holds something and the one after the last, for each of some rectangles.

    Args:
        some: [rows, columns] bool.
        along: [n, 2] the first row of rectangles, and the one after the last.
        beside: [n, 2] the same of columns.
    """
    count = pad(some.to(torch.int32), (1, 0)).cumsum(1)
    first, end = beside.unbind(1)
    held = count[:, end] > count[:, first]  # [rows, n]
    row = torch.arange(len(some))[:, None]
    held &= (row >= along[:, 0]) & (row < along[:, 1])
    number = held.to(torch.int32)
    first, end = number.argmax(0), len(some) - number.flip(0).argmax(0)
    return torch.stack([first, torch.where(held.any(0), end, first)], 1).tolist()

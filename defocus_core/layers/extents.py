"""The rectangle around a tile that a layer takes up, and in which it is blurred."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.images.box import Box, Span
from defocus_core.images.tiling import BLOCK


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
    some: Tensor, tiles: list[Box], margins: list[int], size: tuple[int, int]
) -> list[list[Patch | None]]:
    """What each tile sees of each layer, None if nothing.

    Args:
        some: [L, rows, columns] bool, the blocks in which layers are.
        tiles: Counted from the first sample of the layers.
        margins: Px that each layer spreads.
        size: (height, width) of the layers in px.
    """
    whole, near = Box(0, 0, *size), torch.tensor(margins)[:, None]
    places = torch.tensor(tiles)
    down, across = (
        _blocks(places[:, d] - near, places[:, d] + places[:, d + 2] + near, size[d])
        for d in (0, 1)
    )
    extents = _extents(some, down, across), _extents(some.mT, across, down)
    return [
        [
            patch_of(_in_px(held, whole), tile.sides, margin)
            if all(first < end for first, end in held)
            else None
            for tile, held in zip(tiles, zip(*of_tiles, strict=True), strict=True)
        ]
        for margin, of_tiles in zip(margins, zip(*extents, strict=True), strict=True)
    ]


def _blocks(first: Tensor, end: Tensor, length: int) -> Tensor:
    """The first blocks that hold some px along an axis, and those after the last: [L, n, 2]."""
    return torch.stack([first.clamp(min=0), end.clamp(0, length) + (BLOCK - 1)], 2) // BLOCK


def _in_px(held: Sequence[list[int]], whole: Box) -> tuple[Span, Span]:
    """Rows and columns of a picture, from those of its blocks."""
    down, across = (
        Span(first * BLOCK, end * BLOCK).within(side)
        for (first, end), side in zip(held, whole.sides, strict=True)
    )
    return down, across


def _extents(some: Tensor, along: Tensor, beside: Tensor) -> list[list[list[int]]]:
    """The first row that holds something and the one after the last, for each of some rectangles.

    Args:
        some: [L, rows, columns] bool.
        along: [L, n, 2] the first row of rectangles, and the one after the last.
        beside: [L, n, 2] the same of columns.
    """
    rows = some.shape[1]
    count = pad(some.to(torch.int32), (1, 0)).cumsum(2)
    first, end = (count.gather(2, x[:, None].expand(-1, rows, -1)) for x in beside.unbind(2))
    held = end > first  # [L, rows, n]
    row = torch.arange(rows)[:, None]
    held &= (row >= along[:, None, :, 0]) & (row < along[:, None, :, 1])
    number = held.to(torch.int32)
    start, stop = number.argmax(1), rows - number.flip(1).argmax(1)
    return torch.stack([start, torch.where(held.any(1), stop, start)], 2).tolist()


def least_transform(lit: Span, seen: Span, margin: int) -> int:
    """The least length of a circular transform that blurs some samples.

    What wraps around falls outside of what is wanted.

    Args:
        lit: Samples that are not 0.
        seen: Those that are wanted, none farther than the margin from the others.
        margin: Samples that kernels spread to each side.
    """
    return max(seen.end - lit.first, lit.end - seen.first) + margin

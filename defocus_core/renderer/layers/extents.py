"""The rectangle around a tile that a layer takes up, and in which it is blurred."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.tensors.box import Box, Span, min_transform
from defocus_core.tensors.tiling import BLOCK


class Patch(NamedTuple):
    """The rectangles of a layer in and around a tile."""

    lit: Box  # where the layer has pixels whose blur reaches the tile
    shown: Box  # where in the tile the blurred layer shows
    margin: int  # blur radius of the layer, in px

    @property
    def minimum(self) -> tuple[int, int]:
        """The least (height, width) of a transform that blurs the layer."""
        down, across = (
            min_transform(lit, shown, self.margin)
            for lit, shown in zip(self.lit.sides, self.shown.sides, strict=True)
        )
        return down, across

    @property
    def corner(self) -> tuple[int, int]:
        """The first row and column of both rectangles."""
        return min(self.lit.top, self.shown.top), min(self.lit.left, self.shown.left)

    def transformed(self, size: tuple[int, int], tile: Box, maximum: tuple[int, int]) -> Box:
        """The window that a transform of the given (height, width) reads.

        It lies within the window of the whole tile, whose size is `maximum`.
        """
        top, left = (
            min(self.corner[d], tile[d] - self.margin + maximum[d] - size[d]) for d in (0, 1)
        )
        return Box(top, left, *size)


def patch_of(held: tuple[Span, Span], wanted: tuple[Span, Span], margin: int) -> Patch | None:
    """The patch of a layer in a rectangle; None if the layer does not reach it.

    `margin`: blur radius of the layer, in px.
    """
    lit = [
        layer_side.within(wanted_side.grown(margin))
        for layer_side, wanted_side in zip(held, wanted, strict=True)
    ]
    shown = [
        layer_side.grown(margin).within(wanted_side)
        for layer_side, wanted_side in zip(lit, wanted, strict=True)
    ]
    if min(span.length for span in (*lit, *shown)) <= 0:
        return None
    return Patch(Box.over(*lit), Box.over(*shown), margin)


def patches(
    occupied: Tensor, tiles: list[Box], margins: list[int], size: tuple[int, int]
) -> list[list[Patch | None]]:
    """For each layer its patch in each tile; None if the layer does not reach the tile.

    `occupied`: [L, rows, columns] bool, the blocks in which layers have pixels; `margins`: blur
    radius of each layer, in px; `size`: (height, width) of the layers in px.
    """
    whole, margin_px = Box(0, 0, *size), torch.tensor(margins)[:, None]
    corners = torch.tensor(tiles)
    down, across = (
        _blocks(corners[:, d] - margin_px, corners[:, d] + corners[:, d + 2] + margin_px, size[d])
        for d in (0, 1)
    )
    extents = _extents(occupied, down, across), _extents(occupied.mT, across, down)
    return [
        [
            patch_of(_in_px(held, whole), tile.sides, margin)
            if all(first < end for first, end in held)
            else None
            for tile, held in zip(tiles, zip(*layer_extents, strict=True), strict=True)
        ]
        for margin, layer_extents in zip(margins, zip(*extents, strict=True), strict=True)
    ]


def _blocks(first: Tensor, end: Tensor, length: int) -> Tensor:
    """From px to blocks along an axis: the first block and the one after the last, [L, n, 2]."""
    return torch.stack([first.clamp(min=0), end.clamp(0, length) + (BLOCK - 1)], 2) // BLOCK


def _in_px(held: Sequence[list[int]], whole: Box) -> tuple[Span, Span]:
    """Rows and columns of pixels, from rows and columns of blocks."""
    down, across = (
        Span(first * BLOCK, end * BLOCK).within(side)
        for (first, end), side in zip(held, whole.sides, strict=True)
    )
    return down, across


def _extents(occupied: Tensor, along: Tensor, beside: Tensor) -> list[list[list[int]]]:
    """In each of n rectangles the first occupied row and the one after the last: L x n x 2.

    `occupied`: [L, rows, columns] bool; `along`: [L, n, 2] the first row of each rectangle, and the
    one after the last; `beside`: [L, n, 2] the first column of each rectangle, and the one after
    the last.
    """
    rows = occupied.shape[1]
    count = pad(occupied.to(torch.int32), (1, 0)).cumsum(2)
    first, end = (count.gather(2, x[:, None].expand(-1, rows, -1)) for x in beside.unbind(2))
    held = end > first  # [L, rows, n]
    row = torch.arange(rows)[:, None]
    held &= (row >= along[:, None, :, 0]) & (row < along[:, None, :, 1])
    number = held.to(torch.int32)
    start, stop = number.argmax(1), rows - number.flip(1).argmax(1)
    return torch.stack([start, torch.where(held.any(1), stop, start)], 2).tolist()

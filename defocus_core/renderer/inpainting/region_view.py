"""A part of the frame in which content is hidden, at full or half resolution."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.inpainting.two_layer_pyramid import PyramidLevel
from defocus_core.tensors.box import Box
from defocus_core.tensors.pyramid import Axis, averaged, halves, spread_out

_Axes = tuple[Axis, Axis]


class View(NamedTuple):
    """A part of a frame whose cells are pixels or, at half resolution, two by two pixels.

    Attributes:
        picture: [C + 1, h, w], colour and radius in px of the farthest surface in each cell.
        near: [h, w] px, the least radius in each cell.
        middle: Where the middle of the frame is among cells.
        fine: Where the middle of the frame is among pixels.
        halvings: 0 or 1.
    """

    picture: Tensor
    near: Tensor
    middle: _Axes
    fine: _Axes
    halvings: int

    def pixels(self, at: Tensor) -> Tensor:
        """The places of cells [n, 2], also between cells, as rows and columns of pixels."""
        step = 1 << self.halvings
        places = [
            (at[:, d] - axis.middle) * step + fine.middle
            if axis.odd
            else ((at[:, d] - axis.middle) * step + fine.middle).float() + (step - 1) / 2
            for d, (axis, fine) in enumerate(zip(self.middle, self.fine, strict=True))
        ]
        return torch.stack(places, 1)

    def cells(self, box: Box) -> Box:
        """The cells that hold the pixels of a rectangle."""
        if not self.halvings:
            return box
        ends = []
        for start, length, axis, fine in zip(box[:2], box[2:], self.middle, self.fine, strict=True):
            half = halves(length, Axis(fine.middle - start, fine.odd))
            ends.append((axis.middle - half.axis.middle, half.length))
        return Box(ends[0][0], ends[1][0], ends[0][1], ends[1][1])


def whole_view(whole: PyramidLevel) -> View:
    """A picture at full resolution."""
    values, near = (x.reshape(-1, *whole.size) for x in (whole.first.values, whole.first.least))
    return View(values, near[0], whole.middle, whole.middle, 0)


def half_view(half: PyramidLevel, fine: _Axes) -> View:
    """A picture at half resolution."""
    near = half.first.least
    if half.second is not None and half.number is not None:
        held = torch.nonzero(half.number >= 0)[:, 0]
        nearer = half.second.least.index_select(0, half.number.index_select(0, held))
        near = near.index_copy(0, held, torch.minimum(near.index_select(0, held), nearer))
    values = half.first.values.reshape(-1, *half.size)
    return View(values, near.reshape(half.size), half.middle, fine, 1)


def in_pixels(values: Tensor, size: tuple[int, int], middle: _Axes) -> Tensor:
    """For each pixel the greatest value [H, W] of the cells of half resolution it is part of."""
    down, across = (halves(n, axis) for n, axis in zip(size, middle, strict=True))
    wide = spread_out(values, (down.axis.odd, across.axis.odd))
    return wide[down.before : down.before + size[0], across.before : across.before + size[1]]


def in_cells(mask: Tensor, middle: _Axes) -> Tensor:
    """Which cells of half resolution hold any pixel of a mask [H, W] bool."""
    share, _ = averaged(mask.to(torch.float32)[None, None], 1, middle)
    return share[0, 0].gt(0)

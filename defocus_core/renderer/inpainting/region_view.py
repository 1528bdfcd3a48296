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
    """A part of a frame whose coarse pixels are pixels or, at half resolution, two by two."""

    # [C + 1, ..., h, w], colour and radius in px of the farthest surface in each coarse pixel
    picture: Tensor
    near: Tensor  # [..., h, w] px, the least radius in each coarse pixel
    middle: _Axes  # where the middle of the frame is among coarse pixels
    fine: _Axes  # where the middle of the frame is among pixels
    level: int

    def pixels(self, at: Tensor) -> Tensor:
        """The places of coarse px [n, 2], also between coarse px, as rows and columns of pixels."""
        step = 1 << self.level
        positions = [
            (at[:, d] - axis.middle) * step + fine.middle
            if axis.odd
            else ((at[:, d] - axis.middle) * step + fine.middle).float() + (step - 1) / 2
            for d, (axis, fine) in enumerate(zip(self.middle, self.fine, strict=True))
        ]
        return torch.stack(positions, 1)

    def coarse(self, box: Box) -> Box:
        """The coarse pixels that hold the pixels of a rectangle."""
        if not self.level:
            return box
        limits = []
        for start, length, axis, fine in zip(box[:2], box[2:], self.middle, self.fine, strict=True):
            half = halves(length, Axis(fine.middle - start, fine.odd))
            limits.append((axis.middle - half.axis.middle, half.length))
        return Box(limits[0][0], limits[1][0], limits[0][1], limits[1][1])


def whole_view(whole: PyramidLevel) -> View:
    """A picture at full resolution."""
    first = whole.first
    values, near = (x.reshape(*x.shape[:-1], *whole.shape) for x in (first.values, first.minimum))
    return View(values, near, whole.middle, whole.middle, 0)


def half_view(half: PyramidLevel, fine: _Axes) -> View:
    """A picture at half resolution."""
    near = half.first.minimum
    if half.second is not None and half.second_index is not None:
        held = torch.nonzero(half.second_index >= 0)[:, 0]
        nearer = half.second.minimum.index_select(0, half.second_index.index_select(0, held))
        near = near.index_copy(0, held, torch.minimum(near.index_select(0, held), nearer))
    values = half.first.values.reshape(-1, *half.shape)
    return View(values, near.reshape(half.shape), half.middle, fine, 1)


def in_pixels(values: Tensor, size: tuple[int, int], middle: _Axes) -> Tensor:
    """The greatest value [..., H, W] of the coarse pixels that each pixel is part of."""
    down, across = (halves(n, axis) for n, axis in zip(size, middle, strict=True))
    wide = spread_out(values, (down.axis.odd, across.axis.odd))
    return Box(down.before, across.before, *size).of(wide)


def in_coarse_pixels(mask: Tensor, middle: _Axes) -> Tensor:
    """Which coarse pixels of half resolution hold any pixel of a mask [..., H, W] bool."""
    fraction, _ = averaged(mask.to(torch.float32)[None, None], 1, middle)
    return fraction[0, 0].gt(0)

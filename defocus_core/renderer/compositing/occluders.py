"""Occluders: the surfaces that may stand before lights, and their coverage between pixels.

A pixel on a depth edge is a part of two surfaces. The nearer one covers a fraction of it, and the
farther one stands behind the whole of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.matting import Unmixed
from defocus_core.renderer.layers.block_index import blocks_of
from defocus_core.renderer.layers.slice_radii import slice_position
from defocus_core.tensors.neighbourhoods import extreme_around
from defocus_core.tensors.sparse_masks import exceeding

# A pixel is beside a depth edge if its radius and those of its neighbours span more px than this.
_EDGE = 1.513


class Occluder(NamedTuple):
    """A surface that may stand before lights."""

    signed_radius: Tensor  # [H, W] px
    positions: Tensor  # [H, W] positions between slice radii
    coverage: Tensor  # [H, W], the fraction of each pixel that the surface covers


def occluders_of(
    unmixed: Unmixed, signed_radius: Tensor, positions: Tensor, radii: tuple[float, ...]
) -> list[Occluder]:
    """The surfaces of pixels [H, W] that may stand before lights, with parts of mixed pixels."""
    coverage = torch.ones_like(positions) if unmixed.coverage is None else unmixed.coverage[0]
    occluders, fringe = [Occluder(signed_radius, positions, coverage)], unmixed.fringe
    if len(fringe.at):
        values = (
            fringe.signed_radius,
            slice_position(fringe.signed_radius, radii),
            fringe.layer[:, -1],
        )
        at = fringe.at.unbind(1)
        blank = torch.zeros_like(positions)
        occluders.append(Occluder(*(blank.index_put(at, each) for each in values)))
    return occluders


class Occluders:
    """Surfaces before lights.

    Attributes:
        size: (height, width).
        blocks: [K, rows, columns] bool, the blocks that hold a pixel of each slice.
    """

    def __init__(self, occluders: Sequence[Occluder], slices: int) -> None:
        """Find the depth edges, and the blocks of each slice."""
        self.size = occluders[0].positions.shape[0], occluders[0].positions.shape[1]
        self._occluders = [
            Occluder(radius.detach().flatten(), positions.flatten(), coverage.flatten())
            for radius, positions, coverage in occluders
        ]
        r = occluders[0].signed_radius.detach()
        nearest, farthest = (extreme_around(r, 1, end) for end in (torch.minimum, torch.maximum))
        self._edges = exceeding(farthest - nearest, _EDGE).flatten()
        held = [_blocks(occluder, slices) for occluder in occluders]
        self._slice_indices = [blocks.any(2).any(1).tolist() for blocks in held]
        self.blocks = torch.stack(held).any(0)

    def beside(
        self,
        pixels: Sequence[Tensor],  # the rows and columns of the nearest pixels, each [m, side]
        positions: Sequence[Tensor],  # the rows and columns, each [m, side]
        slice_index: int,
        limit: Tensor,  # [m] px, the radius below which a surface counts
    ) -> Tensor:
        """The coverage by a slice in squares: [m, side, side]."""
        m, side = pixels[0].shape
        spot = (pixels[0][:, :, None] * self.size[1] + pixels[1][:, None, :]).flatten()
        fraction = self.coverage(spot, slice_index, limit.repeat_interleave(side * side))
        index = torch.nonzero(self._edges.index_select(0, spot))[:, 0]
        square = index.div(side * side, rounding_mode="floor")
        number = index.div(side, rounding_mode="floor")
        y = positions[0].flatten().index_select(0, number)
        x = positions[1].flatten().index_select(0, square * side + index - number * side)
        between = self._between_pixels(y, x, slice_index, limit.index_select(0, square))
        return fraction.index_copy(0, index, between).view(m, side, side)

    def _between_pixels(self, y: Tensor, x: Tensor, slice_index: int, limit: Tensor) -> Tensor:
        """The coverage by a slice at rows and columns [n], interpolated between four pixels."""
        limits = []
        for position, length in zip((y, x), self.size, strict=True):
            below = position.floor()
            beyond, pixel = position - below, below.long()
            pixels = (pixel.clamp(0, length - 1), (pixel + 1).clamp(0, length - 1))
            limits.append(list(zip(pixels, (1 - beyond, beyond), strict=True)))
        total = torch.zeros_like(y)
        for row, down in limits[0]:
            for column, across in limits[1]:
                spot = row * self.size[1] + column
                total.addcmul_(self.coverage(spot, slice_index, limit), down * across)
        return total

    def coverage(self, spot: Tensor, slice_index: int, limit: Tensor) -> Tensor:
        """The coverage of pixels [n] by a slice, of surfaces whose radius is below a limit [n]."""
        total = torch.zeros_like(limit)
        for occluder, slice_indices in zip(self._occluders, self._slice_indices, strict=True):
            if slice_indices[slice_index]:
                radius, positions, coverage = (values.index_select(0, spot) for values in occluder)
                fraction = positions.sub_(slice_index).abs_().neg_().add_(1).clamp_(min=0)
                # not the light's own surface
                total.addcmul_(fraction.mul_(radius.sub_(limit).lt_(0)), coverage)
        return total


def _blocks(occluder: Occluder, slices: int) -> Tensor:
    """For each slice the blocks that hold a pixel of a surface: [K, rows, columns] bool."""
    covered = occluder.coverage.detach() > 0
    return blocks_of(occluder.positions, slices, None if bool(covered.all()) else covered)

"""Fringe samples: parts of nearer surfaces in pixels on a depth edge."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from defocus_core.tensors.box import Box
from defocus_core.tensors.pyramid import Axis
from defocus_core.tensors.tiling import BLOCK


class FringeSamples:
    """The fringe samples of a surface, each with its share in one slice, sorted by layer."""

    def __init__(
        self, at: Tensor, samples: Tensor, positions: Tensor, layers: list[int], height: int
    ) -> None:
        """Sort samples by layer and by rows of blocks.

        `at`: [n, 2] rows and columns; rows are counted on from one picture of a batch to the next;
        `samples`: [n, C + 1], colour premultiplied by coverage, then coverage; `positions`: [n]
        positions between slice radii.
        """
        lower = positions.detach().floor()
        slice_index = torch.cat([lower, lower + 1])
        fraction = 1 - (torch.cat([positions, positions]) - slice_index).abs()
        self._rows = -(-height // BLOCK)
        layer_index = torch.tensor([*layers, layers[-1]], device=at.device)[slice_index.long()]
        above = at[:, 0].div(height, rounding_mode="floor")
        at = torch.stack([at[:, 0] - above * height, at[:, 1]], 1)
        band = layer_index * self._rows + at[:, 0].div(BLOCK, rounding_mode="floor").repeat(2)
        order = band.argsort(stable=True)
        self._slice_index = slice_index.long().index_select(0, order)
        sample = order % max(len(at), 1)
        self._y, self._x = at.index_select(0, sample).unbind(1)
        self._of = above.index_select(0, sample)  # the picture of the batch
        self._samples = samples.index_select(0, sample).T * fraction.index_select(0, order)
        counts = torch.bincount(band, minlength=(max(layers) + 1) * self._rows)
        self._starts = [0, *counts.cumsum(0).tolist()]

    def _range(self, layer_index: int, first: int, end: int) -> slice:
        """Range of the sorted samples of a layer in rows of blocks from `first` to before `end`."""
        offset = layer_index * self._rows
        return slice(self._starts[offset + first], self._starts[offset + end])

    def add(self, slices: Tensor, layer_index: int, first: int, window: Box, lit: Box) -> None:
        """Add the samples in a rectangle to slices of a layer.

        `slices`: [C + 1, k, ..., height, width]; changed in place.
        """
        chosen = self._range(layer_index, lit.top // BLOCK, -(-(lit.top + lit.height) // BLOCK))
        if chosen.start == chosen.stop:
            return
        k, (height, width) = slices.shape[1], slices.shape[-2:]
        slot, y, x = (
            self._slice_index[chosen] - first,
            self._y[chosen] - lit.top,
            self._x[chosen] - lit.left,
        )
        inside = (slot >= 0) & (slot < k) & (y >= 0) & (y < lit.height)
        inside &= (x >= 0) & (x < lit.width)
        origin = (lit.top - window.top) * width + lit.left - window.left
        pictures = math.prod(slices.shape[2:-2])
        number = slot if pictures == 1 else slot * pictures + self._of[chosen]
        spot = ((number * height + y) * width + x + origin) * inside
        slices.view(len(slices), -1).index_add_(1, spot, self._samples[:, chosen] * inside)

    def averaged(
        self,
        pixels: Tensor,
        layer_index: int,
        slice_index: int,
        step: int,
        coarse: Box,
        middle: tuple[Axis, Axis],
    ) -> None:
        """Add the samples of a slice to this slice at reduced resolution.

        `pixels`: [C + 1, ..., height, width], the slice without the samples; changed in place.
        """
        layer_range = self._range(layer_index, 0, self._rows)
        index_of_slice = (
            torch.nonzero(self._slice_index[layer_range] == slice_index)[:, 0] + layer_range.start
        )
        if not len(index_of_slice):
            return
        samples = self._samples.index_select(1, index_of_slice) / step**2
        # for each axis: the coarse pixels that have a share of a sample, and their shares
        sides = []
        for position, axis, start in zip((self._y, self._x), middle, coarse[:2], strict=True):
            offset = position[index_of_slice] - axis.middle
            lower = offset.div(step, rounding_mode="floor")
            upper = (offset - lower * step).to(samples.dtype) / step
            sides.append(
                [(lower - start, 1 - upper), (lower + 1 - start, upper)]
                if axis.odd
                else [(lower - start, torch.ones_like(upper))]
            )
        flat = pixels.view(len(pixels), -1)
        first = self._of[index_of_slice] * (coarse.height * coarse.width)
        channel = torch.arange(len(pixels), device=pixels.device)[:, None]
        for y, row_weight in sides[0]:
            for x, column_weight in sides[1]:
                inside = (y >= 0) & (y < coarse.height) & (x >= 0) & (x < coarse.width)
                spot = torch.where(inside, first + y * coarse.width + x, 0)
                fractions = row_weight * column_weight * inside
                # in a fixed order on a GPU, too, where index_add_ has none
                flat.index_put_((channel, spot), samples * fractions, accumulate=True)

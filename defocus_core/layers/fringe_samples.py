"""Fringe samples: parts of nearer surfaces in pixels on a depth edge."""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.images.box import Box
from defocus_core.images.pyramid import Axis
from defocus_core.images.tiling import BLOCK


class Points:
    """The further samples of a surface, each with its share in one slice, sorted by layers."""

    def __init__(
        self, at: Tensor, samples: Tensor, places: Tensor, layers: list[int], height: int
    ) -> None:
        """Sort them.

        Args:
            at: [n, 2] rows and columns.
            samples: [n, C + 1].
            places: [n] positions on the ladder.
            layers: For each rung the number of its layer.
            height: Rows of the surface.
        """
        lower = places.detach().floor()
        rung = torch.cat([lower, lower + 1])
        share = 1 - (torch.cat([places, places]) - rung).abs()
        self._rows = -(-height // BLOCK)
        number = torch.tensor([*layers, layers[-1]], device=at.device)[rung.long()]
        band = number * self._rows + at[:, 0].div(BLOCK, rounding_mode="floor").repeat(2)
        order = band.argsort(stable=True)
        self._rung = rung.long().index_select(0, order)
        which = order % max(len(at), 1)
        self._y, self._x = at.index_select(0, which).unbind(1)
        self._samples = samples.index_select(0, which).T * share.index_select(0, order)
        counts = torch.bincount(band, minlength=(max(layers) + 1) * self._rows)
        self._starts = [0, *counts.cumsum(0).tolist()]

    def _of(self, number: int, first: int, end: int) -> slice:
        """Those of a layer in some bands of rows."""
        start = number * self._rows
        return slice(self._starts[start + first], self._starts[start + end])

    def add(self, slices: Tensor, number: int, first: int, corner: Box, lit: Box) -> None:
        """Add to slices what lies in a rectangle.

        Args:
            slices: [C + 1, k, height, width] of a layer; changed.
            number: Of the layer.
            first: Rung of the first slice; the others follow.
            corner: Where they are.
            lit: The rectangle, within.
        """
        some = self._of(number, lit.top // BLOCK, -(-(lit.top + lit.height) // BLOCK))
        if some.start == some.stop:
            return
        _, k, height, width = slices.shape
        slot, y, x = self._rung[some] - first, self._y[some] - lit.top, self._x[some] - lit.left
        inside = (slot >= 0) & (slot < k) & (y >= 0) & (y < lit.height)
        inside &= (x >= 0) & (x < lit.width)
        origin = (lit.top - corner.top) * width + lit.left - corner.left
        spot = ((slot * height + y) * width + x + origin) * inside
        slices.view(len(slices), -1).index_add_(1, spot, self._samples[:, some] * inside)

    def averaged(
        self,
        pixels: Tensor,
        number: int,
        rung: int,
        step: int,
        cells: Box,
        middle: tuple[Axis, Axis],
    ) -> None:
        """Add the points of a slice to it at reduced resolution.

        Args:
            pixels: [C + 1, height, width] without; changed.
            number: Of its layer.
            rung: Of the slice.
            step: Px between cells.
            cells: What the pixels are, counted from the first at or after the middle of the frame.
            middle: Of the frame, counted from the first sample.
        """
        some = self._of(number, 0, self._rows)
        here = torch.nonzero(self._rung[some] == rung)[:, 0] + some.start
        if not len(here):
            return
        samples = self._samples.index_select(1, here) / step**2
        sides = []  # of each axis the cells that have shares in a pixel, and the shares
        for at, axis, start in zip((self._y, self._x), middle, cells[:2], strict=True):
            offset = at[here] - axis.middle
            lower = offset.div(step, rounding_mode="floor")
            upper = (offset - lower * step).to(samples.dtype) / step
            sides.append(
                [(lower - start, 1 - upper), (lower + 1 - start, upper)]
                if axis.odd
                else [(lower - start, torch.ones_like(upper))]
            )
        flat = pixels.view(len(pixels), -1)
        channel = torch.arange(len(pixels), device=pixels.device)[:, None]
        for y, of_row in sides[0]:
            for x, of_column in sides[1]:
                inside = (y >= 0) & (y < cells.height) & (x >= 0) & (x < cells.width)
                spot = torch.where(inside, y * cells.width + x, 0)
                shares = of_row * of_column * inside
                # in a fixed order on a GPU, too, where index_add_ has none
                flat.index_put_((channel, spot), samples * shares, accumulate=True)

"""Slices of large radii blurred at reduced resolution, over a whole region at once.

A disc many px wide blurs away fine detail. So slices of large radii are averaged to 1/2, 1/4, ...
of the resolution, blurred there, and interpolated by cubics (Keys 1981). Each pixel gets its shares
in slices before the averages. As in all halved pictures, cells lie symmetrically about the middle
of the frame.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from defocus_core.renderer.blur.fourier import crop_inverse, sum_of_products
from defocus_core.renderer.blur.kernel_bank import TransformWindow
from defocus_core.renderer.layers.extents import patch_of
from defocus_core.renderer.layers.sliced_surface import Surface
from defocus_core.tensors.box import Box, Span
from defocus_core.tensors.pyramid import Axis, place_of
from defocus_core.tensors.resampling import Shares, cubic_shares, resampled


class Reduced:
    """A layer of a surface at reduced resolution."""

    def __init__(
        self,
        surface: Surface,
        window: TransformWindow,
        slices: dict[int, int],
        tilted: set[int],
        groups: list[slice],
        core: Box,
        middle: tuple[Axis, Axis],
    ) -> None:
        """Blur the slices of a layer.

        Args:
            surface: The surface of the slices.
            window: The window that the slices share.
            slices: For each rung of the surface that reaches the core, the number of its slice.
            tilted: The rungs that have slopes.
            groups: Groups of aperture parts.
            core: The rectangle to blur, counted from the first sample of the surface.
            middle: The middle of the frame, counted from the first sample, too.
        """
        self._middle, self._halvings = middle, window.halvings
        self._shares: dict[tuple[float, int], Shares] = {}
        self._cells: tuple[Span, Span] | None = None
        self._groups: list[Tensor] = []
        step = 1 << window.halvings
        around, reach = self._read_by(core), (window.margin + 3) * step
        bounds = surface.bounds(list(slices))
        if not (bounds.height and bounds.width):
            return
        patch = patch_of(self._spans(bounds), around, window.margin)
        if patch is None:
            return
        size = window.fitting(patch.least)
        cells = Box(*patch.corner, *size)
        # samples after the end of `lit` would wrap around into the core
        lit = Box.over(
            *(Span(a.first, b.end) for a, b in zip(cells.sides, patch.lit.sides, strict=True))
        )
        terms: list[tuple[Tensor, Tensor]] = []
        sloping = [rung for rung in slices if rung in tilted]
        common_slopes = surface.planes(sloping, core.around(reach))
        slopes = dict(zip(sloping, common_slopes, strict=True))
        kernels = window.tilted({slices[rung]: s for rung, s in slopes.items() if s}, size)
        for rung, k in slices.items():
            lean = rung in tilted and not slopes[rung]
            averages = surface.averaged(rung, window.halvings, lit, middle, tilted=lean)
            plain, *leaning = torch.fft.rfft2(averages, s=size)
            terms.append((plain, kernels[k] if k in kernels else window.spectrum(k, size)))
            terms += zip(leaning, window.leaning(k, size) if lean else (), strict=True)
        crop = patch.shown.seen_from(cells)
        self._groups = [crop_inverse(sum_of_products(terms, group), size, crop) for group in groups]
        self._cells = patch.shown.sides

    def over(self, box: Box) -> tuple[Box, list[Tensor]] | None:
        """The layer at full resolution within a rectangle, counted from the first sample.

        Returns:
            The part of the rectangle where the layer is not 0, and the layer there for each group
            of m parts, [m, C + 1, h, w]; None if it is 0 all over.
        """
        if self._cells is None:
            return None
        sides = [
            self._pixels(d, cells).within(side)
            for d, (cells, side) in enumerate(zip(self._cells, box.sides, strict=True))
        ]
        if min(side.length for side in sides) <= 0:
            return None
        shown = Box.over(*sides)
        down, across = (
            cells.within(wanted)
            for cells, wanted in zip(self._cells, self._read_by(shown), strict=True)
        )
        rows, columns = (
            self._between(d, shown[d], shown[d + 2], cells.first, self._groups[0])
            for d, cells in enumerate((down, across))
        )
        crop = Box.over(down, across).seen_from(Box.over(*self._cells))
        return shown, [resampled(crop.of(group), rows, columns) for group in self._groups]

    def _spans(self, box: Box) -> tuple[Span, Span]:
        """The cells between which the pixels of a box lie: all that they have shares in."""
        down, across = (
            Span(
                math.floor(self._place(d, box[d])),
                math.floor(self._place(d, box[d] + box[d + 2] - 1)) + 2,
            )
            for d in (0, 1)
        )
        return down, across

    def _read_by(self, box: Box) -> tuple[Span, Span]:
        """The cells that the pixels of a box are interpolated from: two on each side."""
        down, across = self._spans(box)
        return down.grown(1), across.grown(1)

    def _pixels(self, dim: int, cells: Span) -> Span:
        """The pixels that are interpolated from a span of cells."""
        axis, step = self._middle[dim], 1 << self._halvings
        origin = self._place(dim, axis.middle)  # place of the middle among cells
        around = (cells.first - 2, cells.end + 1)
        first, end = (axis.middle + math.ceil((cell - origin) * step) for cell in around)
        return Span(first, end)

    def _between(self, dim: int, start: int, length: int, cell: int, like: Tensor) -> Shares:
        """Shares of the cells from `cell` on in `length` pixels; cached: most tiles share them."""
        key = (self._place(dim, start) - cell, length)
        if key not in self._shares:
            self._shares[key] = cubic_shares(*key, 0.5**self._halvings, like)
        return self._shares[key]

    def _place(self, dim: int, pixel: int) -> float:
        """The place of a pixel among cells."""
        axis = self._middle[dim]
        return place_of(pixel, axis, axis._replace(middle=0), self._halvings)

"""Slices of large radii blurred at reduced resolution, over a whole region at once.

A disc many px wide blurs away fine detail. So slices of large radii are averaged to 1/2, 1/4, ...
of the resolution, blurred there, and interpolated by cubics (Keys 1981). Each pixel gets its shares
in slices before the averages. As in all halved pictures, coarse pixels lie symmetrically about the
middle of the frame.
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
from defocus_core.tensors.pyramid import Axis, position_of
from defocus_core.tensors.resampling import AxisWeights, cubic_weights, resampled


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
        """Blur the slices of a layer."""
        self._middle, self._level = middle, window.level
        self._fractions: dict[tuple[float, int], AxisWeights] = {}
        self._coarse_size: tuple[Span, Span] | None = None
        self._groups: list[Tensor] = []
        step = 1 << window.level
        around, reach = self._read_by(core), (window.margin + 3) * step
        bounds = surface.bounds(list(slices))
        if not (bounds.height and bounds.width):
            return
        patch = patch_of(self._spans(bounds), around, window.margin)
        if patch is None:
            return
        size = window.fitting(patch.minimum)
        coarse = Box(*patch.corner, *size)
        # samples after the end of `lit` would wrap around into the core
        lit = Box.over(
            *(Span(a.first, b.end) for a, b in zip(coarse.sides, patch.lit.sides, strict=True))
        )
        terms: list[tuple[Tensor, Tensor]] = []
        sloping = [slice_index for slice_index in slices if slice_index in tilted]
        common_slopes = surface.planes(sloping, core.around(reach))
        slopes = dict(zip(sloping, common_slopes, strict=True))
        kernels = window.tilted(
            {slices[slice_index]: s for slice_index, s in slopes.items() if s}, size
        )
        for slice_index, k in slices.items():
            lean = slice_index in tilted and not slopes[slice_index]
            averages = surface.averaged(slice_index, window.level, lit, middle, tilted=lean)
            plain, *leaning = torch.fft.rfft2(averages, s=size)
            terms.append((plain, kernels[k] if k in kernels else window.spectrum(k, size)))
            terms += zip(leaning, window.leaning(k, size) if lean else (), strict=True)
        crop = patch.shown.seen_from(coarse)
        self._groups = [crop_inverse(sum_of_products(terms, group), size, crop) for group in groups]
        self._coarse_size = patch.shown.sides

    def over(self, box: Box) -> tuple[Box, list[Tensor]] | None:
        """The layer at full resolution within a rectangle, counted from the first sample.

        Returns the part of the rectangle where the layer is not 0, and the layer there for each
        group of m parts, [m, C + 1, h, w]; None if it is 0 all over.
        """
        if self._coarse_size is None:
            return None
        sides = [
            self._pixels(d, coarse).within(side)
            for d, (coarse, side) in enumerate(zip(self._coarse_size, box.sides, strict=True))
        ]
        if min(side.length for side in sides) <= 0:
            return None
        shown = Box.over(*sides)
        down, across = (
            coarse.within(wanted)
            for coarse, wanted in zip(self._coarse_size, self._read_by(shown), strict=True)
        )
        rows, columns = (
            self._between(d, shown[d], shown[d + 2], coarse.first, self._groups[0])
            for d, coarse in enumerate((down, across))
        )
        crop = Box.over(down, across).seen_from(Box.over(*self._coarse_size))
        return shown, [resampled(crop.of(group), rows, columns) for group in self._groups]

    def _spans(self, box: Box) -> tuple[Span, Span]:
        """The coarse pixels between which the pixels of a box lie: all that they have shares in."""
        down, across = (
            Span(
                math.floor(self._position(d, box[d])),
                math.floor(self._position(d, box[d] + box[d + 2] - 1)) + 2,
            )
            for d in (0, 1)
        )
        return down, across

    def _read_by(self, box: Box) -> tuple[Span, Span]:
        """The coarse pixels that the pixels of a box are interpolated from: two on each side."""
        down, across = self._spans(box)
        return down.grown(1), across.grown(1)

    def _pixels(self, dim: int, coarse: Span) -> Span:
        """The pixels that are interpolated from a span of coarse pixels."""
        axis, step = self._middle[dim], 1 << self._level
        origin = self._position(dim, axis.middle)  # place of the middle among coarse pixels
        around = (coarse.first - 2, coarse.end + 1)
        first, end = (
            axis.middle + math.ceil((coarse_pixel - origin) * step) for coarse_pixel in around
        )
        return Span(first, end)

    def _between(
        self, dim: int, start: int, length: int, coarse_pixel: int, like: Tensor
    ) -> AxisWeights:
        """Weights of the coarse pixels from `coarse_pixel` on in `length` pixels, cached."""
        key = (self._position(dim, start) - coarse_pixel, length)
        if key not in self._fractions:
            self._fractions[key] = cubic_weights(*key, 0.5**self._level, like)
        return self._fractions[key]

    def _position(self, dim: int, pixel: int) -> float:
        """The place of a pixel among coarse pixels."""
        axis = self._middle[dim]
        return position_of(pixel, axis, axis._replace(middle=0), self._level)

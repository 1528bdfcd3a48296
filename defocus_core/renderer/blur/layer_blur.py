"""Slices of a surface, blurred over a tile and summed to layers in the Fourier domain.

A disc many px wide blurs away fine detail. So slices of large radii are averaged to 1/2, 1/4, ...
of the resolution, blurred there over a whole region, and interpolated by cubics (Keys 1981). Where
the pupil changes over the frame, the blur of a pixel is interpolated bilinearly between the blurs
at the corners of its region. Neighbouring regions share corners, so that no seam is left.
"""

from __future__ import annotations

from itertools import groupby
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.blur.kernel_bank import Slicing, TransformWindow, blurred
from defocus_core.renderer.layers.sliced_surface import SlicedSurface, SurfaceSamples
from defocus_core.renderer.layers.slopes import NEAR
from defocus_core.tensors.box import Box, Grid
from defocus_core.tensors.pyramid import Axis, coarse_read, upsampled

CORNERS = 4


def blended(layer: Tensor, box: Box, region: Box) -> Tensor:
    """One layer [m, C + 1, h, w], interpolated bilinearly between four blurred versions.

    `layer`: [4 m, C + 1, h, w], each of m parts, blurred as at each corner of `region`; `box`:
    where the layer lies.
    """
    down, across = (
        ((torch.arange(side.first, side.end).to(layer) + 0.5 - whole.first) / whole.length).clamp(
            0, 1
        )
        for side, whole in zip(box.sides, region.sides, strict=True)
    )
    rows = layer.reshape(-1, CORNERS, *layer.shape[1:])
    upper = torch.lerp(rows[:, 0], rows[:, 1], across)
    lower = torch.lerp(rows[:, 2], rows[:, 3], across)
    return torch.lerp(upper, lower, down[:, None])


class Reduced:
    """A layer of a surface at reduced resolution, blurred over a whole region."""

    def __init__(
        self,
        surface: SlicedSurface,
        window: TransformWindow,
        slices: dict[int, int],
        tilted: set[int],
        groups: list[slice],
        core: Box,
        middle: tuple[Axis, Axis],
    ) -> None:
        """Blur the slices of a layer.

        `slices`: for each slice of the surface, its number in `window`; `tilted`: the slices with
        tilted surfaces; `groups`: ranges of parts, each computed at once; `core`: the region;
        `middle`: the middle of the frame.
        """
        self._level, margin = window.level, window.margin
        # coarse pixels are counted from the middle
        self._axes = middle, (middle[0]._replace(middle=0), middle[1]._replace(middle=0))
        self._read = self._read_by(core)
        corner = self._read.top - margin, self._read.left - margin
        terms: list[tuple[Tensor, Tensor]] = []
        sloping = [slice_index for slice_index in slices if slice_index in tilted]
        around = core.enlarged((margin + 3) << window.level)
        slopes = dict(zip(sloping, surface.planes(sloping, around), strict=True))
        kernels = window.tilted({slices[number]: s for number, s in slopes.items() if s})
        for slice_index, k in slices.items():
            lean = slice_index in tilted and not slopes[slice_index]
            box = Box(*corner, *window.size)
            averages = surface.averaged(slice_index, window.level, box, middle, tilted=lean)
            plain, *leaning = torch.fft.rfft2(averages)
            terms.append((plain, kernels[k] if k in kernels else window.spectrum(k)))
            leans = window.spectrum(k, leaning=True) if lean else ()
            terms += zip(leaning, leans, strict=True)
        shown = Box(margin, margin, *self._read[2:])
        self._layer = blurred(terms, groups, window.size, shown)

    def upsampled(self, box: Box) -> Tensor:
        """The layer [M, C + 1, h, w] at full resolution in `box`.

        The box is relative to the first sample of the surface.
        """
        read = self._read_by(box)
        layer = read.seen_from(self._read).crop(self._layer)
        return upsampled(layer, read, box, self._axes, self._level, cubic=True)

    def _read_by(self, box: Box) -> Box:
        """The coarse pixels that cubic interpolation in `box` reads, two on each side."""
        return coarse_read(box, *self._axes, self._level).enlarged(1)


class ShownLayer(NamedTuple):
    """A blurred layer in one tile, as seen through each of M parts of the aperture."""

    layer: Tensor  # [M, C + 1, h, w]
    # [m, C, h, w], sub-pixel shifts to add to the colours of left and right; None for no shifts
    moved: Tensor | None = None


class Blur:
    """The blur of all slices of a surface, tile by tile.

    Attributes:
        surface: The surface, divided into slices.
        windows: The transform window of each slice.
    """

    def __init__(
        self,
        samples: SurfaceSamples,
        radii: tuple[float, ...],  # signed radius of each slice in px of the frame
        slicing: Slicing,
        grid: Grid,
        groups: list[slice],
        middle: tuple[Axis, Axis],
        *,
        by_corners: bool = False,
    ) -> None:
        """Plan the blur of a surface for all tiles, and blur its layers of reduced resolution.

        `groups`: ranges of parts, each computed at once; `middle`: the middle of the frame;
        `by_corners`: whether the pupil differs between the corners of the region.
        """
        self._by_corners, self._stride, self._grid = by_corners, slicing.stride, grid
        each = CORNERS if by_corners else 1  # each part as the corners see it
        self._groups = [slice(each * group.start, each * group.stop) for group in groups]
        whole = [w for w in slicing.windows if not w.level]
        before = max((w.margin for w in whole), default=0)
        beyond = max((n - w.margin for w in whole for n in w.size), default=0)
        every = slice(None, None, slicing.stride)
        self._layers, self.windows = slicing.layers[every], slicing.windows[every]
        self.surface = surface = SlicedSurface(
            samples, radii[every], slicing.coarse[every], grid, before, beyond
        )
        tilted = {slice_index for tile_list in surface.tilted_plan for slice_index in tile_list}
        indices_of: dict[int, list[int]] = {}
        for slice_index in sorted({number for plan in surface.plan for number in plan}):
            indices_of.setdefault(self._layers[slice_index], []).append(slice_index)
        self._reduced: dict[int, Reduced] = {}
        for layer_index, slice_indices in indices_of.items():
            window = self.windows[slice_indices[0]]
            if window.level:
                numbers = {slice_index: slice_index * self._stride for slice_index in slice_indices}
                self._reduced[layer_index] = Reduced(
                    surface, window, numbers, tilted, self._groups, grid.box, middle
                )

    def tile_layers(self, index: int) -> dict[int, ShownLayer]:
        """The layers of the surface in tile number `index`, by number: sums of blurred slices."""
        tile, shown, shifts = self._grid.tiles[index], dict[int, ShownLayer](), None
        for layer_index, numbers in groupby(self.surface.plan[index], self._layers.__getitem__):
            first, *others = numbers
            indices = range(first, (others or [first])[-1] + 1)
            window = self.windows[first]
            if reduced := self._reduced.get(layer_index):
                layer = reduced.upsampled(tile)
            else:
                layer = self._blurred(window, indices, index)
            if self._by_corners:
                layer = blended(layer, tile, self._grid.box)
            moved = None
            if self.surface.has_shifts and float(window.radii.abs().amin()) < NEAR:
                shifts = self.surface.shifts(index) if shifts is None else shifts
                # a part gets shifts for the coverage that it sees, no more
                fraction = self.surface.fractions(indices, tile)
                moved = shifts * torch.minimum(fraction, layer[-len(shifts) :, -1:].clamp(min=0))
            shown[layer_index] = ShownLayer(layer, moved)
        return shown

    def _blurred(self, window: TransformWindow, slice_indices: range, index: int) -> Tensor:
        """A layer [M, C + 1, h, w] in tile number `index`, blurred at full resolution."""
        surface, tile = self.surface, self._grid.tiles[index]
        if not window.margin:  # the same for all parts
            pixels = surface.members(slice_indices, tile).sum(1)
            return pixels.expand(self._groups[-1].stop, *pixels.shape)
        box = Box(tile.top - window.margin, tile.left - window.margin, *window.size)
        pixels = surface.members(slice_indices, box)
        spectra = torch.fft.rfft2(pixels).unbind(1)
        tilted = [number for number in slice_indices if number in surface.tilted_plan[index]]
        common = surface.planes(tilted, tile.enlarged(window.margin))
        slopes = dict(zip(tilted, common, strict=True))
        kernels = window.tilted({n * self._stride: slope for n, slope in slopes.items() if slope})
        terms: list[tuple[Tensor, Tensor]] = []
        for spectrum, slice_index in zip(spectra, slice_indices, strict=True):
            k = slice_index * self._stride
            terms.append((spectrum, kernels[k] if k in kernels else window.spectrum(k)))
        leaning = [i for i, n in enumerate(slice_indices) if slopes.get(n, 0) is None]
        if leaning:
            lean = surface.slopes(box)[:, None, None]
            pairs = torch.fft.rfft2(lean * pixels[:, leaning])
            for i, pair in zip(leaning, pairs.unbind(2), strict=True):
                leans = window.spectrum(slice_indices[i] * self._stride, leaning=True)
                terms += zip(pair, leans, strict=True)
        margin = window.margin
        return blurred(terms, self._groups, window.size, Box(margin, margin, *tile[2:]))

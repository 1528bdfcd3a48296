"""Slices of a surface blurred over a tile, and summed to layers in the Fourier domain.

A disc many px wide blurs away fine detail. So slices of large radii are averaged to 1/2, 1/4, ...
of the resolution, blurred over a whole region there, and interpolated by cubics (Keys 1981). Where
the pupil changes over the frame, a pixel's blur is the mean of those at the corners of its region,
bilinear in its place. Neighbouring regions share corners, so that no seam is left.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.blur.kernel_bank import Slicing, TransformWindow, blurred
from defocus_core.renderer.layers.sliced_surface import (
    Patch,
    SlicedSurface,
    SurfaceSamples,
    patch_of,
)
from defocus_core.renderer.layers.slopes import NEAR
from defocus_core.tensors.box import Box, Grid, Span
from defocus_core.tensors.pyramid import (
    Axis,
    AxisWeights,
    coarse_read,
    cubic_weights,
    position_of,
    resampled,
)

CORNERS = 4


def blended(layer: Tensor, box: Box, region: Box) -> Tensor:
    """One layer [m, C + 1, h, w] of layers [4 m, C + 1, h, w]."""
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
    """A layer of a surface at reduced resolution."""

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
        """Blur the slices of a layer."""
        self._middle, self._level = middle, window.level
        self._coarse_size: tuple[Span, Span] | None = None
        self._layer: Tensor | None = None
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
        lit = Box.from_spans(
            *(Span(a.first, b.end) for a, b in zip(coarse.sides, patch.lit.sides, strict=True))
        )
        terms: list[tuple[Tensor, Tensor]] = []
        sloping = [slice_index for slice_index in slices if slice_index in tilted]
        common_slopes = surface.planes(sloping, core.enlarged(reach))
        slopes = dict(zip(sloping, common_slopes, strict=True))
        kernels = window.tilted(
            {slices[slice_index]: s for slice_index, s in slopes.items() if s}, size
        )
        for slice_index, k in slices.items():
            lean = slice_index in tilted and not slopes[slice_index]
            averages = surface.averaged(slice_index, window.level, lit, middle, tilted=lean)
            plain, *leaning = torch.fft.rfft2(averages, s=size)
            terms.append((plain, kernels[k] if k in kernels else window.spectrum(k, size)))
            terms += zip(
                leaning, window.spectrum(k, size, leaning=True) if lean else (), strict=True
            )
        crop = patch.shown.seen_from(coarse)
        self._layer = blurred(terms, groups, size, crop)
        self._coarse_size = patch.shown.sides

    def upsampled(self, box: Box) -> tuple[Box, Tensor] | None:
        """The layer at full resolution within a rectangle, counted from the first sample.

        Returns the part of the rectangle where the layer is not 0, and the layer there,
        [M, C + 1, h, w]; None if it is 0 all over.
        """
        if self._coarse_size is None or self._layer is None:
            return None
        sides = [
            self._pixels(d, coarse).intersection(side)
            for d, (coarse, side) in enumerate(zip(self._coarse_size, box.sides, strict=True))
        ]
        if min(side.length for side in sides) <= 0:
            return None
        shown = Box.from_spans(*sides)
        down, across = (
            coarse.intersection(wanted)
            for coarse, wanted in zip(self._coarse_size, self._read_by(shown), strict=True)
        )
        read = Box.from_spans(down, across)
        layer = read.seen_from(Box.from_spans(*self._coarse_size)).crop(self._layer)
        weights = (self._axis_weights(d, shown, read, layer) for d in (0, 1))
        return shown, resampled(layer, *weights)

    def _spans(self, box: Box) -> tuple[Span, Span]:
        """The coarse pixels around the pixels of a box: all that have a share in one."""
        down, across = self._middle
        coarse = down._replace(middle=0), across._replace(middle=0)
        return coarse_read(box, self._middle, coarse, self._level).sides

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

    def _axis_weights(self, dim: int, pixels: Box, coarse: Box, like: Tensor) -> AxisWeights:
        """The shares of coarse pixels of a rectangle in the pixels of another, along one axis."""
        first = self._position(dim, pixels[dim]) - coarse[dim]
        return cubic_weights(first, pixels[dim + 2], 0.5**self._level, coarse[dim + 2], like)

    def _position(self, dim: int, pixel: int) -> float:
        """The place of a pixel among coarse pixels."""
        axis = self._middle[dim]
        return position_of(pixel, axis, axis._replace(middle=0), self._level)


class BlurPiece(NamedTuple):
    """A layer in a tile at full resolution."""

    layer_index: int  # number of the layer
    window: TransformWindow  # window of its slices
    slice_indices: range  # the range of the surface's slices that reach the tile
    patch: Patch  # the rectangles where the layer has pixels, and where it shows
    near: bool  # whether the layer is near focus, so that parts see sub-pixel shifts


class ShownLayer(NamedTuple):
    """A layer over a rectangle of a tile; elsewhere it is 0."""

    box: Box  # counted from the corner of the tile
    layer: Tensor  # [M, C + 1, h, w]
    # [m, C, h, w], sub-pixel shifts to add to the colours of left and right; None for no shifts
    moved: Tensor | None = None


class Blur:
    """The blur of all slices of a surface, tile by tile.

    Attributes:
        surface: The surface.
        windows: The window of each of its slices.
        pieces: For each tile its layers at full resolution.
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
        """Plan the surface for all tiles; blur its layers of reduced resolution."""
        self._by_corners, self._stride, self._grid = by_corners, slicing.stride, grid
        each = CORNERS if by_corners else 1  # each part as the corners see it
        self._groups = [slice(each * group.start, each * group.stop) for group in groups]
        whole = [w for w in slicing.windows if not w.level]
        before = max((w.margin for w in whole), default=0)
        beyond = max((n - w.margin for w in whole for n in w.size), default=0)
        every = slice(None, None, slicing.stride)
        layers, self.windows = slicing.layers[every], slicing.windows[every]
        self._layer_of = layers
        self.surface = surface = SlicedSurface(
            samples, radii[every], slicing.coarse[every], layers, grid, before, beyond
        )
        tilted = {slice_index for tile_list in surface.tilted_plan for slice_index in tile_list}
        indices_of: dict[int, list[int]] = {}
        for slice_index in sorted({number for plan in surface.plan for number in plan}):
            indices_of.setdefault(layers[slice_index], []).append(slice_index)
        self.pieces: list[list[BlurPiece]] = [[] for _ in grid.tiles]
        self._reduced: dict[int, Reduced] = {}
        windows = {n: self.windows[slice_indices[0]] for n, slice_indices in indices_of.items()}
        margins = {n: window.margin for n, window in windows.items() if not window.level}
        patches = dict(zip(margins, surface.patches(margins), strict=True)) if margins else {}
        for layer_index, slice_indices in indices_of.items():
            window = windows[layer_index]
            if window.level:
                numbers = {slice_index: slice_index * self._stride for slice_index in slice_indices}
                self._reduced[layer_index] = Reduced(
                    surface, window, numbers, tilted, self._groups, grid.box, middle
                )
                continue
            near = float(window.radii.abs().amin()) < NEAR
            for tile_list, plan, patch in zip(
                self.pieces, surface.plan, patches[layer_index], strict=True
            ):
                reaching = [number for number in plan if layers[number] == layer_index]
                if reaching and patch:
                    indices = range(reaching[0], reaching[-1] + 1)
                    tile_list.append(BlurPiece(layer_index, window, indices, patch, near))

    def tile_layers(self, index: int) -> dict[int, ShownLayer]:
        """The layers of the surface over a tile: sums of blurred slices."""
        tile, shown = self._grid.tiles[index], dict[int, ShownLayer]()
        for layer_index in {self._layer_of[k] for k in self.surface.plan[index]}:
            reduced = self._reduced.get(layer_index)
            if reduced and (part := reduced.upsampled(tile)):
                shown[layer_index] = ShownLayer(part[0].seen_from(tile), self._blended(*part))
        near = any(piece.near for piece in self.pieces[index])
        shifts = self.surface.shifts(index) if near else None
        for piece in self.pieces[index]:
            blurs = self._blurred if piece.window.margin else self._sharp
            box = piece.patch.shown.seen_from(tile)
            layer, moved = self._blended(piece.patch.shown, blurs(piece, index)), None
            if shifts is not None and piece.near:
                # a part gets shifts for the coverage that it sees, no more
                fraction = self.surface.fractions(piece.slice_indices, piece.patch.shown)
                fraction = torch.minimum(fraction, layer[-len(shifts) :, -1:].clamp(min=0))
                moved = box.crop(shifts) * fraction
            shown[piece.layer_index] = ShownLayer(box, layer, moved)
        return shown

    def _blended(self, box: Box, layer: Tensor) -> Tensor:
        """A layer [M, C + 1, h, w] in a box, from those of the corners of the region."""
        return blended(layer, box, self._grid.box) if self._by_corners else layer

    def _blurred(self, piece: BlurPiece, index: int) -> Tensor:
        """A layer where it shows: [M, C + 1, h, w]."""
        surface, window, slice_indices = self.surface, piece.window, piece.slice_indices
        size = window.fitting(piece.patch.minimum)
        box = piece.patch.transformed(size, self._grid.tiles[index], window.size)
        # samples after the end of `lit` would wrap around into the tile
        lit = Box.from_spans(
            *(Span(a.first, b.end) for a, b in zip(box.sides, piece.patch.lit.sides, strict=True))
        )
        pixels = surface.members(slice_indices, lit)
        spectra = torch.fft.rfft2(pixels, s=size).unbind(1)
        tilted = [
            slice_index
            for slice_index in slice_indices
            if slice_index in surface.tilted_plan[index]
        ]
        tilted_slopes = surface.planes(tilted, self._grid.tiles[index].enlarged(window.margin))
        planes = zip(tilted, tilted_slopes, strict=True)
        slopes = {slice_index * self._stride: slope for slice_index, slope in planes}
        leaning = [
            i
            for i, slice_index in enumerate(slice_indices)
            if slopes.get(slice_index * self._stride, 0) is None
        ]
        kernels = window.tilted({k: slope for k, slope in slopes.items() if slope}, size)
        terms: list[tuple[Tensor, Tensor]] = []
        for i, slice_index in enumerate(slice_indices):
            k = slice_index * self._stride
            terms.append((spectra[i], kernels[k] if k in kernels else window.spectrum(k, size)))
        if leaning:
            lean = surface.slopes(lit)[:, None, None]
            pairs = torch.fft.rfft2(lean * pixels[:, leaning], s=size)
            for i, pair in zip(leaning, pairs.unbind(2), strict=True):
                leans = window.spectrum(slice_indices[i] * self._stride, size, leaning=True)
                terms += zip(pair, leans, strict=True)
        wanted = piece.patch.shown.seen_from(box)
        return blurred(terms, self._groups, size, wanted)

    def _sharp(self, piece: BlurPiece, index: int) -> Tensor:
        """A layer whose slices are not blurred, by all parts alike, in any tile."""
        pixels = self.surface.members(piece.slice_indices, piece.patch.shown).sum(1)
        return pixels.expand(self._groups[-1].stop, *pixels.shape)

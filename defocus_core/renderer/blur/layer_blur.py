"""Slices of a surface blurred over a tile, and summed to layers in the Fourier domain."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.blur.field_blend import blended, corner_groups
from defocus_core.renderer.blur.fourier import crop_inverse, sum_of_products
from defocus_core.renderer.blur.kernel_bank import TransformWindow
from defocus_core.renderer.blur.reduced_resolution import Reduced
from defocus_core.renderer.layers.extents import Patch
from defocus_core.renderer.layers.samples import SurfaceSamples
from defocus_core.renderer.layers.sliced_surface import Surface
from defocus_core.renderer.layers.subpixel_shifts import NEAR
from defocus_core.tensors.box import Box
from defocus_core.tensors.pyramid import Axis
from defocus_core.tensors.tiling import Grid


class BlurPiece(NamedTuple):
    """A layer in a tile at full resolution.

    Attributes:
        number: Number of the layer.
        window: Window of its slices.
        rungs: The range of the surface's rungs whose slices reach the tile.
        patch: The rectangles where the layer has pixels, and where it shows.
        near: Whether the layer is near focus, so that parts see sub-pixel shifts.
    """

    number: int
    window: TransformWindow
    rungs: range
    patch: Patch
    near: bool


class ShownLayer(NamedTuple):
    """A layer over a rectangle of a tile; elsewhere it is 0.

    Attributes:
        box: Counted from the corner of the tile.
        layer: [m, C + 1, h, w].
        moved: [m, C, h, w], sub-pixel shifts to add to its colours; None for no shifts.
    """

    box: Box
    layer: Tensor
    moved: Tensor | None


class Sliced(NamedTuple):
    """A surface to be blurred.

    Attributes:
        surface: The surface.
        stride: Whether it uses every slice (1) or every other (2).
        layer_of: For each slice the number of its layer.
        pieces: For each tile its layers at full resolution.
        reduced: Layers at reduced resolution, by number.
    """

    surface: Surface
    stride: int
    layer_of: list[int]
    pieces: list[list[BlurPiece]]
    reduced: dict[int, Reduced]


class Blur:
    """The blur of all slices of a frame, tile by tile."""

    def __init__(
        self,
        windows: list[TransformWindow],
        reaches: list[int],
        grid: Grid,
        groups: list[slice],
        middle: tuple[Axis, Axis],
        *,
        by_corners: bool = False,
    ) -> None:
        """Keep the settings that all surfaces share.

        Args:
            windows: The window of each slice; slices of a layer share one.
            reaches: Reach of each slice in px.
            grid: The tiles, counted from the first sample of a surface.
            groups: Groups of aperture parts; each is computed as if it were alone, to the last bit.
            middle: The middle of the frame, counted from the first sample of a surface.
            by_corners: Whether windows have the pupils of the four corners of the region.
        """
        self._by_corners = by_corners
        self._windows = windows
        self._reaches = reaches
        self._grid = grid
        self._groups = corner_groups(groups) if by_corners else groups
        self._middle = middle

    def sliced(self, samples: SurfaceSamples, stride: int, layer_of: list[int]) -> Sliced:
        """Plan a surface for all tiles; blur its layers of reduced resolution."""
        whole = [w for w in self._windows if not w.halvings]
        before = max((w.margin for w in whole), default=0)
        beyond = max((n - w.margin for w in whole for n in w.size), default=0)
        numbers = layer_of[::stride]
        surface = Surface(samples, self._reaches[::stride], numbers, self._grid, before, beyond)
        tilted = {rung for tile_list in surface.tilted_plan for rung in tile_list}
        rungs_of: dict[int, list[int]] = {}
        for rung in sorted({rung for tile_list in surface.plan for rung in tile_list}):
            rungs_of.setdefault(numbers[rung], []).append(rung)
        pieces: list[list[BlurPiece]] = [[] for _ in self._grid.tiles]
        reduced: dict[int, Reduced] = {}
        windows = {n: self._windows[rungs[0] * stride] for n, rungs in rungs_of.items()}
        margins = {n: window.margin for n, window in windows.items() if not window.halvings}
        patches = dict(zip(margins, surface.patches(margins), strict=True)) if margins else {}
        for number, rungs in rungs_of.items():
            window = windows[number]
            if window.halvings:
                reduced[number] = Reduced(
                    surface,
                    window,
                    {rung: rung * stride for rung in rungs},
                    tilted,
                    self._groups,
                    self._grid.box,
                    self._middle,
                )
                continue
            near = float(window.radii.abs().amin()) < NEAR
            for tile_list, plan, patch in zip(pieces, surface.plan, patches[number], strict=True):
                reaching = [rung for rung in plan if numbers[rung] == number]
                if reaching and patch:
                    tile_list.append(
                        BlurPiece(number, window, range(reaching[0], reaching[-1] + 1), patch, near)
                    )
        return Sliced(surface, stride, layer_of, pieces, reduced)

    def over_tile(self, sliced: Sliced, index: int) -> list[dict[int, ShownLayer]]:
        """The layers of the visible or the hidden surface over a tile: sums of blurred slices.

        Args:
            sliced: The surface.
            index: Number of the tile.

        Returns:
            For each group of m parts its layers by number; the last group has the shifts.
        """
        tile = self._grid.tiles[index]
        shown: list[dict[int, ShownLayer]] = [{} for _ in self._groups]
        for number in {sliced.layer_of[k * sliced.stride] for k in sliced.surface.plan[index]}:
            if number in sliced.reduced and (reduced := sliced.reduced[number].over(tile)):
                box = reduced[0].seen_from(tile)
                for by_layer, layer in zip(shown, self._blended(*reduced), strict=True):
                    by_layer[number] = ShownLayer(box, layer, None)
        near = any(piece.near for piece in sliced.pieces[index])
        shifts = sliced.surface.shifts(index) if near else None
        for piece in sliced.pieces[index]:
            blurred = self._blurred(sliced, piece, index) if piece.window.margin else None
            box = piece.patch.shown.seen_from(tile)
            layers = self._blended(piece.patch.shown, blurred or self._sharp(sliced, piece))
            moved = None
            if shifts is not None and piece.near:
                # a part gets shifts for the coverage that it sees, no more
                share = sliced.surface.shares(piece.rungs, piece.patch.shown)
                share = torch.minimum(share, layers[-1][:, -1:].clamp(min=0))
                moved = box.of(shifts) * share
            for by_layer, layer in zip(shown, layers, strict=True):
                by_layer[piece.number] = ShownLayer(
                    box, layer, moved if by_layer is shown[-1] else None
                )
        return shown

    def _blended(self, box: Box, layers: list[Tensor]) -> list[Tensor]:
        """Layers of groups [m, C + 1, h, w] in a box, from those of the corners of the region."""
        if not self._by_corners:
            return layers
        return [blended(layer, box, self._grid.box) for layer in layers]

    def _blurred(self, sliced: Sliced, piece: BlurPiece, index: int) -> list[Tensor]:
        """A layer where it shows, for each group of m parts: [m, C + 1, h, w]."""
        surface, window, rungs = sliced.surface, piece.window, piece.rungs
        size = window.fitting(piece.patch.least)
        box = piece.patch.transformed(size, self._grid.tiles[index], window.size)
        pixels = surface.members(rungs, box, piece.patch.lit)
        spectra = torch.fft.rfft2(pixels).unbind(1)
        tilted = [rung for rung in rungs if rung in surface.tilted_plan[index]]
        tilted_slopes = surface.planes(tilted, self._grid.tiles[index].around(window.margin))
        planes = zip(tilted, tilted_slopes, strict=True)
        slopes = {rung * sliced.stride: slope for rung, slope in planes}
        leaning = [i for i, rung in enumerate(rungs) if slopes.get(rung * sliced.stride, 0) is None]
        kernels = window.tilted({k: slope for k, slope in slopes.items() if slope}, size)
        terms: list[tuple[Tensor, Tensor]] = []
        for i, rung in enumerate(rungs):
            k = rung * sliced.stride
            terms.append((spectra[i], kernels[k] if k in kernels else window.spectrum(k, size)))
        if leaning:
            lean = surface.slopes(box)[:, None, None]
            pairs = torch.fft.rfft2(lean * pixels[:, leaning])
            for i, pair in zip(leaning, pairs.unbind(2), strict=True):
                terms += zip(pair, window.leaning(rungs[i] * sliced.stride, size), strict=True)
        wanted = piece.patch.shown.seen_from(box)
        return [crop_inverse(sum_of_products(terms, group), size, wanted) for group in self._groups]

    def _sharp(self, sliced: Sliced, piece: BlurPiece) -> list[Tensor]:
        """A layer whose slices are not blurred, for each group of parts."""
        box = piece.patch.shown
        pixels = sliced.surface.members(piece.rungs, box, box).sum(1)
        return [pixels.expand(g.stop - g.start, -1, -1, -1) for g in self._groups]

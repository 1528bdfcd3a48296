"""Slices of a surface blurred over a tile, and summed to layers while still transformed."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.convolution import crop_inverse
from defocus_core.surface import Margins, Samples, Surface
from defocus_core.tiling import Grid
from defocus_core.windows import Window


class Sliced(NamedTuple):
    """A surface, and whether it uses every slice (stride 1) or every other (2)."""

    surface: Surface
    stride: int


class Blur:
    """The blur of all slices of a frame, tile by tile."""

    def __init__(self, windows: list[Window], reaches: list[int], grid: Grid, parts: int) -> None:
        """Keep what all surfaces share.

        Args:
            windows: Of the slices.
            reaches: Px that each spreads.
            grid: The tiles.
            parts: Of the aperture.
        """
        self._windows = windows
        self._reaches = reaches
        self._grid = grid
        self._parts = parts

    def sliced(self, samples: Samples, stride: int) -> Sliced:
        """A layer of the scene, prepared for its tiles."""
        H, W = samples.places.shape
        before = max(w.margin for w in self._windows)
        rows = len(self._grid.tiles) // self._grid.columns
        below, beside = (
            max(w.size[i] - w.margin for w in self._windows) + (n - 1) * self._grid.side - frame
            for i, (n, frame) in enumerate(((rows, H), (self._grid.columns, W)))
        )
        margins = Margins(before, max(beside, 0), max(below, 0))
        return Sliced(Surface(samples, self._reaches[::stride], self._grid, margins), stride)

    def over_tile(self, sliced: Sliced, index: int, layer_of: list[int]) -> dict[int, Tensor]:
        """The layers of the visible or the hidden surface over a tile: sums of blurred slices.

        Args:
            sliced: The surface.
            index: Of the tile.
            layer_of: For each slice the number of its layer. The slices of a layer share a window.

        Returns:
            [M, C + 1, h, w] each, by number.
        """
        surface, stride = sliced
        layers: dict[int, Tensor] = {}
        by_window: dict[int, list[int]] = {}
        for rung in surface.plan[index]:
            by_window.setdefault(id(self._windows[rung * stride]), []).append(rung)
        for some in by_window.values():
            window = self._windows[some[0] * stride]
            slices = [rung * stride for rung in some]
            numbers = [layer_of[k] for k in slices]
            pixels = surface.members(index, window.margin, window.size, some)
            if window.margin == 0:
                layers.update(self._sharp(pixels, numbers, index))
                continue
            tilted = [i for i, rung in enumerate(some) if rung in surface.tilted_plan[index]]
            totals: dict[int, Tensor] = {}
            for k, number, spectrum in zip(slices, numbers, torch.fft.rfft2(pixels), strict=True):
                _add(totals, number, spectrum, window.spectra[k])
            if tilted:
                lean = surface.slopes(index, window.margin, window.size)[:, None]
                spectra = torch.fft.rfft2(lean * pixels[tilted][:, None])
                for i, pair in zip(tilted, spectra, strict=True):
                    for spectrum, kernel in zip(pair, window.leaning[slices[i]], strict=True):
                        _add(totals, numbers[i], spectrum, kernel)
            box = self._grid.tiles[index]
            wanted = (window.margin, window.margin, box.height, box.width)
            blurred = crop_inverse(torch.stack(list(totals.values())), window.size, wanted)
            layers.update(zip(totals, blurred.unbind(), strict=True))
        return layers

    def _sharp(self, pixels: Tensor, numbers: list[int], index: int) -> dict[int, Tensor]:
        """Layers of slices [k, C + 1, h, w] that are not blurred."""
        box = self._grid.tiles[index]
        layers: dict[int, Tensor] = {}
        for number, sharp in zip(numbers, pixels[..., : box.height, : box.width], strict=True):
            others = layers.get(number)
            sharp = sharp.expand(self._parts, -1, -1, -1)
            layers[number] = sharp if others is None else others + sharp
        return layers


def _add(totals: dict[int, Tensor], number: int, spectrum: Tensor, kernel: Tensor) -> None:
    """Add a slice's spectrum [C + 1, h, w] times a kernel's [M, 1, h, w] to a layer's."""
    if number in totals:
        totals[number] = totals[number].addcmul_(spectrum, kernel)
    else:
        totals[number] = spectrum * kernel

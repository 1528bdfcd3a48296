"""Slices of a surface blurred over a tile, and summed to layers while still transformed."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.convolution import crop_inverse
from defocus_core.halving import Axis
from defocus_core.reduced import Reduced
from defocus_core.surface import Samples, Surface
from defocus_core.tiling import Grid
from defocus_core.windows import Window


class Sliced(NamedTuple):
    """A surface to be blurred.

    Attributes:
        surface: It is.
        stride: Whether it uses every slice (1) or every other (2).
        layer_of: For each slice the number of its layer. The slices of a layer share a window.
        reduced: What is blurred at reduced resolution.
    """

    surface: Surface
    stride: int
    layer_of: list[int]
    reduced: list[Reduced]


class Blur:
    """The blur of all slices of a frame, tile by tile."""

    def __init__(
        self,
        windows: list[Window],
        reaches: list[int],
        grid: Grid,
        groups: list[slice],
        middle: tuple[Axis, Axis],
    ) -> None:
        """Keep what all surfaces share.

        Args:
            windows: Of the slices.
            reaches: Px that each spreads.
            grid: The tiles, counted from the first sample of a surface.
            groups: Of the parts of the aperture: each is computed as if it were alone, to the
                last bit.
            middle: Of the frame, counted from the first sample of a surface.
        """
        self._windows = windows
        self._reaches = reaches
        self._grid = grid
        self._groups = groups
        self._middle = middle

    def sliced(self, samples: Samples, stride: int, layer_of: list[int]) -> Sliced:
        """A layer of the scene, prepared for its tiles."""
        whole = [w for w in self._windows if not w.halvings]
        before = max((w.margin for w in whole), default=0)
        beyond = max((n - w.margin for w in whole for n in w.size), default=0)
        surface = Surface(samples, self._reaches[::stride], self._grid, before, beyond)
        present, tilted = (
            sorted({rung for some in plan for rung in some})
            for plan in (surface.plan, surface.tilted_plan)
        )
        reduced = [
            Reduced(
                surface,
                window,
                {rung: rung * stride for rung in rungs},
                {rung: layer_of[rung * stride] for rung in rungs},
                set(tilted),
                self._groups,
                self._grid.box,
                self._middle,
            )
            for window, rungs in self._by_window(present, stride)
            if window.halvings
        ]
        return Sliced(surface, stride, layer_of, reduced)

    def _by_window(self, rungs: list[int], stride: int) -> list[tuple[Window, list[int]]]:
        """The windows of some rungs of a surface."""
        found: dict[int, list[int]] = {}
        for rung in rungs:
            found.setdefault(id(self._windows[rung * stride]), []).append(rung)
        return [(self._windows[some[0] * stride], some) for some in found.values()]

    def over_tile(self, sliced: Sliced, index: int) -> list[dict[int, Tensor]]:
        """The layers of the visible or the hidden surface over a tile: sums of blurred slices.

        Args:
            sliced: The surface.
            index: Of the tile.

        Returns:
            For each group of m parts the layers by number, [m, C + 1, h, w] each.
        """
        surface, stride, layer_of, reduced = sliced
        layers: list[dict[int, Tensor]] = [{} for _ in self._groups]
        present = {layer_of[rung * stride] for rung in surface.plan[index]}
        for some in reduced:
            for found, more in zip(
                layers, some.over(self._grid.tiles[index], present), strict=True
            ):
                found.update(more)
        for window, rungs in self._by_window(surface.plan[index], stride):
            if window.halvings:
                continue
            slices = [rung * stride for rung in rungs]
            numbers = [layer_of[k] for k in slices]
            pixels = surface.members(index, window.margin, window.size, rungs)
            if window.margin == 0:
                for group, found in zip(self._groups, layers, strict=True):
                    found.update(self._sharp(pixels, numbers, index, group.stop - group.start))
                continue
            kernels = [window.spectrum(k, window.size) for k in slices]
            tilted = [i for i, rung in enumerate(rungs) if rung in surface.tilted_plan[index]]
            box = self._grid.tiles[index].around(window.margin)
            for i in tilted.copy():
                slope = surface.plane(rungs[i], box)
                if slope:
                    kernels[i] = window.tilted(slices[i], window.size, slope)
                    tilted.remove(i)
            terms = list(zip(numbers, torch.fft.rfft2(pixels), kernels, strict=True))
            if tilted:
                lean = surface.slopes(index, window.margin, window.size)[:, None]
                spectra = torch.fft.rfft2(lean * pixels[tilted][:, None])
                for i, pair in zip(tilted, spectra, strict=True):
                    leaning = window.leaning(slices[i], window.size)
                    terms += [(numbers[i], *term) for term in zip(pair, leaning, strict=True)]
            for group, found in zip(self._groups, layers, strict=True):
                found.update(self._transformed_back(terms, group, window, index))
        return layers

    def _transformed_back(
        self,
        terms: list[tuple[int, Tensor, Tensor]],
        group: slice,
        window: Window,
        index: int,
    ) -> dict[int, Tensor]:
        """Layers of the sums of spectra times kernels, by number."""
        totals: dict[int, Tensor] = {}
        for number, spectrum, kernel in terms:
            if number in totals:
                totals[number] = totals[number].addcmul_(spectrum, kernel[group])
            else:
                totals[number] = spectrum * kernel[group]
        box = self._grid.tiles[index]
        wanted = (window.margin, window.margin, box.height, box.width)
        blurred = crop_inverse(torch.stack(list(totals.values())), window.size, wanted)
        return dict(zip(totals, blurred.unbind(), strict=True))

    def _sharp(
        self, pixels: Tensor, numbers: list[int], index: int, parts: int
    ) -> dict[int, Tensor]:
        """Layers of slices [k, C + 1, h, w] that are not blurred."""
        box = self._grid.tiles[index]
        layers: dict[int, Tensor] = {}
        for number, sharp in zip(numbers, pixels[..., : box.height, : box.width], strict=True):
            others = layers.get(number)
            sharp = sharp.expand(parts, -1, -1, -1)
            layers[number] = sharp if others is None else others + sharp
        return layers

"""The kernel bank: Fourier windows of slices, and the spectra of their kernels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.blur.fourier import kernel_spectra, kernels, reach, transform_length
from defocus_core.optics.aperture import Aperture, Part

# Sizes of a transform: quarters of the largest.
_SIZES = 4
# Slopes of a slice whose tilted kernels are kept.
_PLANES = 4


class Spread(NamedTuple):
    """How a slice is blurred.

    Attributes:
        halvings: How many times resolution is halved.
        cells: Pixels of that resolution that its kernel spreads.
        px: Pixels of the picture that light spreads at most.
    """

    halvings: int
    cells: int
    px: int


@dataclass(frozen=True)
class Window:
    """The transform that the slices of a layer share.

    Attributes:
        margin: Px around a tile that its slices reach at most; 0 if they are not blurred at all.
        size: (height, width) of the greatest transform that there is.
        halvings: How many times resolution is halved; margin and size are in px of the result.
        slices: Their numbers.
        radii: Of these in px, [k], float64.
        aperture: The pupil.
        parts: M parts of it.
        like: Of the dtype and device of the spectra.
        kernels: Of those that were asked for, from `kernels`, by number.
        spectra: Of these, by number, size, and whether they lean.
        planes: Of those tilted for planes, by number, size, and slope: the last few.
    """

    margin: int
    size: tuple[int, int]
    halvings: int
    slices: list[int]
    radii: Tensor
    aperture: Aperture
    parts: list[Part]
    like: Tensor
    kernels: dict[int, Tensor]
    spectra: dict[tuple[int, tuple[int, int], bool], Tensor]
    planes: dict[tuple[int, tuple[int, int]], dict[tuple[float, float], Tensor]]

    def spectrum(self, number: int, size: tuple[int, int]) -> Tensor:
        """Of the kernel of a slice: [M, 1, height, width // 2 + 1]."""
        return self._cached(number, size, leaning=False)

    def leaning(self, number: int, size: tuple[int, int]) -> Tensor:
        """The same times u.x and u.y, for tilted surfaces: [2, M, 1, ...]."""
        return self._cached(number, size, leaning=True)

    def tilted(self, number: int, size: tuple[int, int], slope: tuple[float, float]) -> Tensor:
        """The spectrum of a slice for a plane of some slope, x and y: [M, 1, ...]."""
        held = self.planes.setdefault((number, size), {})
        found = held.get(slope)
        if found is None:
            kernel, x, y = self._kernels(number, leaning=True)
            kernel = kernel.add(x, alpha=slope[0]).add_(y, alpha=slope[1])
            found = kernel_spectra(kernel, size).unsqueeze(-3)
            if len(held) >= _PLANES:
                held.clear()
            held[slope] = found
        return found

    def fitting(self, least: Sequence[int]) -> tuple[int, int]:
        """One of few sizes, of at least so many rows and columns, that are not more than needed."""
        height, width = (
            min(
                transform_length(-(-n * share // _SIZES))
                for share in range(1, _SIZES + 1)
                if transform_length(-(-n * share // _SIZES)) >= wanted
            )
            for n, wanted in zip(self.size, least, strict=True)
        )
        return height, width

    def _cached(self, number: int, size: tuple[int, int], *, leaning: bool) -> Tensor:
        key = (number, size, leaning)
        if key not in self.spectra:
            some = self._kernels(number, leaning=leaning)
            kernel = some[1:] if leaning else some[0]
            self.spectra[key] = kernel_spectra(kernel, size).unsqueeze(-3)
        return self.spectra[key]

    def _kernels(self, number: int, *, leaning: bool) -> Tensor:
        """One slice alone: what is computed together could decide about last digits."""
        found = self.kernels.get(number)
        if found is None or (leaning and len(found) == 1):
            radius = self.radii[self.slices.index(number), None] / (1 << self.halvings)
            some = kernels(radius, self.margin, self.aperture, self.parts, leaning=leaning)
            found = self.kernels[number] = some[0].to(self.like.real)
        return found


def windows(
    radii: tuple[float, ...],
    spreads: list[Spread],
    layers: list[int],
    side: tuple[int, int],
    region: tuple[int, int],
    aperture: Aperture,
    parts: list[Part],
    dtype: torch.dtype,
    device: torch.device,
) -> list[Window]:
    """The window of each slice, one for each layer.

    Args:
        radii: Of the slices in px.
        spreads: How they are blurred, alike for all of a layer.
        layers: The number of the layer of each.
        side: (height, width) of a tile in px: what is blurred at once at full resolution.
        region: (height, width) of a region in px: what is at reduced resolution.
        aperture: The pupil.
        parts: M parts of it.
        dtype: Of the pictures.
        device: Of the pictures.
    """
    sharing: dict[int, list[int]] = {}
    for k, number in enumerate(layers):
        sharing.setdefault(number, []).append(k)
    precision = torch.complex128 if dtype == torch.float64 else torch.complex64
    like = torch.empty(0, dtype=precision, device=device)
    found: dict[int, Window] = {}
    for slices in sharing.values():
        extent, halvings = max(spreads[k].cells for k in slices), spreads[slices[0]].halvings
        extents = [(n >> halvings) + 5 for n in region] if halvings else side
        rows, columns = (transform_length(n + 2 * extent) for n in extents)
        some = torch.tensor([radii[k] for k in slices], dtype=torch.float64)
        window = Window(
            extent, (rows, columns), halvings, slices, some, aperture, parts, like, {}, {}, {}
        )
        found.update(dict.fromkeys(slices, window))
    return [found[k] for k in range(len(radii))]


def alike(
    layers: list[int], sides: list[int], spreads: list[Spread], side: tuple[int, int]
) -> list[int]:
    """Neighbouring layers whose transforms are as large made one, if their slices add up.

    Args:
        layers: The number of the layer of each slice.
        sides: Those of different sides do not.
        spreads: How they are blurred, alike for all of a layer.
        side: (height, width) of a tile in px.
    """
    widest: dict[int, int] = {}
    for number, spread in zip(layers, spreads, strict=True):
        widest[number] = max(widest.get(number, 0), spread.cells)
    names = [
        (
            where,
            spread.halvings,
            widest[number] == 0,
            *(transform_length((n >> spread.halvings) + 2 * widest[number]) for n in side),
        )
        for number, where, spread in zip(layers, sides, spreads, strict=True)
    ]
    other = [name != before for before, name in pairwise(names)]
    return list(accumulate(other, initial=0))


def spreads_of(
    radii: tuple[float, ...], layers: list[int], full_resolution: float, limit: int
) -> list[Spread]:
    """How slices are blurred: all of a layer at one resolution.

    Args:
        radii: Of the slices in px.
        layers: The number of the layer of each.
        full_resolution: Radius in px from which on resolution is halved, and halved again at
            each doubling.
        limit: Px that a slice spreads at most: as far as there is anything.
    """
    least: dict[int, float] = {}
    for radius, number in zip(radii, layers, strict=True):
        least[number] = min(least.get(number, math.inf), abs(radius))
    found = []
    for radius, number in zip(radii, layers, strict=True):
        ratio = min(least[number], limit) / full_resolution
        halvings = math.floor(math.log2(ratio)) + 1 if ratio >= 1 else 0
        step = 1 << halvings
        cells = reach(radius / step, -(-limit // step))
        # a pixel has shares in cells beside it, and is read from two cells on each side
        px = min(step * (cells + 3) - 1, limit) if halvings else cells
        found.append(Spread(halvings, cells, px))
    return found

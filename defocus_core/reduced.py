"""Slices of large radii blurred at reduced resolution, over a whole region at once.

A disc many px wide makes pictures as smooth as its rim is long. Its slices are averaged to 1/2,
1/4, ... of the resolution after each pixel has got its share in them, blurred there, and read by
cubics in between (Keys 1981). Like everything that is halved, cells stand symmetrically about the
middle of the frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.convolution import crop_inverse
from defocus_core.halving import Axis, place_of
from defocus_core.resampling import cubic_shares
from defocus_core.surface import Surface
from defocus_core.tiling import Box
from defocus_core.windows import Window


class Span(NamedTuple):
    """Cells along one axis, counted from the one at or after the middle of the frame."""

    first: int
    end: int

    def within(self, other: Span) -> Span:
        """Those that are in another span, too."""
        return Span(max(self.first, other.first), min(self.end, other.end))

    def grown(self, by: int) -> Span:
        """Longer by some cells at both ends."""
        return Span(self.first - by, self.end + by)


class _Layer(NamedTuple):
    """A layer where it is not 0.

    Attributes:
        cells: Those along both axes.
        groups: For each group of m parts, [m, C + 1, h, w].
    """

    cells: tuple[Span, Span]
    groups: list[Tensor]


class Reduced:
    """The layers of a surface in one window of reduced resolution."""

    def __init__(
        self,
        surface: Surface,
        window: Window,
        slices: dict[int, int],
        numbers: dict[int, int],
        tilted: set[int],
        groups: list[slice],
        core: Box,
        middle: tuple[Axis, Axis],
    ) -> None:
        """Blur the slices of a window.

        Args:
            surface: That they are of.
            window: That they share.
            slices: For each rung of the surface that reaches the core the number of its slice.
            numbers: For each rung that of its layer.
            tilted: The rungs that have slopes.
            groups: Of the parts of the aperture.
            core: Where the layers are wanted, counted from the first sample of the surface.
            middle: Of the frame, counted likewise.
        """
        self._groups = len(groups)
        self._middle, self._halvings = middle, window.halvings
        step = 1 << window.halvings
        around, reach = self._read_by(core), (window.margin + 3) * step
        self._layers: dict[int, _Layer] = {}
        self._shares: dict[tuple[int, int, int, Span], Tensor] = {}
        for number in dict.fromkeys(numbers.values()):
            rungs = [rung for rung, other in numbers.items() if other == number]
            bounds = surface.bounds(rungs)
            if not (bounds.height and bounds.width):
                continue
            lit = [
                span.within(wanted.grown(window.margin))
                for span, wanted in zip(self._spans(bounds), around, strict=True)
            ]
            seen = [
                span.grown(window.margin).within(wanted)
                for span, wanted in zip(lit, around, strict=True)
            ]
            if any(span.end <= span.first for span in (*lit, *seen)):
                continue
            first = [min(one.first, other.first) for one, other in zip(lit, seen, strict=True)]
            size = window.fitting(
                [
                    max(there.end - here.first, here.end - there.first) + window.margin
                    for here, there in zip(lit, seen, strict=True)
                ]
            )
            cells = Box(first[0], first[1], *size)
            terms: list[tuple[Tensor, Tensor]] = []
            for rung in rungs:
                slope = surface.plane(rung, core.around(reach)) if rung in tilted else None
                lean = rung in tilted and not slope
                plain, *leaning = torch.fft.rfft2(
                    surface.averaged(rung, window.halvings, cells, middle, tilted=lean)
                )
                kernel = window.spectrum(slices[rung], size)
                if slope:
                    kernel = window.tilted(slices[rung], size, slope)
                terms.append((plain, kernel))
                kernels = window.leaning(slices[rung], size) if lean else ()
                terms += zip(leaning, kernels, strict=True)
            crop = (
                seen[0].first - first[0],
                seen[1].first - first[1],
                seen[0].end - seen[0].first,
                seen[1].end - seen[1].first,
            )
            found = [crop_inverse(_sum(terms, group), size, crop) for group in groups]
            self._layers[number] = _Layer((seen[0], seen[1]), found)

    def over(self, box: Box, numbers: set[int]) -> list[dict[int, Tensor]]:
        """Some layers at full resolution, counted as the core: for each group [m, C + 1, h, w].

        Those that are 0 all over are left out.
        """
        result: list[dict[int, Tensor]] = [{} for _ in range(self._groups)]
        spans = self._read_by(box)
        for number in numbers & self._layers.keys():
            cells, groups = self._layers[number]
            down, across = (span.within(wanted) for span, wanted in zip(cells, spans, strict=True))
            if down.end <= down.first or across.end <= across.first:
                continue
            rows, columns = (
                self._between(d, box[d], box[d + 2], cells, groups[0])
                for d, cells in enumerate((down, across))
            )
            top, left = cells[0].first, cells[1].first
            for group, found in zip(groups, result, strict=True):
                some = group[
                    ..., down.first - top : down.end - top, across.first - left : across.end - left
                ]
                found[number] = rows @ some @ columns.mT
        return result

    def _spans(self, box: Box) -> tuple[Span, Span]:
        """The cells between which pixels lie; they have shares in no others."""
        down, across = (
            Span(
                math.floor(self._place(d, box[d])),
                math.floor(self._place(d, box[d] + box[d + 2] - 1)) + 2,
            )
            for d in (0, 1)
        )
        return down, across

    def _read_by(self, box: Box) -> tuple[Span, Span]:
        """The cells from which pixels are read: two on each side."""
        down, across = self._spans(box)
        return down.grown(1), across.grown(1)

    def _between(self, dim: int, start: int, length: int, cells: Span, like: Tensor) -> Tensor:
        """The shares [pixels, cells] of cells in pixels; tiles in a row have the same."""
        key = (dim, start, length, cells)
        if key not in self._shares:
            first = self._place(dim, start) - cells.first
            self._shares[key] = cubic_shares(
                first, length, cells.end - cells.first, 0.5**self._halvings, like
            )
        return self._shares[key]

    def _place(self, dim: int, pixel: int) -> float:
        """Where a pixel lies among cells."""
        axis = self._middle[dim]
        return place_of(pixel, axis, axis._replace(middle=0), self._halvings)


def _sum(terms: list[tuple[Tensor, Tensor]], group: slice) -> Tensor:
    """Of spectra times kernels of some parts."""
    (spectrum, kernel), *others = terms
    total = spectrum * kernel[group]
    for spectrum, kernel in others:
        total = total.addcmul_(spectrum, kernel[group])
    return total

"""Discs of highlights: drawn by their rims, and clipped by nearer surfaces.

Along a row of pixels a kernel changes only at its rim. So only the changes at the rims are added to
a canvas, and the canvas is summed along rows at the end: the cost of a disc grows with its rim, not
with its area. Sums are in double precision, so that hardly any rounding error is left beside a
bright disc.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.parts import Part
from defocus_core.optics.pupil_field import View
from defocus_core.renderer.blur.fourier import reach
from defocus_core.renderer.compositing.disc_occlusion import Obstruction, Squares
from defocus_core.renderer.compositing.highlights import Highlights
from defocus_core.renderer.compositing.occluders import Occluder
from defocus_core.renderer.layers.slice_radii import slice_position
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent

# Samples drawn at once: bounds memory.
_SAMPLES = 1 << 18
# Greatest ratio of the widths of kernels that are sampled together.
_AS_WIDE = 2
# Radius in px of the first slice out of focus up to which discs are blurred as by slices.
_NEAR_FOCUS = 1.0


class _Alike(NamedTuple):
    """Highlights that are drawn together."""

    highlights: Highlights
    radii: Tensor  # [U] px, the different radii of their kernels
    which: Tensor  # [n] the index in `radii` of each highlight, ascending
    weights: Tensor  # [U] of the kernel; the rest of the light stays in its pixel
    extent: int  # greatest distance in px from a highlight to a pixel of its disc
    barrel: View | None = None  # the pupil, as each radius sees it

    def between(self, start: int, end: int) -> _Alike:
        """The highlights from `start` to before `end`."""
        highlights = Highlights(*(values[start:end] for values in self.highlights))
        return self._replace(highlights=highlights, which=self.which[start:end])

    def kernels(self, aperture: Aperture, part: Part) -> Tensor:
        """The share of their light through a part of the pupil on each pixel: [U, S, S]."""
        kernels = aperture.kernel(self.radii, 2 * self.extent + 1, part, self.barrel)
        if self.extent > _AS_WIDE * math.ceil(_NEAR_FOCUS):
            return kernels
        weights = self.weights[:, None, None]
        return kernels * weights + pad(1 - weights, [self.extent] * 4)


def draw(
    highlights: Highlights,
    occluders: Sequence[Occluder],
    radii: tuple[float, ...],
    aperture: Aperture,
    parts: list[Part],
    box: Box,
    barrel: View | None = None,
) -> Tensor:
    """The discs of all highlights as the parts of the aperture see them: [M, C, height, width]."""
    maximum = max(*occluders[0].positions.shape, box.top + box.height, box.left + box.width)
    canvas = _Canvas(len(parts), highlights.light, box)
    obstruction = Obstruction(occluders, radii)
    for alike in _alike(highlights, radii, maximum, box, barrel):
        squares = Squares.of(alike.extent)
        rims, cut = [], []
        for part in parts:
            kernels = alike.kernels(aperture, part)
            rims.append(_DiscRim(kernels))
            cut.append(squares.cut(kernels))
        lit = torch.stack([(x != 0).any(-1).any(-1) for x in cut])  # [M, U, across, across]
        wanted = lit.any(0)
        step = max(1, _SAMPLES // max(rim.row.shape[1] for rim in rims))
        for start in range(0, len(alike.which), step):
            chunk = alike.between(start, start + step)
            for m, rim in enumerate(rims):
                canvas.add_rims(m, rim, chunk)
            at, r = chunk.highlights.at, chunk.highlights.signed_radius
            for occluded in obstruction.occluded(at, r, squares, wanted[chunk.which]):
                which = chunk.which[occluded.light]
                for m, kernels in enumerate(cut):
                    index = torch.nonzero(lit[m][which, occluded.row, occluded.column])[:, 0]
                    light, row, column, fraction = (x.index_select(0, index) for x in occluded)
                    values = kernels[which[index], row, column] * fraction
                    corner = at[light] + squares.corners(row, column)
                    canvas.subtract(m, corner, values, chunk.highlights.light[light])
    return canvas.summed(highlights.light.dtype)


def _alike(
    highlights: Highlights,
    slice_radii: tuple[float, ...],
    maximum: int,
    box: Box,
    barrel: View | None,
) -> Iterator[_Alike]:
    """The highlights whose discs, up to `maximum` px wide, reach a box: in groups, widest first."""
    everything, spreads = _widest_first(highlights, slice_radii, maximum, box, barrel)
    counts = torch.bincount(everything.which, minlength=len(spreads))
    limits = [0, *counts.cumsum(0).tolist()]  # where the highlights of each radius begin and end
    first = 0
    while first < len(spreads):
        extent = spreads[first]
        count = max(1, _SAMPLES // (2 * extent + 1) ** 2)
        end = first + sum(_AS_WIDE * spread >= extent for spread in spreads[first : first + count])
        chosen = everything.between(limits[first], limits[end])
        if len(chosen.which):
            yield _Alike(
                chosen.highlights,
                everything.radii[first:end],
                chosen.which - first,
                everything.weights[first:end],
                extent,
                everything.barrel and everything.barrel.of(slice(first, end)),
            )
        first = end


def _widest_first(
    highlights: Highlights,
    slice_radii: tuple[float, ...],
    maximum: int,
    box: Box,
    barrel: View | None,
) -> tuple[_Alike, list[int]]:
    """All highlights whose discs reach a box, and the extent [U] in px for each radius."""
    radii, at = highlights.signed_radius, highlights.at
    which = torch.arange(len(radii), device=radii.device)
    if not radii.requires_grad and barrel is None:  # many highlights are equally far away
        radii, which = torch.unique(radii, return_inverse=True)
    radii, weights = _as_by_slices(radii, slice_radii)
    spread = torch.tensor([reach(r, maximum) for r in radii.tolist()], device=radii.device)
    wide = spread.argsort(descending=True, stable=True)
    radii, spread, which = radii[wide], spread[wide], wide.argsort()[which]
    corner = sent([box.top, box.left], at)
    last = corner + sent([box.height - 1, box.width - 1], at)
    away = torch.maximum(corner - at, at - last).amax(1)
    order = which.argsort(stable=True)
    order = order[(away <= spread[which])[order]]
    reaching = Highlights(*(values[order] for values in highlights))
    barrel = barrel and barrel.of(wide)
    everything = _Alike(reaching, radii, which[order], weights[wide], maximum, barrel)
    return everything, spread.tolist()


def _as_by_slices(radius: Tensor, slice_radii: tuple[float, ...]) -> tuple[Tensor, Tensor]:
    """The radii of kernels of discs of radii [U] px, and their weights; the rest is a point.

    Pixels next to focus are the mean of a point and of the first slice out of focus. A light among
    them has the same blur: a point of it, with their light on it, exceeded the brightest pixel.
    """
    weight = torch.ones_like(radius)
    if 0.0 not in slice_radii:
        return radius, weight
    focus = slice_radii.index(0.0)
    below, above = slice_radii[max(focus - 1, 0)], slice_radii[min(focus + 1, len(slice_radii) - 1)]
    outer = torch.where(radius < 0, below, above).to(radius)
    apart = (slice_position(radius, slice_radii) - focus).abs()
    between = (apart > 0) & (apart < 1) & (outer.abs() <= _NEAR_FOCUS)
    return torch.where(between, outer, radius), torch.where(between, apart, weight)


class _DiscRim:
    """Changes of U kernels along their rows, k for each kernel, padded with changes of 0.

    Attributes:
        row: [U, k] row of each change.
        column: [U, k] column of each change.
        change: [U, k] difference to the pixel before.
    """

    def __init__(self, kernels: Tensor) -> None:
        """Find the changes in kernels [U, S, S]."""
        changes = pad(kernels, (1, 1)).double().diff(dim=-1)  # [U, S, S + 1]
        which, row, column = torch.nonzero(changes.detach(), as_tuple=True)
        counts = torch.bincount(which, minlength=len(kernels))
        number = torch.arange(len(which), device=which.device)
        slot = (which, number - (counts.cumsum(0) - counts)[which])
        empty = changes.new_zeros(len(kernels), max(1, int(counts.max())))
        self.row, self.column = (
            torch.zeros_like(empty, dtype=torch.long).index_put(slot, at) for at in (row, column)
        )
        self.change = empty.index_put(slot, changes[which, row, column])


class _Canvas:
    """Changes along the rows of a picture; their sums along rows are the picture."""

    def __init__(self, parts: int, colors: Tensor, box: Box) -> None:
        """Begin without changes.

        `colors`: [n, C] of the highlights.
        """
        self._box = box
        # one more row and column take changes beyond the box; one tensor for each channel of each
        # part, for a gradient through a part of a tensor copies all of it
        self._size = (box.height + 1, box.width + 1)
        self._changes = [
            [colors.new_zeros(math.prod(self._size), dtype=torch.float64) for _ in colors[0]]
            for _ in range(parts)
        ]

    def add_rims(self, part: int, rim: _DiscRim, alike: _Alike) -> None:
        """Add discs by their rims."""
        at, colors = (values[..., None] for values in alike.highlights[:2])
        rows, columns, changes = (x[alike.which] for x in (rim.row, rim.column, rim.change))
        self._add(
            part, rows + at[:, 0] - alike.extent, columns + at[:, 1] - alike.extent, changes, colors
        )

    def subtract(self, part: int, corner: Tensor, values: Tensor, colors: Tensor) -> None:
        """Subtract occluded squares of discs.

        `corner`: [n, 2] row and column of the first pixel; `values`: [n, side, side]; `colors`: [n,
        C].
        """
        changes = pad(values, (1, 1)).double().diff(dim=-1)
        rows, columns = (torch.arange(n, device=corner.device) for n in changes.shape[1:])
        rows, columns = corner[:, :1, None] + rows[:, None], corner[:, 1:, None] + columns
        self._add(part, rows, columns, changes, -colors[..., None, None])

    def _add(
        self, part: int, rows: Tensor, columns: Tensor, changes: Tensor, colors: Tensor
    ) -> None:
        """Add changes [n, ...] times colours [n, C, 1, ...] at rows and columns of the frame."""
        height, width = self._size
        rows, columns = rows - self._box.top, columns - self._box.left
        rows = torch.where(rows < 0, height - 1, rows).clamp(max=height - 1)
        # a disc that begins before the box begins in its first column
        columns = columns.clamp(0, width - 1)
        spot = (rows * width + columns).flatten()
        for c, canvas in enumerate(self._changes[part]):
            canvas.index_add_(0, spot, (changes * colors[:, c]).flatten())

    def summed(self, dtype: torch.dtype) -> Tensor:
        """The pictures [M, C, height, width]; the canvas is freed part by part."""
        channels, parts = [], len(self._changes)
        while self._changes:
            for channel in self._changes.pop(0):
                sums = channel.view(self._size).cumsum(-1)
                channels.append(sums[:-1, :-1].to(dtype))
        pictures = torch.stack(channels)
        return pictures.view(parts, -1, *pictures.shape[1:])

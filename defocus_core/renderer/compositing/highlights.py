"""Highlights: the few brightest pixels, drawn as discs by their rims, clipped by nearer surfaces.

Almost all energy of a scene with lights is in few pixels. Layers would fade the discs that a wire
before them clips, and a transform would spread rounding noise of 1e-7 of their brightness over
everything. So the light of such a pixel is taken out of the layers and drawn as a disc of its own.

Along a row of pixels a kernel changes only at its rim. So only the changes at the rims are added to
a canvas, and the canvas is summed along rows at the end: the cost of a disc grows with its rim, not
with its area. Sums are in double precision, so that hardly any rounding error is left beside a
bright disc.

Disc pixel x of a light q is seen through lens point u = (x - q) / r_q, and a nearer surface of
radius r_k in front of it at q + u (r_q - r_k). Beside depth edges the coverage there is
interpolated between pixels: a shadow has a rim as smooth as its surface. Squares of a disc that no
nearer slice is in front of are skipped. A small disc has too few pixels to sample u: it is dimmed
evenly, by the mean over the lens.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.cat_eye import Rim
from defocus_core.optics.parts import Part
from defocus_core.renderer.blur.kernel_bank import reach
from defocus_core.renderer.layers.layer import SampleLayer
from defocus_core.renderer.layers.slice_radii import slice_position
from defocus_core.renderer.layers.sliced_surface import blocks_of
from defocus_core.tensors.box import BLOCK, Box
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.neighbourhoods import exceeding, extreme_around, positions_of

# A highlight is brighter than this many times the brightest of all but one pixel in 200.
BRIGHTER = 2.0


class Highlights(NamedTuple):
    """Pixels to be drawn one by one."""

    at: Tensor  # [n, 2] rows and columns
    light: Tensor  # [n, C] their colours
    signed_radius: Tensor  # [n] px


def reached_by(farthest: int) -> int:
    """Px around a region on which its highlights depend, for a greatest blur of `farthest` px.

    The disc of a highlight beside the region reaches into it, clipped by a surface before it.
    """
    return 3 * farthest + 2 * BLOCK


def split(
    layers: Sequence[SampleLayer], channels: int, limit: float
) -> tuple[Sequence[SampleLayer], list[Highlights]]:
    """Separate highlights from layers, in whose light they are ordinary.

    `channels`: how many are colours, which alone the highlights have; alpha stays as it is.
    """
    lights = [layer.light for layer in layers]
    brightness = [light.detach()[:channels].amax(0) for light in lights]
    least = torch.finfo(lights[0].dtype).tiny  # below it, some processors divide by 0
    bright = [each > max(limit, least) for each in brightness]
    if not any(bool(each.any()) for each in bright):
        return layers, []
    rest, drawn = [], []
    for layer, light, each, where in zip(layers, lights, brightness, bright, strict=True):
        colors, others = layer.color.tensor_split([channels])
        ordinary = torch.where(where, limit / BRIGHTER / each, 1.0)
        rest.append(layer._replace(color=torch.cat([colors * ordinary, others])))
        at = positions_of(where)
        row, column = at.unbind(1)
        beyond = light[:channels, row, column] * (1 - ordinary[row, column])
        drawn.append((at, beyond.T, layer.signed_radius[row, column]))
    at, colors, radius = (torch.cat(each) for each in zip(*drawn, strict=True))
    return rest, [Highlights(at, colors, radius)]


# A pixel is beside a depth edge if its radius and those of its neighbours span more px than this.
_EDGE = 1.513


class Occluders:
    """Surfaces before lights.

    Attributes:
        size: (height, width).
        blocks: [K, rows, columns] bool, the blocks that hold a pixel of each slice.
    """

    def __init__(self, layers: Sequence[SampleLayer], radii: tuple[float, ...]) -> None:
        """Find the depth edges, and the blocks of each slice; `radii`: those of slices in px."""
        r = layers[0].signed_radius.detach()
        self.size = r.shape[0], r.shape[1]
        nearest, farthest = (extreme_around(r, 1, end) for end in (torch.minimum, torch.maximum))
        self._edges = exceeding(farthest - nearest, _EDGE).flatten()
        held, self._occluders = [], []
        for layer in layers:
            radius, coverage = layer.signed_radius, layer.covered
            positions, covered = slice_position(radius, radii), coverage.detach() > 0
            present = None if bool(covered.all()) else covered
            held.append(blocks_of(positions, len(radii), present))
            values = radius.detach().flatten(), positions.flatten(), coverage.flatten()
            self._occluders.append(values)
        self._slice_indices = [blocks.any(2).any(1).tolist() for blocks in held]
        self.blocks = torch.stack(held).any(0)

    def square_coverage(
        self,
        pixels: Sequence[Tensor],  # the rows and columns of the nearest pixels, each [m, side]
        positions: Sequence[Tensor],  # the rows and columns, each [m, side]
        slice_index: int,
        limit: Tensor,  # [m] px, the radius below which a surface counts
    ) -> Tensor:
        """The coverage by a slice in squares: [m, side, side]."""
        m, side = pixels[0].shape
        spot = (pixels[0][:, :, None] * self.size[1] + pixels[1][:, None, :]).flatten()
        fraction = self.coverage(spot, slice_index, limit.repeat_interleave(side * side))
        index = torch.nonzero(self._edges.index_select(0, spot))[:, 0]
        square = index.div(side * side, rounding_mode="floor")
        number = index.div(side, rounding_mode="floor")
        y = positions[0].flatten().index_select(0, number)
        x = positions[1].flatten().index_select(0, square * side + index - number * side)
        between = self._between_pixels(y, x, slice_index, limit.index_select(0, square))
        return fraction.index_copy(0, index, between).view(m, side, side)

    def _between_pixels(self, y: Tensor, x: Tensor, slice_index: int, limit: Tensor) -> Tensor:
        """The coverage by a slice at rows and columns [n], interpolated between four pixels."""
        limits = []
        for position, length in zip((y, x), self.size, strict=True):
            below = position.floor()
            beyond, pixel = position - below, below.long()
            pixels = (pixel.clamp(0, length - 1), (pixel + 1).clamp(0, length - 1))
            limits.append(list(zip(pixels, (1 - beyond, beyond), strict=True)))
        total = torch.zeros_like(y)
        for row, down in limits[0]:
            for column, across in limits[1]:
                spot = row * self.size[1] + column
                total.addcmul_(self.coverage(spot, slice_index, limit), down * across)
        return total

    def coverage(self, spot: Tensor, slice_index: int, limit: Tensor) -> Tensor:
        """The coverage of pixels [n] by a slice, of surfaces whose radius is below a limit [n]."""
        total = torch.zeros_like(limit)
        for occluder, slice_indices in zip(self._occluders, self._slice_indices, strict=True):
            if slice_indices[slice_index]:
                radius, positions, coverage = (values.index_select(0, spot) for values in occluder)
                fraction = positions.sub_(slice_index).abs_().neg_().add_(1).clamp_(min=0)
                # not the light's own surface
                total.addcmul_(fraction.mul_(radius.sub_(limit).lt_(0)), coverage)
        return total


# A surface occludes a light if it is nearer by this many px of radius and by this share of it; no
# round numbers, so that rounding does not decide.
_BEFORE = (1.513, 0.1513)
# A place in the middle between two pixels is moved by this many px towards the light.
_TOWARDS = 0.01
# Radius in px below which a disc is dimmed evenly.
_SMALL = 2.013
# Lens points from the middle of the lens to its rim; their grid is symmetric to flips and turns.
_POINTS = 8
# Samples of occlusion computed at once: bounds memory.
_LOOKED_UP = 1 << 17


class Squares(NamedTuple):
    """The division of discs into a square number of squares."""

    extent: int  # px from the middle of a disc to its farthest pixel
    across: int  # number of squares along one axis
    side: int  # width of a square in px

    @classmethod
    def for_extent(cls, extent: int) -> Squares:
        """Squares no wider than a block."""
        count = -(-(2 * extent + 1) // BLOCK)
        return cls(extent, count, -(-(2 * extent + 1) // count))

    def cut(self, values: Tensor) -> Tensor:
        """The squares of discs [U, S, S], padded by zeros: [U, across, across, side, side]."""
        beyond = self.across * self.side - values.shape[-1]
        whole = pad(values, (0, beyond, 0, beyond))
        return whole.reshape(-1, self.across, self.side, self.across, self.side).movedim(3, 2)

    def corners(self, row: Tensor, column: Tensor) -> Tensor:
        """Px from the middle of a disc to the first pixel of squares [n]: [n, 2]."""
        return torch.stack([row, column], 1) * self.side - self.extent


class Occluded(NamedTuple):
    """Squares of discs that are occluded in part."""

    light: Tensor  # [n] index of the light
    row: Tensor  # [n] row of the square in the disc
    column: Tensor  # [n] column of the square in the disc
    fraction: Tensor  # [n, side, side] in [0, 1], the occluded share


class _Lights(NamedTuple):
    """Lights, and the slices that may stand before them."""

    at: Tensor  # [n, 2] rows and columns
    limit: Tensor  # [n] px, radii below which a surface stands before each
    before: Tensor  # [n, k] bool, whether each slice may stand before each light
    scale: Tensor  # [n, k] px in a slice per px in the disc
    small: Tensor  # [n] bool, whether a disc has few pixels
    spread: Tensor  # [n, k] px in a slice per radius of the lens

    def select(self, which: Tensor | slice) -> _Lights:
        """The lights of these indices."""
        return _Lights(*(values[which] for values in self))


class Obstruction:
    """Surfaces before lights."""

    def __init__(self, layers: Sequence[SampleLayer], radii: tuple[float, ...]) -> None:
        """Find which blocks hold pixels of which slices."""
        self._radii, self._occluders = radii, Occluders(layers, radii)
        blocks = self._occluders.blocks
        self._sums = pad(blocks.cumsum(1).cumsum(2), (1, 0, 1, 0))  # [K, rows + 1, columns + 1]

    def occluded(
        self, at: Tensor, radius: Tensor, squares: Squares, wanted: Tensor
    ) -> Iterator[Occluded]:
        """The squares of the discs of lights that are occluded in part.

        `at`: [n, 2] rows and columns; `radius`: [n] px; `wanted`: [n, across, across] bool, squares
        to test.
        """
        slice_indices, lights = self._lights(at, radius)
        if not len(slice_indices):
            return
        count = max(1, _LOOKED_UP // (len(slice_indices) * squares.across**2))
        for start in range(0, len(at), count):
            chunk = lights.select(slice(start, start + count))
            in_front = (
                self._in_front(chunk, slice_indices, squares) & wanted[start : start + count, None]
            )
            where = torch.nonzero(in_front.any(1))  # [m, 3]
            for positions in torch.split(where, max(1, _LOOKED_UP // squares.side**2)):
                light, row, column = positions.unbind(1)
                corner, slices = squares.corners(row, column), in_front[light, :, row, column]
                fraction = self._fraction(
                    chunk.select(light), slice_indices, slices, corner, squares.side
                )
                yield Occluded(light + start, row, column, fraction)

    def _lights(self, at: Tensor, radius: Tensor) -> tuple[Tensor, _Lights]:
        """The slices [k] that may stand before any of the lights, and the lights."""
        limit = nearer_than(radius.detach())
        radii = sent(self._radii, radius)
        before = (limit[:, None] > radii) & (self._sums[:, -1, -1] > 0)  # [n, K]
        slice_indices = torch.nonzero(before.any(0))[:, 0]
        r, small = radius[:, None], radius.abs() < _SMALL
        spread = r - radii[slice_indices]
        scale = spread / torch.where(small[:, None], 1.0, r)
        return slice_indices, _Lights(at, limit, before[:, slice_indices], scale, small, spread)

    def _in_front(self, lights: _Lights, slice_indices: Tensor, squares: Squares) -> Tensor:
        """Whether slices are in blocks before squares of discs: [n, k, across, across] bool."""
        first = (
            torch.arange(squares.across, device=slice_indices.device) * squares.side
            - squares.extent
        )
        last = (first + squares.side - 1).clamp(max=squares.extent)
        ends = []
        for axis, length in enumerate(self._occluders.size):
            at, small = lights.at[:, axis, None, None], lights.small[:, None, None]
            lens = lights.spread[:, :, None]
            places = [
                at + torch.where(small, end * lens, lights.scale[:, :, None] * x)
                for end, x in ((-1, first), (1, last))
            ]
            low, high = torch.minimum(*places).floor(), torch.maximum(*places).ceil()
            ends.append((_block(low, length), _block(high, length) + 1))
        (top, below), (left, beside) = ends
        columns, sums = self._sums.shape[2], self._sums.flatten()
        plane = (slice_indices * self._sums[0].numel())[:, None, None]

        def corner(y: Tensor, x: Tensor) -> Tensor:
            return sums[plane + y[..., :, None] * columns + x[..., None, :]]

        inside = corner(below, beside) - corner(top, beside)
        inside = inside - corner(below, left) + corner(top, left)
        return (inside > 0) & lights.before[..., None, None]

    def _fraction(
        self, lights: _Lights, slice_indices: Tensor, slices: Tensor, corner: Tensor, side: int
    ) -> Tensor:
        """The occluded share of squares of discs: [m, side, side].

        `slice_indices`: [k] slices to test; `slices`: [m, k] bool, whether each slice is before the
        square; `corner`: [m, 2] px from the light to the first pixel of its square; `side`: width
        of a square in px.
        """
        H, W = self._occluders.size
        offset = corner[..., None] + torch.arange(side, device=corner.device)  # [m, 2, side]
        occluded_fraction = lights.scale.new_zeros(len(corner), side, side)
        points = _lens_points(lights.scale)
        lens_weights = lights.scale.new_zeros(len(corner), len(points))
        for k, slice_index in enumerate(slice_indices.tolist()):
            small_index = torch.nonzero(slices[:, k] & lights.small)[:, 0]
            if len(small_index):
                subset = lights.select(small_index)
                row, column = (
                    _pixel(subset.at[:, axis, None], subset.spread[:, k, None] * u, length)
                    for axis, u, length in ((0, points[:, 1], H), (1, points[:, 0], W))
                )
                spots, limits = row * W + column, subset.limit[:, None].expand_as(row)
                fraction = self._occluders.coverage(spots.flatten(), slice_index, limits.flatten())
                lens_weights.index_add_(0, small_index, fraction.view(row.shape))
            large_index = torch.nonzero(slices[:, k] & ~lights.small)[:, 0]
            subset = lights.select(large_index)
            away = subset.scale[:, k, None, None] * offset[large_index]
            row, column = (
                _pixel(subset.at[:, axis, None], away[:, axis], length)
                for axis, length in enumerate((H, W))
            )
            position = (subset.at[..., None] + away).unbind(1)
            fraction = self._occluders.square_coverage(
                (row, column), position, slice_index, subset.limit
            )
            occluded_fraction.index_add_(0, large_index, fraction)
        mean = lens_weights.clamp(max=1).mean(1)[:, None, None]
        return torch.where(lights.small[:, None, None], mean, occluded_fraction.clamp(max=1))


def _lens_points(like: Tensor) -> Tensor:
    """[J, 2] lens points, x and y, spread evenly over the pupil."""
    position = (
        torch.arange(-_POINTS, _POINTS, dtype=like.dtype, device=like.device) + 0.5
    ) / _POINTS
    points = torch.cartesian_prod(position, position)
    return points[points.square().sum(1) < 1]


def nearer_than(radius: Tensor) -> Tensor:
    """Px [n] of radius below which a surface stands before lights of radii [n] px."""
    return radius - (_BEFORE[1] * radius.abs()).clamp(min=_BEFORE[0])


def _block(pixel: Tensor, length: int) -> Tensor:
    """The block, of those along `length` pixels, of a row or column."""
    return pixel.long().clamp(0, length - 1).div(BLOCK, rounding_mode="floor")


def _pixel(light: Tensor, away: Tensor, length: int) -> Tensor:
    """The row or column, below `length`, of the pixel nearest to a place `away` px from a light.

    Many places lie in the middle between two pixels: rounding must not depend on the side.
    """
    return (light + away - _TOWARDS * away.sign()).round().long().clamp(0, length - 1)


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
    barrel: Rim | None = None  # the pupil, as each radius sees it

    def part(self, start: int, end: int) -> _Alike:
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
    layers: Sequence[SampleLayer],  # which may stand before lights
    radii: tuple[float, ...],
    aperture: Aperture,
    parts: list[Part],
    box: Box,
    barrel: Rim | None = None,
) -> Tensor:
    """The discs of all highlights as the parts of the aperture see them: [M, C, height, width]."""
    maximum = max(*layers[0].signed_radius.shape, box.top + box.height, box.left + box.width)
    canvas = _Canvas(len(parts), highlights.light, box)
    obstruction = Obstruction(layers, radii)
    for alike in _alike(highlights, radii, maximum, box, barrel):
        squares = Squares.for_extent(alike.extent)
        rims, cut = [], []
        for part in parts:
            kernels = alike.kernels(aperture, part)
            rims.append(_DiscRim(kernels))
            cut.append(squares.cut(kernels))
        lit = torch.stack([(x != 0).any(-1).any(-1) for x in cut])  # [M, U, across, across]
        wanted = lit.any(0)
        step = max(1, _SAMPLES // max(rim.row.shape[1] for rim in rims))
        for start in range(0, len(alike.which), step):
            chunk = alike.part(start, start + step)
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
    barrel: Rim | None,
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
        chosen = everything.part(limits[first], limits[end])
        if len(chosen.which):
            yield _Alike(
                chosen.highlights,
                everything.radii[first:end],
                chosen.which - first,
                everything.weights[first:end],
                extent,
                everything.barrel and everything.barrel.select(slice(first, end)),
            )
        first = end


def _widest_first(
    highlights: Highlights,
    slice_radii: tuple[float, ...],
    maximum: int,
    box: Box,
    barrel: Rim | None,
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
    barrel = barrel and barrel.select(wide)
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

"""Highlights: the few brightest pixels, each drawn as a disc, which nearer surfaces clip.

Almost all energy of a scene with lights is in few pixels. Layers would fade the discs that a wire
before them clips, and a transform would spread rounding noise of 1e-7 of their brightness over the
picture. So the light of such a pixel is removed from the layers and drawn as a separate disc.

Disc pixel x of a light at q is seen through lens point u = (x - q) / r_q, and a nearer surface of
radius r_k in front of it at q + u (r_q - r_k). Beside depth edges the coverage there is
interpolated between pixels, so that the rim of a shadow is as smooth as the surface. Discs are
drawn in squares, and each square is compared only with slices in front of it. A small disc has too
few pixels to sample u: it is dimmed evenly, by the mean over the lens.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.cat_eye import Rim
from defocus_core.optics.parts import Part
from defocus_core.renderer.blur.kernel_bank import reach
from defocus_core.renderer.engine.limits import BRIGHTER
from defocus_core.renderer.layers.layer import SampleLayer
from defocus_core.renderer.layers.slice_radii import slice_position
from defocus_core.renderer.layers.sliced_surface import blocks_of
from defocus_core.tensors.box import BLOCK, Box
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.neighbourhoods import exceeding, extreme_around, positions_of


class Highlights(NamedTuple):
    """Pixels that are drawn as separate discs."""

    at: Tensor  # [n, 2] rows and columns
    light: Tensor  # [n, C] their colours
    signed_radius: Tensor  # [n] px


def reached_by(farthest: int) -> int:
    """The width in px of the border around a region on which its highlights depend.

    The disc of a highlight outside the region may reach into it, clipped by nearer surfaces.
    `farthest`: greatest reach of blur in px.
    """
    return 3 * farthest + 2 * BLOCK


def split(
    layers: Sequence[SampleLayer], channels: int, limit: float
) -> tuple[Sequence[SampleLayer], list[Highlights]]:
    """Layers in which highlights are dimmed to ordinary light, and the highlights themselves.

    `channels`: number of colour channels; highlights have only these, and alpha is unchanged;
    `limit`: brightness above which a pixel is a highlight.
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
# A surface occludes a light if it is nearer by this many px of radius and by this share of it; no
# round numbers, so that rounding does not decide.
_BEFORE = (1.513, 0.1513)
# A place in the middle between two pixels is moved by this many px towards the light.
_TOWARDS = 0.01


class _Occluders:
    """Surfaces that may hide parts of lights."""

    def __init__(self, layers: Sequence[SampleLayer], radii: tuple[float, ...]) -> None:
        """Find depth edges, and the blocks with pixels of each slice; `radii`: slice radii, px."""
        r = layers[0].signed_radius.detach()
        self._radii, self._size = radii, (r.shape[0], r.shape[1])
        nearest, farthest = (extreme_around(r, 1, end) for end in (torch.minimum, torch.maximum))
        self._edges = exceeding(farthest - nearest, _EDGE).flatten()
        blocks, self._layers = [], []
        for layer in layers:
            radius, coverage = layer.signed_radius, layer.covered
            positions, covered = slice_position(radius, radii), coverage.detach() > 0
            present = None if bool(covered.all()) else covered
            blocks.append(blocks_of(positions, len(radii), present))
            values = radius.detach().flatten(), positions.flatten(), coverage.flatten()
            self._layers.append(values)
        self._present = [held.any(2).any(1).tolist() for held in blocks]  # slices of each layer
        sums = torch.stack(blocks).any(0).cumsum(1).cumsum(2)
        self._sums = torch.nn.functional.pad(sums, (1, 0, 1, 0))  # [K, rows + 1, columns + 1]

    def clear(
        self, at: Tensor, radius: Tensor, lens: Sequence[Tensor], *, interpolated: bool
    ) -> Tensor:
        """The share [n, a, b] of lights that nearer surfaces do not hide at each lens point.

        `at`: [n, 2] rows and columns of lights; `radius`: [n] px of them; `lens`: rows [n, a] and
        columns [n, b] of lens points; `interpolated`: whether coverage beside edges is interpolated
        between pixels.
        """
        own = radius.detach()
        limit = own - (_BEFORE[1] * own.abs()).clamp(min=_BEFORE[0])
        covered = radius.new_zeros(len(at), lens[0].shape[1], lens[1].shape[1])
        farthest = float(limit.amax())
        for k, slice_radius in enumerate(self._radii):
            if slice_radius >= farthest or not any(present[k] for present in self._present):
                continue
            spread = (radius - slice_radius)[:, None]
            away = [spread * points for points in lens]
            before = (limit > slice_radius) & self._has_pixels(k, at, away)
            index = torch.nonzero(before)[:, 0]
            if len(index):
                some = at[index], [x[index] for x in away], limit[index]
                part = self._coverage(k, *some, interpolated=interpolated)
                covered.index_add_(0, index, part)
        return 1 - covered.clamp(max=1)

    def _has_pixels(self, k: int, at: Tensor, away: Sequence[Tensor]) -> Tensor:
        """Whether slice `k` may have pixels at given distances from each of n lights: [n] bool.

        `away`: px from the lights, [n, a] to rows and [n, b] to columns.
        """
        ends = []
        for d, (px, length) in enumerate(zip(away, self._size, strict=True)):
            limits = (at[:, d] + px.amin(1)).floor(), (at[:, d] + px.amax(1)).ceil()
            first, last = (x.long().clamp(0, length - 1) // BLOCK for x in limits)
            ends.append((first, last + 1))
        (top, below), (left, beside) = ends
        sums = self._sums[k]
        inside = sums[below, beside] - sums[top, beside] - sums[below, left] + sums[top, left]
        return inside > 0

    def _coverage(
        self, k: int, at: Tensor, away: Sequence[Tensor], limit: Tensor, *, interpolated: bool
    ) -> Tensor:
        """The coverage [n, a, b] by slice `k` at rows [n, a] and columns [n, b] away from lights.

        `limit`: [n] px, radius below which surfaces are in front of each light.
        """
        (n, a), b = away[0].shape, away[1].shape[1]
        rows, columns = (
            # rounding must not depend on the side of a place in the middle between two pixels
            (at[:, d, None] + px - _TOWARDS * px.sign()).round().long().clamp(0, length - 1)
            for d, (px, length) in enumerate(zip(away, self._size, strict=True))
        )
        spot = (rows[:, :, None] * self._size[1] + columns[:, None, :]).flatten()
        covered = self._covered(spot, k, limit.repeat_interleave(a * b))
        if interpolated:
            index = torch.nonzero(self._edges.index_select(0, spot))[:, 0]
            light = index.div(a * b, rounding_mode="floor")
            y, x = (
                (at[:, d, None, None] + px).expand(n, a, b).flatten().index_select(0, index)
                for d, px in enumerate((away[0][..., None], away[1][:, None]))
            )
            between = self._between_pixels(y, x, k, limit.index_select(0, light))
            covered = covered.index_copy(0, index, between)
        return covered.view(n, a, b)

    def _between_pixels(self, y: Tensor, x: Tensor, k: int, limit: Tensor) -> Tensor:
        """The coverage by slice `k` at fractional rows and columns [n], interpolated bilinearly."""
        limits = []
        for position, length in zip((y, x), self._size, strict=True):
            below = position.floor()
            beyond, pixel = position - below, below.long()
            pixels = (pixel.clamp(0, length - 1), (pixel + 1).clamp(0, length - 1))
            limits.append(list(zip(pixels, (1 - beyond, beyond), strict=True)))
        total = torch.zeros_like(y)
        for row, down in limits[0]:
            for column, across in limits[1]:
                spot = row * self._size[1] + column
                total.addcmul_(self._covered(spot, k, limit), down * across)
        return total

    def _covered(self, spot: Tensor, k: int, limit: Tensor) -> Tensor:
        """The coverage of pixels [n] by slice `k`, by surfaces with radii below `limit` [n]."""
        total = torch.zeros_like(limit)
        for layer, present in zip(self._layers, self._present, strict=True):
            if present[k]:
                radius, positions, coverage = (values.index_select(0, spot) for values in layer)
                fraction = positions.sub_(k).abs_().neg_().add_(1).clamp_(min=0)
                # not the light's own surface
                total.addcmul_(fraction.mul_(radius.sub_(limit).lt_(0)), coverage)
        return total


# Samples of discs that are drawn at once: bounds memory.
_SAMPLES = 1 << 17
# Greatest ratio of the widths of kernels that are sampled together.
_AS_WIDE = 2
# Radius in px of the first slice out of focus up to which discs are blurred as by slices.
_NEAR_FOCUS = 1.0
# Radius in px below which a disc is dimmed evenly, by the mean over a grid of lens points, which is
# symmetric to flips and turns.
_SMALL, _POINTS = 2.013, 8


class _Group(NamedTuple):
    """Highlights that are drawn together."""

    highlights: Highlights
    radii: Tensor  # [U] px, the different radii of their kernels
    which: Tensor  # [n] the index in `radii` of each highlight
    weights: Tensor  # [U] share of the light in the kernel; the rest stays in its pixel
    extent: int  # greatest distance in px from a highlight to a pixel of its disc
    barrel: Rim | None  # the pupil, as each radius sees it

    def kernels(self, aperture: Aperture, part: Part) -> Tensor:
        """The share [U, S, S] of light that reaches each pixel through a part of the pupil."""
        kernels = aperture.kernel(self.radii, 2 * self.extent + 1, part, self.barrel)
        if self.extent > _AS_WIDE * math.ceil(_NEAR_FOCUS):
            return kernels
        weights = self.weights[:, None, None]
        return kernels * weights + torch.nn.functional.pad(1 - weights, [self.extent] * 4)


def draw(
    highlights: Highlights,
    layers: Sequence[SampleLayer],  # which may stand before lights
    radii: tuple[float, ...],
    aperture: Aperture,
    parts: list[Part],
    box: Box,
    barrel: Rim | None = None,
) -> Tensor:
    """The discs of all highlights through each part of the aperture: [M, C, height, width].

    `box`: the rectangle of the result; `barrel`: the pupil as each highlight sees it.
    """
    maximum = max(*layers[0].signed_radius.shape, box.top + box.height, box.left + box.width)
    occluders, colors = _Occluders(layers, radii), highlights.light.shape[1]
    # a last pixel takes what lies beyond the box
    pictures = highlights.light.new_zeros(len(parts), colors, box.area + 1)
    first = torch.arange(0, pictures.numel(), box.area + 1, device=pictures.device)
    for group in _groups(highlights, radii, maximum, box, barrel):
        kernels = torch.stack([group.kernels(aperture, part) for part in parts])  # [M, U, S, S]
        across = -(-kernels.shape[-1] // BLOCK)  # squares along an axis, no wider than a block
        side = -(-kernels.shape[-1] // across)
        beyond = across * side - kernels.shape[-1]
        # [M, U, across, across, side, side]
        cut = torch.nn.functional.pad(kernels, (0, beyond, 0, beyond)).view(
            *kernels.shape[:2], *(across, side) * 2
        )
        cut = cut.movedim(-2, -3)
        lit = (cut.detach() != 0).any(-1).any(-1).any(0)[group.which]
        for squares in torch.split(torch.nonzero(lit), max(1, _SAMPLES // side**2)):
            light, row, column = squares.unbind(1)
            at, colored, radius = (x[light] for x in group.highlights)
            corner = squares[:, 1:] * side - group.extent  # from the light
            values = cut[:, group.which[light], row, column].to(colored)
            values = values * _clear(occluders, at, radius, corner, side)
            added = values[:, None] * colored.T[..., None, None]  # [M, C, m, side, side]
            every = first[:, None] + _numbers(at + corner, side, box).flatten()
            pictures.view(-1).index_add_(0, every.flatten(), added.flatten())
    return pictures[..., :-1].reshape(len(parts), colors, box.height, box.width)


def _numbers(corner: Tensor, side: int, box: Box) -> Tensor:
    """Indices in `box` of the pixels of squares [n, side, side]; `box.area` for pixels outside.

    `corner`: [n, 2], row and column of the first pixel of each square.
    """
    rows, columns = (
        corner[:, d, None] + torch.arange(side, device=corner.device) - start
        for d, start in enumerate(box[:2])
    )
    down, across = (rows >= 0) & (rows < box.height), (columns >= 0) & (columns < box.width)
    number = rows[:, :, None] * box.width + columns[:, None]
    return torch.where(down[:, :, None] & across[:, None], number, box.area)


def _clear(occluders: _Occluders, at: Tensor, radius: Tensor, corner: Tensor, side: int) -> Tensor:
    """The share [n, side, side] of light in squares of discs that nearer surfaces do not hide.

    `at`: [n, 2] rows and columns of the lights; `radius`: [n] px, their radii; `corner`: [n, 2] px
    from the lights to the first pixels of the squares.
    """
    is_small, clear = radius.detach().abs() < _SMALL, radius.new_ones(len(at), side, side)
    large, small = (torch.nonzero(mask)[:, 0] for mask in (~is_small, is_small))
    if len(large):
        r = radius[large]
        pixels = corner[large, :, None] + torch.arange(side, device=at.device)
        lens = (pixels / r[:, None, None]).unbind(1)
        shown = occluders.clear(at[large], r, lens, interpolated=True)
        clear = clear.index_copy(0, large, shown)
    if len(small):
        points = (torch.arange(-_POINTS, _POINTS).to(radius) + 0.5) / _POINTS
        shown = occluders.clear(at[small], radius[small], [points[None]] * 2, interpolated=False)
        of_lens = points[:, None].square() + points.square() < 1
        mean = shown[:, of_lens].mean(1)[:, None, None]
        clear = clear.index_copy(0, small, mean.expand(-1, side, side))
    return clear


def _groups(
    highlights: Highlights,
    slice_radii: tuple[float, ...],
    maximum: int,
    box: Box,
    barrel: Rim | None,
) -> Iterator[_Group]:
    """Yield the highlights whose discs reach `box`, in groups of similar width, widest first.

    `maximum`: greatest reach of a disc in px.
    """
    corner = sent([box.top, box.left], highlights.at)
    last = corner + sent([box.height - 1, box.width - 1], corner)
    away = torch.maximum(corner - highlights.at, highlights.at - last).amax(1)
    reaching = away <= highlights.signed_radius.detach().abs() + _NEAR_FOCUS
    index = torch.nonzero(reaching)[:, 0]
    highlights = Highlights(*(values[index] for values in highlights))
    radii, barrel = highlights.signed_radius, barrel and barrel.select(index)
    which = torch.arange(len(radii), device=radii.device)
    if not radii.requires_grad and barrel is None:  # many highlights are equally far away
        radii, which = torch.unique(radii, return_inverse=True)
    radii, weights = _as_by_slices(radii, slice_radii)
    spread = torch.tensor([reach(r, maximum) for r in radii.tolist()], device=radii.device)
    wide = spread.argsort(descending=True, stable=True)
    spreads, rank, first = spread[wide].tolist(), wide.argsort()[which], 0
    while first < len(spreads):
        extent = spreads[first]
        count = max(1, _SAMPLES // (2 * extent + 1) ** 2)
        end = first + sum(_AS_WIDE * spread >= extent for spread in spreads[first : first + count])
        of_group, chosen = wide[first:end], torch.nonzero((rank >= first) & (rank < end))[:, 0]
        yield _Group(
            Highlights(*(values[chosen] for values in highlights)),
            radii[of_group],
            rank[chosen] - first,
            weights[of_group],
            extent,
            barrel and barrel.select(of_group),
        )
        first = end


def _as_by_slices(radius: Tensor, slice_radii: tuple[float, ...]) -> tuple[Tensor, Tensor]:
    """The radii [U] px of the kernels of discs, and the shares of light in these kernels.

    The rest of the light stays in its pixel. Pixels next to focus are blurred by the mean of a
    point and of the first slice out of focus, and so is a highlight among them: as a point, with
    the light of its neighbours added, it would be too bright.
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

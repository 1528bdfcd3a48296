"""Occlusion of a highlight's disc by the surfaces before it.

Disc pixel x of a light q is seen through lens point u = (x - q) / r_q, and a nearer surface of
radius r_k in front of it at q + u (r_q - r_k). Beside depth edges the coverage there is
interpolated between pixels: a shadow has a rim as smooth as its surface. Squares of a disc that no
nearer slice is in front of are skipped. A small disc has too few pixels to sample u: it is dimmed
evenly, by the mean over the lens.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.renderer.compositing.occluders import Occluder, Occluders
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.tiling import BLOCK

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
_SAMPLES = 1 << 17


class Squares(NamedTuple):
    """The division of discs into a square number of squares."""

    extent: int  # px from the middle of a disc to its farthest pixel
    across: int  # number of squares along one axis
    side: int  # width of a square in px

    @classmethod
    def of(cls, extent: int) -> Squares:
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

    def __init__(self, occluders: Sequence[Occluder], radii: tuple[float, ...]) -> None:
        """Find which blocks hold pixels of which slices."""
        self._radii, self._occluders = radii, Occluders(occluders, len(radii))
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
        count = max(1, _SAMPLES // (len(slice_indices) * squares.across**2))
        for start in range(0, len(at), count):
            chunk = lights.select(slice(start, start + count))
            in_front = (
                self._in_front(chunk, slice_indices, squares) & wanted[start : start + count, None]
            )
            where = torch.nonzero(in_front.any(1))  # [m, 3]
            for positions in torch.split(where, max(1, _SAMPLES // squares.side**2)):
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
            fraction = self._occluders.beside((row, column), position, slice_index, subset.limit)
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

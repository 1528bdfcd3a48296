"""Occlusion of a highlight's disc by the surfaces before it.

Disc pixel x of a light q is seen through lens point u = (x - q) / r_q, and a nearer surface of
radius r_k in front of it at q + u (r_q - r_k). Squares of a disc before which nothing can stand
are not looked at. Discs of few pixels have few u: what they lose is the mean over the lens.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.images.tiling import BLOCK
from defocus_core.layers.block_index import blocks_of

# How much nearer, in px of radius and as a share of it, a surface must be to stand before a light;
# no round numbers, so that rounding decides nothing.
_BEFORE = (1.513, 0.1513)
# Px towards a light by which a place between two pixels is nearer to the one of them.
_TOWARDS = 0.01
# Radius in px below which a light loses as much all over its disc.
_SMALL = 2.013
# Lens points from the middle to the rim by which it is told how much: flips and turns change none.
_POINTS = 8
# Samples looked at at once: bounds memory.
_SAMPLES = 1 << 17


class Squares(NamedTuple):
    """How discs are cut into squares, as many along both axes.

    Attributes:
        extent: Px from the middle of a disc to its farthest pixel.
        across: Squares on a side.
        side: Px on a side of a square.
    """

    extent: int
    across: int
    side: int

    @classmethod
    def of(cls, extent: int) -> Squares:
        """Squares of a block at most."""
        count = -(-(2 * extent + 1) // BLOCK)
        return cls(extent, count, -(-(2 * extent + 1) // count))

    def cut(self, values: Tensor) -> Tensor:
        """Those of discs [U, S, S], with zeros beyond: [U, across, across, side, side]."""
        beyond = self.across * self.side - values.shape[-1]
        whole = pad(values, (0, beyond, 0, beyond))
        return whole.reshape(-1, self.across, self.side, self.across, self.side).movedim(3, 2)

    def corners(self, row: Tensor, column: Tensor) -> Tensor:
        """Px from the middle of a disc to the first pixel of squares [n]: [n, 2]."""
        return torch.stack([row, column], 1) * self.side - self.extent


class Stopped(NamedTuple):
    """Squares of discs that are stopped in part.

    Attributes:
        light: [n] whose disc it is.
        row: [n] of the square.
        column: [n] of the square.
        share: [n, side, side] in [0, 1], what does not come through.
    """

    light: Tensor
    row: Tensor
    column: Tensor
    share: Tensor


class _Lights(NamedTuple):
    """Lights, and the slices that may stand before them.

    Attributes:
        at: [n, 2] rows and columns.
        limit: [n] px, radii below which a surface stands before each.
        before: [n, k] bool, whether slices do.
        scale: [n, k] px in a slice per px in the disc.
        small: [n] bool, whether a disc has few pixels.
        spread: [n, k] px in a slice per radius of the lens.
    """

    at: Tensor
    limit: Tensor
    before: Tensor
    scale: Tensor
    small: Tensor
    spread: Tensor

    def some(self, which: Tensor | slice) -> _Lights:
        """Some of them."""
        return _Lights(*(values[which] for values in self))


class Obstruction:
    """Surfaces before lights."""

    def __init__(self, signed_radius: Tensor, places: Tensor, radii: tuple[float, ...]) -> None:
        """Find which blocks hold pixels of which slices.

        Args:
            signed_radius: [H, W] px.
            places: [H, W] positions on the ladder.
            radii: The ladder.
        """
        self._signed_radius, self._places, self._radii = signed_radius, places, radii
        blocks = blocks_of(places, len(radii))
        self._sums = pad(blocks.cumsum(1).cumsum(2), (1, 0, 1, 0))  # [K, rows + 1, columns + 1]

    def stopped(
        self, at: Tensor, radius: Tensor, squares: Squares, wanted: Tensor
    ) -> Iterator[Stopped]:
        """Squares of the discs of lights that are stopped in part.

        Args:
            at: [n, 2] rows and columns.
            radius: [n] px.
            squares: How discs are cut.
            wanted: [n, across, across] bool, squares that are asked for.
        """
        rungs, lights = self._lights(at, radius)
        if not len(rungs):
            return
        few = max(1, _SAMPLES // (len(rungs) * squares.across**2))
        for start in range(0, len(at), few):
            some = lights.some(slice(start, start + few))
            met = self._met(some, rungs, squares) & wanted[start : start + few, None]
            where = torch.nonzero(met.any(1))  # [m, 3]
            for found in torch.split(where, max(1, _SAMPLES // squares.side**2)):
                light, row, column = found.unbind(1)
                corner, slices = squares.corners(row, column), met[light, :, row, column]
                share = self._share(some.some(light), rungs, slices, corner, squares.side)
                yield Stopped(light + start, row, column, share)

    def _lights(self, at: Tensor, radius: Tensor) -> tuple[Tensor, _Lights]:
        """Rungs [k] that stand before any of some lights, and these."""
        limit = nearer_than(radius)
        radii = torch.tensor(self._radii, dtype=torch.float64).to(radius)
        before = (limit[:, None] > radii) & (self._sums[:, -1, -1] > 0)  # [n, K]
        rungs = torch.nonzero(before.any(0))[:, 0]
        r, small = radius[:, None], radius.abs() < _SMALL
        spread = r - radii[rungs]
        scale = spread / torch.where(small[:, None], 1.0, r)
        return rungs, _Lights(at, limit, before[:, rungs], scale, small, spread)

    def _met(self, lights: _Lights, rungs: Tensor, squares: Squares) -> Tensor:
        """Whether slices are in blocks before squares of discs: [n, k, across, across] bool."""
        first = torch.arange(squares.across, device=rungs.device) * squares.side - squares.extent
        last = (first + squares.side - 1).clamp(max=squares.extent)
        ends = []
        for axis, length in enumerate(self._places.shape):
            at, small = lights.at[:, axis, None, None], lights.small[:, None, None]
            lens = lights.spread[:, :, None]
            one, other = (
                _pixel(
                    at, torch.where(small, end * lens, lights.scale[:, :, None] * x), length
                ).div(BLOCK, rounding_mode="floor")
                for end, x in ((-1, first), (1, last))
            )
            low, high = torch.minimum(one, other), torch.maximum(one, other)
            ends.append((low, high + 1))
        (top, below), (left, beside) = ends
        columns, sums = self._sums.shape[2], self._sums.flatten()
        plane = (rungs * self._sums[0].numel())[:, None, None]

        def corner(y: Tensor, x: Tensor) -> Tensor:
            return sums[plane + y[..., :, None] * columns + x[..., None, :]]

        inside = corner(below, beside) - corner(top, beside)
        inside = inside - corner(below, left) + corner(top, left)
        return (inside > 0) & lights.before[..., None, None]

    def _share(
        self, lights: _Lights, rungs: Tensor, slices: Tensor, corner: Tensor, side: int
    ) -> Tensor:
        """What does not come through squares of discs: [m, side, side].

        Args:
            lights: m, whose discs they are of.
            rungs: [k] that are asked for.
            slices: [m, k] bool, those that are before them.
            corner: [m, 2] px from the light to the first pixel.
            side: Of a square in px.
        """
        H, W = self._places.shape
        offset = corner[..., None] + torch.arange(side, device=corner.device)  # [m, 2, side]
        stopped = lights.scale.new_zeros(len(corner), side, side)
        points = _lens_points(lights.scale)
        of_lens = lights.scale.new_zeros(len(corner), len(points))
        for k, rung in enumerate(rungs.tolist()):
            few = torch.nonzero(slices[:, k] & lights.small)[:, 0]
            if len(few):
                some = lights.some(few)
                row, column = (
                    _pixel(some.at[:, axis, None], some.spread[:, k, None] * u, length)
                    for axis, u, length in ((0, points[:, 1], H), (1, points[:, 0], W))
                )
                share = self._covered(row * W + column, rung, some.limit[:, None])
                of_lens.index_add_(0, few, share)
            here = torch.nonzero(slices[:, k] & ~lights.small)[:, 0]
            some = lights.some(here)
            y, x = (some.scale[:, k, None, None] * offset[here]).unbind(1)
            row, column = (
                _pixel(some.at[:, axis, None], away, length)
                for axis, (away, length) in enumerate(((y, H), (x, W)))
            )
            spot = row[:, :, None] * W + column[:, None, :]
            share = self._covered(spot, rung, some.limit[:, None, None])
            stopped.index_add_(0, here, share)
        mean = of_lens.clamp(max=1).mean(1)[:, None, None]
        return torch.where(lights.small[:, None, None], mean, stopped.clamp(max=1))

    def _covered(self, spot: Tensor, rung: int, limit: Tensor) -> Tensor:
        """What a slice covers of some pixels, of surfaces nearer than a limit."""
        radius, places = (
            values.flatten().index_select(0, spot.flatten()).view(spot.shape)
            for values in (self._signed_radius, self._places)
        )
        share = places.sub_(rung).abs_().neg_().add_(1).clamp_(min=0)
        return share.mul_(radius.sub_(limit).lt_(0))  # not its own


def _lens_points(like: Tensor) -> Tensor:
    """[J, 2] lens points, x and y, spread evenly over the pupil."""
    place = (torch.arange(-_POINTS, _POINTS, dtype=like.dtype, device=like.device) + 0.5) / _POINTS
    points = torch.cartesian_prod(place, place)
    return points[points.square().sum(1) < 1]


def nearer_than(radius: Tensor) -> Tensor:
    """Px [n] of radius below which a surface stands before lights of radii [n] px."""
    return radius - (_BEFORE[1] * radius.abs()).clamp(min=_BEFORE[0])


def _pixel(light: Tensor, away: Tensor, length: int) -> Tensor:
    """The row or column, of so many, of the pixel nearest to what is so many px away from a light.

    Discs of equal steps of radius have many places in the middle between two pixels.
    """
    return (light + away - _TOWARDS * away.sign()).round().long().clamp(0, length - 1)

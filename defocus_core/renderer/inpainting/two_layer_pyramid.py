"""A pyramid of two surfaces: in each coarse pixel the farthest one, and the next in front of it.

A coarse pixel on a depth edge holds two surfaces. Their mean is neither, and hidden content is
continued from the farther one only. So each coarse pixel keeps two surfaces, each the mean of
pixels of similar radii. From the second halving on, coarse pixels overlap (Burt 1981), so that
their values change little if an edge is moved by a pixel.

A hidden pixel gets the weighted mean of the surfaces around it at a fine level. If their weights
sum to less than is enough, the next coarser level adds the rest, and so on: push-pull (Gortler et
al. 1996). The levels are computed once, and read only for hidden pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag, pad

from defocus_core.renderer.engine import limits
from defocus_core.tensors.device_plan import pieces, sent
from defocus_core.tensors.pyramid import Axis, AxisHalving, halves, position_of
from defocus_core.tensors.threads import recomputed

# Copies of all that coarse pixels hold, while two surfaces are made of it.
_COPIES = 4


class PyramidLevel(NamedTuple):
    """Two surfaces in each coarse pixel of a frame, or of a rectangle of it.

    Each is [K + 3, h, w]: K values, 0 where there is no surface; its weight, the share in [0, 1] of
    the coarse pixel that it covers; and its least and greatest radius in px, infinite where there
    is none.
    """

    far: Tensor  # the farthest surface
    near: Tensor | None  # the next one, in front of it; None at full resolution
    middle: tuple[Axis, Axis]  # the middle of the frame, in coarse pixels
    level: int  # how many times resolution is halved

    @property
    def size(self) -> tuple[int, int]:
        """The height and the width in coarse pixels."""
        return self.far.shape[1], self.far.shape[2]

    @property
    def surfaces(self) -> list[Tensor]:
        """The far and the near surface, or the far one only at full resolution."""
        return [self.far] if self.near is None else [self.far, self.near]

    @property
    def edges(self) -> Tensor:
        """Whether each coarse pixel [h, w] holds two surfaces."""
        assert self.near is not None
        return self.near[-1].detach() > -torch.inf


def pixels_of(
    values: Sequence[Tensor],  # each [k, H, W], together K channels
    signed_radius: Tensor,  # [H, W] px
    middle: tuple[Axis, Axis],
    weight: Tensor | None = None,  # [H, W] in [0, 1], weights of pixels; None if all are 1
) -> PyramidLevel:
    """The level of full resolution, at which each pixel holds one surface."""
    r = signed_radius.detach()
    weight = torch.ones_like(r) if weight is None else weight
    further = weight[None], r[None], r[None]
    return PyramidLevel(torch.cat([*values, *further]), None, middle, 0)


def coarser(level: PyramidLevel) -> PyramidLevel:
    """The next coarser level, at half the resolution."""
    axes = [halves(n, axis) for n, axis in zip(level.size, level.middle, strict=True)]
    alike = limits.ONE_SURFACE * limits.GROWTH ** max(level.level - 1, 0)
    pixels = torch.stack(level.surfaces, 1)  # [K + 3, s, H, W]
    held, shares = _held(pixels, axes, 0.0, overlapping=level.level > 0)
    held = held.movedim((-2, -1), (2, 3))  # [K + 3, s, down, across, h, w]
    every = [a * b for a in shares[0] for b in shares[1]] * pixels.shape[1]
    fraction = sent(every, pixels)[:, None, None]
    bytes_each = _COPIES * len(pixels) * len(every) * pixels.element_size()
    rows = max(1, pieces(pixels.device, bytes_each) // axes[1].length)

    def surfaces(part: Tensor) -> tuple[Tensor, Tensor]:
        every = part.reshape(len(part), len(fraction), *part.shape[-2:])
        return _two_farthest(every, fraction, alike)

    pairs = map(recomputed(surfaces), torch.split(held, rows, 4))
    far, near = (torch.cat(each, 1) for each in zip(*pairs, strict=True))
    return PyramidLevel(far, near, (axes[0].axis, axes[1].axis), level.level + 1)


def _held(
    values: Tensor, axes: Sequence[AxisHalving], beyond: float, *, overlapping: bool
) -> tuple[Tensor, list[list[float]]]:
    """The pixels [..., h, w, down, across] of each coarse pixel; their shares along both axes.

    `beyond`: value of pixels beyond those of `values` [..., H, W].
    """
    missing, shares = list[int](), list[list[float]]()
    for axis, length in zip(axes, values.shape[-2:], strict=True):
        share, before = [1.0, 1.0], axis.before
        if axis.axis.odd:
            share, before = [0.5, 1.0, 0.5], before + 1
        elif overlapping:
            share, before = [0.25, 0.75, 0.75, 0.25], before + 1
        missing = [before, 2 * axis.length - 2 + len(share) - before - length, *missing]
        shares.append(share)
    values = pad(values, missing, value=beyond) if any(missing) else values
    return values.unfold(-2, len(shares[0]), 2).unfold(-2, len(shares[1]), 2), shares


def _two_farthest(held: Tensor, fraction: Tensor, alike: float) -> tuple[Tensor, Tensor]:
    """The farthest surface and the next one, [K + 3, h, w] each, of coarse pixels.

    `held`: [K + 3, k, h, w], the k surfaces that each coarse pixel holds; `fraction`: [k, 1, 1],
    their shares; `alike`: greatest difference in px between radii of one surface.
    """
    values, weight = held[:-3], held[-3] * fraction
    minimum, maximum = held[-2:].detach()
    remaining, surfaces = weight > 0, []
    for number in range(2):
        top = torch.where(remaining, maximum, -torch.inf).amax(0)
        chosen = remaining & (minimum > top - alike)
        if not number:
            remaining = remaining > chosen
        part = weight * chosen
        total = part.sum(0)
        mean = (values * part).sum(1) / total.clamp(min=limits.LEAST_WEIGHT)
        lowest = torch.where(chosen, minimum, torch.inf).amin(0)
        surfaces.append(torch.cat([mean, total.clamp(max=1)[None], lowest[None], top[None]]))
    return surfaces[0], surfaces[1]


def least_of(signed_radius: Tensor, middle: tuple[Axis, Axis]) -> Tensor:
    """The least radius of the pixels in each coarse pixel [h, w] of half resolution.

    `signed_radius`: [H, W] px; `middle`: the middle of the frame.
    """
    axes = [halves(n, axis) for n, axis in zip(signed_radius.shape, middle, strict=True)]
    held, _ = _held(signed_radius, axes, torch.inf, overlapping=False)
    return held.amin((-2, -1))


# Bytes that a pixel takes while it is looked up.
_BYTES_OF_QUERY = 1 << 10


class HiddenQueries(NamedTuple):
    """Hidden pixels, each with the range of radii of the surfaces that are continued to it."""

    at: Tensor  # [n, 2] rows and columns, also between pixels
    border: Tensor  # [n] px, the radius that a surface must exceed
    ceiling: Tensor  # [n] px, the radius that a surface must not reach

    def select(self, index: Tensor) -> HiddenQueries:
        """The pixels with the given indices."""
        return HiddenQueries(*(values.index_select(0, index) for values in self))


class SurfaceTable(NamedTuple):
    """The surfaces of several levels, concatenated for look-ups."""

    values: Tensor  # [2 N, K] the farthest surface of each coarse pixel, then the next ones
    limits: Tensor  # [2, 2 N] their weights and least radii
    # [L, 2, 1] of each level: row and column of pixel 0 of the frame among coarse pixels, the step
    # from pixel to pixel, and the last coarse pixel; [L, 1, 1] width and first row in the table
    origin: Tensor
    step: Tensor
    last: Tensor
    width: Tensor
    start: Tensor

    @classmethod
    def from_levels(cls, levels: Sequence[PyramidLevel], fine: tuple[Axis, Axis]) -> SurfaceTable:
        """The table of levels of a frame; `fine`: the middle of the frame at full resolution."""
        places = []
        for level in levels:  # a place among coarse pixels is affine in the row or column
            for axis, middle, length in zip(fine, level.middle, level.size, strict=True):
                ends = [position_of(pixel, axis, middle, level.level) for pixel in (0.0, 1.0)]
                places.append((ends[0], ends[1] - ends[0], length - 1))
        like = levels[0].far
        origin, step, last = sent(places, like).view(-1, 2, 1, 3).unbind(3)
        counts = [level.size[0] * level.size[1] for level in levels]
        rows = [level.size[1] for level in levels], [0, *accumulate(counts[:-1])]
        width, start = sent(rows, like.new_empty(0, dtype=torch.long))[..., None, None]
        pairs = zip(*(level.surfaces for level in levels), strict=True)
        every = [surface.flatten(1) for kind in pairs for surface in kind]
        return cls(
            torch.cat([surface[:-3].T for surface in every]),
            torch.cat([surface[-3:-1] for surface in every], 1),
            *(origin, step, last, width, start),
        )


def nearby(table: SurfaceTable, asked: HiddenQueries, around: float = 0.0) -> tuple[Tensor, Tensor]:
    """The mean of the surfaces around each pixel at each level, weighted by distance.

    Only surfaces whose radius lies between the pixel's border and ceiling count. `around`: px in
    rows and in columns from the pixel to the four points that are averaged, or 0. Returns [L, n, K]
    values times weights, and [L, n] weights.
    """
    count = pieces(asked.at.device, _BYTES_OF_QUERY * len(table.origin))
    if len(asked.at) <= count:
        return _nearby(table, asked, around)
    numbers = torch.split(torch.arange(len(asked.at), device=asked.at.device), count)
    parts = [_nearby(table, asked.select(chunk), around) for chunk in numbers]
    values, weights = zip(*parts, strict=True)
    return torch.cat(values, 1), torch.cat(weights, 1)


def _nearby(table: SurfaceTable, asked: HiddenQueries, around: float) -> tuple[Tensor, Tensor]:
    """`nearby`, for all pixels at once."""
    border, ceiling = (x.detach()[None, :, None] for x in (asked.border, asked.ceiling))
    position = torch.addcmul(table.origin, table.step, asked.at.T.to(border.dtype))  # [L, 2, n]
    away = around * table.step if around else 0.0
    below = (position - away).floor_()[..., None]
    tap = below + torch.arange(3 if around else 2, device=below.device)  # [L, 2, n, t]
    offset = tap - position[..., None]
    if isinstance(away, Tensor):
        shares = [1 - (offset + sign * away[..., None]).abs_() for sign in (-1, 1)]
        share = (shares[0].clamp_(min=0) + shares[1].clamp_(min=0)) / 2
    else:
        share = 1 - offset.abs_()
    inside = torch.minimum(tap.clamp(min=0), table.last[..., None])
    share = share * (inside == tap)
    row, column = inside.long().unbind(1)  # [L, n, t]
    row = row * table.width + table.start
    number = (row[..., None] + column[..., None, :]).flatten(2)
    share = (share[:, 0, :, :, None] * share[:, 1, :, None]).flatten(2)  # [L, n, t * t]
    number = torch.cat([number, number + len(table.values) // 2], 2)
    share = torch.cat([share, share], 2)
    weight, minimum = table.limits.index_select(1, number.flatten()).view(2, *number.shape)
    minimum = minimum.detach()
    weight = share * weight * ((minimum > border) & (minimum < ceiling))
    bags = number.flatten(0, 1), table.values, weight.flatten(0, 1)
    values = embedding_bag(*bags[:2], mode="sum", per_sample_weights=bags[2])
    weight = weight.sum(2)
    maximum = weight.clamp(min=1)
    return values.view(*weight.shape, -1) / maximum[..., None], weight / maximum

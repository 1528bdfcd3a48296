"""The pyramid of the whole frame, from which hidden surfaces are continued.

A surface behind a depth edge is continued from pictures of a quarter of the resolution and less.
These pictures, and the map of the reach of each edge, are computed once for the whole frame.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.matting import MixedPixels, mixed_pixels, no_pixels
from defocus_core.renderer.inpainting.coherence_transport import structure
from defocus_core.renderer.inpainting.disocclusion import (
    EDGE,
    Reach,
    coarse_edges,
    grain_of,
    reach_of,
)
from defocus_core.renderer.inpainting.two_layer_pyramid import (
    PyramidLevel,
    SurfaceTable,
    coarser,
    pixels_of,
    stacked,
)
from defocus_core.renderer.layers.layer import layers_of, mixed_within
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import launches_cost, pieces, sent
from defocus_core.tensors.neighbourhoods import exceeding, positions_of, range_of
from defocus_core.tensors.pyramid import Axis, AxisHalving, axes, halves
from defocus_core.tensors.threads import threaded

# Share of a pixel below which what is left of its far surface is rounding.
_ROUNDED = 1.013e-3
# Bytes that a pixel takes while it is made coarser; rows of quarter resolution around a band that
# it depends on.
_BYTES_EACH, _AROUND = 120, 3
# Resolutions, a quarter and less, that decide the direction of lines together.
_DIRECTIONS = 3
# The last level has coarse pixels this many times as wide as the range of radii; no round number,
# so that rounding decides nothing.
_WIDER = 1.99


class Backdrop(NamedTuple):
    """A frame at low resolution."""

    half: PyramidLevel  # at half of the resolution: colour, and radius in px
    adjacent: SurfaceTable  # the same, as it is looked up
    # At a quarter of it, an eighth, and so on: these, and the structure tensor. Levels that decide
    # directions are looked up together, and so are all others where an operation takes long to
    # begin
    levels: list[SurfaceTable]
    reach: Reach  # the reach of its depth edges
    fine: tuple[Axis, Axis]  # where the middle of the frame is at full resolution
    size: tuple[int, int]  # (height, width) in px
    mixed: MixedPixels  # those of the frame, taken apart


def backdrop_of(
    pixels: Tensor,  # [C, H, W] linear
    signed_radius: Tensor,  # [H, W] px
    limit: float = math.inf,
    dtype: torch.dtype | None = None,  # type to compute in; None for the type of the pixels
    threads: int = 1,
    limits: tuple[float, float] | None = None,  # least and greatest radius in px; None to find them
    *,
    unmixes: bool = True,
    matte: Tensor | None = None,  # [H, W], the coverage of a subject; None if it is not known
) -> Backdrop:
    """The pyramid of a frame, the reach of its edges, and its mixed pixels taken apart."""
    H, W = signed_radius.shape[-2:]
    dtype = dtype or pixels.dtype
    minimum, maximum = limits or _limits_of(signed_radius)
    grain = grain_of(minimum, maximum)
    fine = axes((H, W))
    half = halves(H, fine[0])
    quarter = halves(half.length, half.axis)

    def band_of(rows: tuple[int, int]) -> _Band:
        """The rows [first, end) of the level."""
        first, last = (row - quarter.axis.middle for row in rows)
        top = max(0, fine[0].middle + 4 * (first - _AROUND))
        below = min(H, fine[0].middle + 4 * (last + _AROUND) + fine[0].odd)
        box = Box(top, 0, below - top, W)
        color, radius = (box.crop(x).to(dtype) for x in (pixels, signed_radius))
        coverage = None if matte is None else box.crop(matte).to(radius)
        mixed = mixed_pixels(color, radius, limit, coverage) if unmixes else no_pixels(color)
        halved, edges = _halved(color, radius, limit, grain, axes((H, W), top), mixed)
        level, halved_rows = coarser(structure(halved)), halved.middle[0].middle
        is_first, is_last = rows[0] == 0, rows[1] == quarter.length
        start = 0 if is_first else 2 * first + halved_rows
        end = edges.shape[-2] if is_last else 2 * last + halved_rows
        if not (is_first and is_last):
            own = Box(0, 0, H, W) if is_first else Box(fine[0].middle + 4 * first, 0, H, W)
            own = own if is_last else own._replace(height=fine[0].middle + 4 * last - own.top)
            mixed = mixed_within(mixed, own.seen_from(box))
            mixed = mixed._replace(at=mixed.at + sent([own.top, 0], mixed.at))
        middle = level.middle[0].middle
        in_level = level, first + middle, last + middle
        return _Band((halved, start, end), in_level, edges[..., start:end, :], mixed)

    rows = max(1, pieces(signed_radius.device, _BYTES_EACH) // (W << 2))
    cuts = [*range(0, quarter.length, rows), quarter.length]
    bands = list(threaded(band_of, list(pairwise(cuts)), threads))
    half_level, level, edges, mixed = _put_together(bands, half, quarter)
    levels = [level]
    while max(levels[-1].size) > 1 and 1 << levels[-1].level < _WIDER * (maximum - minimum):
        levels.append(coarser(levels[-1]))
    reach = reach_of(edges, grain, maximum - minimum, fine)
    rest = levels[_DIRECTIONS:]
    groups = [levels[:_DIRECTIONS], *([rest] if launches_cost(edges.device) else zip(rest))]
    tables = [SurfaceTable.from_levels(group, fine) for group in groups if group]
    adjacent = SurfaceTable.from_levels([half_level], fine)
    return Backdrop(half_level, adjacent, tables, reach, fine, (H, W), mixed)


def _put_together(
    bands: list[_Band], half: AxisHalving, quarter: AxisHalving
) -> tuple[PyramidLevel, PyramidLevel, Tensor, MixedPixels]:
    """The levels of half and of quarter resolution, the coarse edges and mixed pixels of bands."""
    first = bands[0]
    if len(bands) == 1:
        return first.half[0], first.quarter[0], first.edges, first.mixed
    half_level = stacked((band.half for band in bands), half.length, half.axis)
    level = stacked((band.quarter for band in bands), quarter.length, quarter.axis)
    edges = torch.cat([band.edges for band in bands])
    return half_level, level, edges, MixedPixels.concatenate([band.mixed for band in bands])


def _limits_of(signed_radius: Tensor) -> tuple[float, float]:
    """The least and the greatest radius in px."""
    minimum, maximum = range_of(signed_radius.detach()).tolist()
    return minimum, maximum


class _Band(NamedTuple):
    """A band of rows of a frame."""

    # The levels of half and of quarter resolution, with rows around; the first of its rows in
    # each, and the one after the last
    half: tuple[PyramidLevel, int, int]
    quarter: tuple[PyramidLevel, int, int]
    edges: Tensor  # [h, w], from `coarse_edges`, of the rows alone
    mixed: MixedPixels  # those of its rows


def _halved(
    pixels: Tensor,
    signed_radius: Tensor,
    limit: float,
    grain: float,
    middle: tuple[Axis, Axis],
    mixed: MixedPixels,
) -> tuple[PyramidLevel, Tensor]:
    """The level of half resolution, and its edges."""
    r = signed_radius.detach()
    farther = _beside_edges(r)
    own, *nearer = layers_of(pixels, signed_radius, mixed)
    weight = exceeding(own.color.detach().amax(0), limit).logical_not_().to(r.dtype)
    for layer in nearer:
        weight = weight * (1 - layer.covered)
    if nearer:
        weight = torch.where(weight < _ROUNDED, 0.0, weight)
    half = coarser(pixels_of([own.color, signed_radius[None]], signed_radius, middle, weight))
    return half, coarse_edges(r, farther, grain, middle)


def _beside_edges(r: Tensor) -> Tensor:
    """The numbers of the farther pixels at edges of radii [H, W] px."""
    numbers = []
    W = r.shape[-1]
    for dim, stride in ((-2, W), (-1, 1)):
        step = r.diff(dim=dim)
        row, column = positions_of(exceeding(step.abs(), EDGE)).unbind(1)
        rises = step.flatten().index_select(0, row * step.shape[-1] + column) > 0
        numbers.append(row * W + column + stride * rises)
    return torch.cat(numbers)

"""The pyramid of the whole frame, from which hidden surfaces are continued.

A surface behind a depth edge is continued from pictures of a quarter of the resolution and less.
These pictures, and the map of the reach of each edge, are computed once for the whole frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.matting import Unmixed, unmixed
from defocus_core.renderer.inpainting.coherence_transport import structure
from defocus_core.renderer.inpainting.disocclusion import Reach, coarse_edges, grain_of, reach_of
from defocus_core.renderer.inpainting.two_layer_pyramid import (
    PyramidLevel,
    coarser,
    pixels_of,
    stacked,
)
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import pieces
from defocus_core.tensors.neighbourhoods import range_of, ranges_of
from defocus_core.tensors.pyramid import Axis, axes, halves
from defocus_core.tensors.source import Pixels, banded
from defocus_core.tensors.sparse_masks import exceeding, positions_of
from defocus_core.tensors.threads import threaded

# Edges of radius, in px per pixel, above which one surface hides another.
EDGE = 1.013
# Weight of a pixel beside a nearer one: it may be a mixture of both.
_MIXED = 0.25
# Bytes that a pixel takes while it is made coarser; rows of quarter resolution around a band that
# it depends on.
_BYTES_EACH, _AROUND = 120, 3
# The last level has coarse pixels this many times as wide as the range of radii; no round number,
# so that rounding decides nothing.
_WIDER = 1.99


class Backdrop(NamedTuple):
    """A frame at low resolution."""

    # At a quarter of the resolution, an eighth, and so on: colour, radius in px, and the
    # structure tensor
    levels: list[PyramidLevel]
    reach: Reach  # the reach of its depth edges
    fine: tuple[Axis, Axis]  # where the middle of the frame is at full resolution
    # [B] px, the range of the radii of each picture of a batch; None if there is one
    spans: Tensor | None = None

    def is_of(self, level: PyramidLevel, of: Tensor | None) -> Tensor | None:
        """Whether pixels [n] of pictures have a level; None if all have."""
        if self.spans is None or of is None:
            return None
        return (_WIDER * self.spans > 1 << (level.level - 1)).index_select(0, of)


def backdrop_of(
    pixels: Pixels,  # [C, H, W] linear, or [C, B, H, W] of a batch
    signed_radius: Pixels,  # [H, W] px, or [B, H, W]
    limit: float = math.inf,
    dtype: torch.dtype | None = None,  # type to compute in; None for the type of the pixels
    threads: int = 1,
    limits: tuple[float, float] | None = None,  # least and greatest radius in px; None to find them
    *,
    unmixes: bool = True,
    shown: Unmixed | None = None,
) -> Backdrop:
    """The pyramid of a frame, and the reach of its edges.

    `shown`: the frame with mixed pixels taken apart, where that is done at once; None to do it.
    """
    H, W = signed_radius.shape[-2:]
    device = signed_radius.device
    dtype = dtype or pixels.dtype
    if limits is None:
        band_ranges = torch.stack([range_of(b) for b in banded(signed_radius)])
        limits = (float(band_ranges.amin()), float(band_ranges.amax()))
    minimum, maximum = limits
    grain = grain_of(minimum, maximum)
    fine = axes((H, W))
    half = halves(H, fine[0])
    quarter = halves(half.length, half.axis)

    def band_of(rows: tuple[int, int]) -> tuple[PyramidLevel, Tensor, int, int]:
        """The level and the edges of a band of rows [first, end), and these rows in the level."""
        first, last = (row - quarter.axis.middle for row in rows)
        top = max(0, fine[0].middle + 4 * (first - _AROUND))
        below = min(H, fine[0].middle + 4 * (last + _AROUND) + fine[0].odd)
        band = Box(top, 0, below - top, W)
        level, edges, halved_rows = _coarsely(
            band.of(pixels).to(dtype),
            band.of(signed_radius).to(dtype),
            limit,
            grain,
            axes((H, W), top),
            unmixes=unmixes,
            shown=shown,
        )
        start = 0 if rows[0] == 0 else 2 * first + halved_rows
        end = edges.shape[-2] if rows[1] == quarter.length else 2 * last + halved_rows
        middle = level.middle[0].middle
        return level, edges[..., start:end, :], first + middle, last + middle

    batch, rows = len(signed_radius.shape) > 2, max(1, pieces(device, _BYTES_EACH) // (W << 2))
    if batch or shown is not None or rows >= quarter.length:
        level, edges, _, _ = band_of((0, quarter.length))
    else:
        edges = torch.empty(
            half.length, halves(W, fine[1]).length, dtype=torch.int32, device=device
        )
        cuts = [*range(0, quarter.length, rows), quarter.length]
        bands = threaded(band_of, list(pairwise(cuts)), threads)
        level = stacked(_with_edges(bands, edges), quarter.length, quarter.axis)
    levels = [level]
    while max(levels[-1].size) > 1 and 1 << levels[-1].level < _WIDER * (maximum - minimum):
        levels.append(coarser(levels[-1]))
    spans = ranges_of(signed_radius[:].detach()).diff(dim=-1)[..., 0] if batch else None
    return Backdrop(levels, reach_of(edges, grain, maximum - minimum, fine), fine, spans)


def _with_edges(
    bands: Iterable[tuple[PyramidLevel, Tensor, int, int]], edges: Tensor
) -> Iterator[tuple[PyramidLevel, int, int]]:
    """The levels of bands, and their rows; edges of all [h, w] are filled with those of each."""
    done = 0
    for level, band_edges, first, end in bands:
        edges[done : done + len(band_edges)] = band_edges
        done += len(band_edges)
        yield level, first, end


def _coarsely(
    pixels: Tensor,
    signed_radius: Tensor,
    limit: float,
    grain: float,
    middle: tuple[Axis, Axis],
    *,
    unmixes: bool,
    shown: Unmixed | None = None,
) -> tuple[PyramidLevel, Tensor, int]:
    """The level of quarter resolution; edges at half resolution, and the middle row in these."""
    r = signed_radius.detach()
    farther = _beside_edges(r)
    weight = exceeding(pixels.detach().amax(0), limit).logical_not_().to(r.dtype)
    weight.flatten()[farther] *= _MIXED
    if unmixes:
        pixels, _, fringe = shown or unmixed(pixels, signed_radius, limit)
        index = fringe.at[:, 0] * r.shape[-1] + fringe.at[:, 1]
        weights = weight.flatten()
        of_farther = weights.index_select(0, index) * (1 - fringe.layer[:, -1])
        weight = weights.index_copy(0, index, of_farther).view_as(weight)
    half = coarser(pixels_of([pixels, signed_radius[None]], signed_radius, middle, weight))
    edges = coarse_edges(r, farther, grain, middle)
    return coarser(structure(half)), edges, half.middle[0].middle


def _beside_edges(r: Tensor) -> Tensor:
    """The numbers of the farther pixels at edges of radii [..., H, W] px."""
    numbers = []
    H, W = r.shape[-2:]
    for dim, stride in ((-2, W), (-1, 1)):
        step = r.diff(dim=dim)
        row, column = positions_of(exceeding(step.abs(), EDGE)).unbind(1)
        rises = step.flatten().index_select(0, row * step.shape[-1] + column) > 0
        if r.dim() > 2 and dim == -2:  # a picture has a row of steps less
            row = row + row.div(max(H - 1, 1), rounding_mode="floor")
        numbers.append(row * W + column + stride * rises)
    return torch.cat(numbers)

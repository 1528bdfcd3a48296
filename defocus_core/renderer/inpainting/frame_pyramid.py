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
from defocus_core.renderer.inpainting.disocclusion import Reach, coarse_edges, grain_of, reach_of
from defocus_core.renderer.inpainting.two_layer_pyramid import (
    PyramidLevel,
    coarser,
    pixels_of,
    stacked,
)
from defocus_core.renderer.layers.layer import layers_of, mixed_within
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import pieces, sent
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
    size: tuple[int, int]  # (height, width) in px
    mixed: MixedPixels  # those of the frame, taken apart
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
    matte: Pixels | None = None,  # [H, W], the coverage of a subject; None if it is not known
) -> Backdrop:
    """The pyramid of a frame, the reach of its edges, and its mixed pixels taken apart."""
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

    def band_of(rows: tuple[int, int]) -> _Band:
        """The rows [first, end) of the level."""
        first, last = (row - quarter.axis.middle for row in rows)
        top = max(0, fine[0].middle + 4 * (first - _AROUND))
        below = min(H, fine[0].middle + 4 * (last + _AROUND) + fine[0].odd)
        box = Box(top, 0, below - top, W)
        color, radius = (box.of(x).to(dtype) for x in (pixels, signed_radius))
        coverage = None if matte is None else box.of(matte).to(radius)
        mixed = mixed_pixels(color, radius, limit, coverage) if unmixes else no_pixels(color)
        level, edges, halved_rows = _coarsely(color, radius, limit, grain, axes((H, W), top), mixed)
        is_first, is_last = rows[0] == 0, rows[1] == quarter.length
        start = 0 if is_first else 2 * first + halved_rows
        end = edges.shape[-2] if is_last else 2 * last + halved_rows
        if not (is_first and is_last):
            own = Box(0, 0, H, W) if is_first else Box(fine[0].middle + 4 * first, 0, H, W)
            own = own if is_last else own._replace(height=fine[0].middle + 4 * last - own.top)
            mixed = mixed_within(mixed, own.seen_from(box), below - top)
            mixed = mixed._replace(at=mixed.at + sent([own.top, 0], mixed.at))
        middle = level.middle[0].middle
        return _Band(level, edges[..., start:end, :], first + middle, last + middle, mixed)

    batch, rows = len(signed_radius.shape) > 2, max(1, pieces(device, _BYTES_EACH) // (W << 2))
    rows = quarter.length if batch else rows
    cuts = [*range(0, quarter.length, rows), quarter.length]
    bands = list(threaded(band_of, list(pairwise(cuts)), threads))
    level, edges, mixed = bands[0].level, bands[0].edges, bands[0].mixed
    if len(bands) > 1:
        level = stacked(((b.level, b.first, b.end) for b in bands), quarter.length, quarter.axis)
        edges = torch.cat([band.edges for band in bands])
        mixed = MixedPixels.joined([band.mixed for band in bands])
    del bands
    levels = [level]
    while max(levels[-1].size) > 1 and 1 << levels[-1].level < _WIDER * (maximum - minimum):
        levels.append(coarser(levels[-1]))
    spans = ranges_of(signed_radius[:].detach()).diff(dim=-1)[..., 0] if batch else None
    reach = reach_of(edges, grain, maximum - minimum, fine)
    return Backdrop(levels, reach, fine, (H, W), mixed, spans)


class _Band(NamedTuple):
    """A band of rows of a frame."""

    level: PyramidLevel  # of quarter resolution, with rows around
    edges: Tensor  # [..., h, w], from `coarse_edges`, of the rows alone
    first: int  # the first of its rows in the level
    end: int  # the one after the last
    mixed: MixedPixels  # those of its rows


def _coarsely(
    pixels: Tensor,
    signed_radius: Tensor,
    limit: float,
    grain: float,
    middle: tuple[Axis, Axis],
    mixed: MixedPixels,
) -> tuple[PyramidLevel, Tensor, int]:
    """The level of quarter resolution; edges at half resolution, and the middle row in these."""
    r = signed_radius.detach()
    farther = _beside_edges(r)
    weight = exceeding(pixels.detach().amax(0), limit).logical_not_().to(r.dtype)
    weight.flatten()[farther] *= _MIXED
    own, *nearer = layers_of(pixels, signed_radius, mixed)
    for layer in nearer:
        weight = weight * (1 - layer.covered)
    half = coarser(pixels_of([own.color, signed_radius[None]], signed_radius, middle, weight))
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

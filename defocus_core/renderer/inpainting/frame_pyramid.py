"""The pyramid of the whole frame, from which hidden surfaces are continued.

A surface behind a depth edge is continued from pictures of reduced resolution. These, and a map of
how far behind each edge the aperture sees, are computed once for the whole frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.matting import MixedPixels, mixed_pixels, no_pixels
from defocus_core.renderer.engine.limits import DIRECTIONS, ROUNDED, WIDER
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
)
from defocus_core.renderer.layers.layer import layers_of
from defocus_core.tensors.neighbourhoods import exceeding, positions_of, range_of
from defocus_core.tensors.pyramid import Axis, axes


class Backdrop(NamedTuple):
    """A frame at reduced resolutions, and its depth edges, from which hidden surfaces are made."""

    half: PyramidLevel  # at half of the resolution: colour, and radius in px
    adjacent: SurfaceTable  # the same as a table for look-ups
    # Colour, radius and structure tensor at a quarter of the resolution, an eighth, and so on: a
    # table of the levels that decide directions, and another one of all other levels
    tables: list[SurfaceTable]
    reach: Reach  # the reach of its depth edges
    fine: tuple[Axis, Axis]  # where the middle of the frame is at full resolution
    size: tuple[int, int]  # (height, width) in px
    mixed: MixedPixels  # mixed pixels of the frame, split in two


def backdrop_of(
    pixels: Tensor,  # [C, H, W] linear
    signed_radius: Tensor,  # [H, W] px
    limit: float = math.inf,
    dtype: torch.dtype | None = None,
    limits: tuple[float, float] | None = None,
    *,
    unmixes: bool = True,
    matte: Tensor | None = None,  # [H, W]
) -> Backdrop:
    """The pyramid of a frame, the reach of its edges, and its mixed pixels.

    `limit`: brightness above which a pixel is a highlight, which is not continued; `dtype`: to
    compute in, None for that of the pixels; `limits`: least and greatest radius in px, None to find
    them; `unmixes`: whether mixed pixels are split into two surfaces.
    """
    H, W = signed_radius.shape[-2:]
    dtype = dtype or pixels.dtype
    minimum, maximum = limits or range_of(signed_radius.detach()).tolist()
    grain = grain_of(minimum, maximum)
    fine = axes((H, W))
    color, radius = pixels.to(dtype), signed_radius.to(dtype)
    coverage = None if matte is None else matte.to(radius)
    mixed = mixed_pixels(color, radius, limit, coverage) if unmixes else no_pixels(color)
    half = _half(color, radius, limit, fine, mixed)
    levels = [coarser(structure(half))]
    while max(levels[-1].size) > 1 and 1 << levels[-1].level < WIDER * (maximum - minimum):
        levels.append(coarser(levels[-1]))
    groups = levels[:DIRECTIONS], levels[DIRECTIONS:]
    tables = [SurfaceTable.from_levels(group, fine) for group in groups if group]
    adjacent = SurfaceTable.from_levels([half], fine)
    edges = coarse_edges(radius.detach(), _beside_edges(radius.detach()), grain, fine)
    reach = reach_of(edges, grain, maximum - minimum, fine)
    return Backdrop(half, adjacent, tables, reach, fine, (H, W), mixed)


def _half(
    pixels: Tensor,
    signed_radius: Tensor,
    limit: float,
    middle: tuple[Axis, Axis],
    mixed: MixedPixels,
) -> PyramidLevel:
    """The level of half resolution, without highlights and nearer surfaces of mixed pixels."""
    own, *nearer = layers_of(pixels, signed_radius, mixed)
    weight = exceeding(own.color.detach().amax(0), limit).logical_not_().to(signed_radius.dtype)
    for layer in nearer:
        weight = weight * (1 - layer.covered)
    if nearer:
        weight = torch.where(weight < ROUNDED, 0.0, weight)
    return coarser(pixels_of([own.color, signed_radius[None]], signed_radius, middle, weight))


def _beside_edges(r: Tensor) -> Tensor:
    """Flat indices of the pixels on the farther side of edges of the radii `r` [H, W] px."""
    numbers = []
    W = r.shape[-1]
    for dim, stride in ((-2, W), (-1, 1)):
        step = r.diff(dim=dim)
        row, column = positions_of(exceeding(step.abs(), EDGE)).unbind(1)
        rises = step.flatten().index_select(0, row * step.shape[-1] + column) > 0
        numbers.append(row * W + column + stride * rises)
    return torch.cat(numbers)

"""Preparation of a picture: its slices, transform windows, tiles and regions."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import Counter
from functools import lru_cache, partial
from itertools import accumulate, pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.blur.kernel_bank import (
    Slicing,
    Spread,
    reach,
    spreads_of,
    transform_windows,
)
from defocus_core.renderer.compositing.highlights import reached_by
from defocus_core.renderer.engine.frame import NEIGHBOURHOOD, Content, Division, SharedFrame, Slices
from defocus_core.renderer.engine.settings import Quality, Settings
from defocus_core.renderer.engine.survey import Survey, border_range, highlight_limit, needs_double
from defocus_core.renderer.inpainting.disocclusion import EDGE, PX_AROUND
from defocus_core.renderer.layers.alpha import Alpha
from defocus_core.renderer.layers.samples import Layered
from defocus_core.renderer.layers.slice_radii import (
    SHARP,
    composite_order,
    even_radii,
    layer_numbers,
    octaves,
    slice_radii,
)
from defocus_core.tensors.box import BLOCK, Grid, few_tiles, grid_over, largest, regions
from defocus_core.tensors.device_plan import launches_cost, pieces, tile_pixels

# The scene is continued beyond the frame by the reach of its light, but by no more px than this or
# the side of the frame.
_BEYOND = 64
_ANY_PX = 1 << 30  # no picture is larger
# Pictures that a region holds for all of its tiles.
_COPIES_OF_REGION = 6


def frame_of(
    pixels: Tensor,  # [C, H, W]
    signed_radius: Tensor,  # [H, W] px, repaired
    settings: Settings,
    quality: Quality,  # settings of the quality
    content: Content,
    *,
    layered: Layered | None = None,
    border: tuple[float, float] | None = None,
) -> SharedFrame:
    """The data that all regions of a picture share, such as its slices and tiles.

    `border`: least and greatest signed radius on the edge of the frame; None for those of
    `signed_radius`.
    """
    size = signed_radius.shape[-2], signed_radius.shape[-1]
    limits = content.limits if layered is None else layered.limits
    radii = _slice_radii(*limits, quality, settings)
    layer_indices = layer_numbers(radii, quality)
    exact = settings.num_layers is not None
    stride = 1 if exact else quality.hidden_stride
    level = quality.hidden_level if content.edges and not exact else 0
    border = border or border_range(signed_radius)
    inwards = 0  # reach in px of light from beyond the frame into it
    if exact or max(map(abs, border)) > SHARP:
        for halvings, step in [(0, 1), (level, stride)] if content.edges else [(0, 1)]:
            unbounded = _at_resolution(radii, quality, _ANY_PX, halvings).reaches
            inwards = max(inwards, _reach_of(border, radii, unbounded, step))
    # whole blocks, so that those of the frame stay where they are
    rows, columns = (-(-min(inwards, max(n, _BEYOND)) // BLOCK) * BLOCK for n in size)
    maximum = max(size[0] + rows, size[1] + columns) - 1
    fine = _at_resolution(radii, quality, maximum, 0)
    coarse = _at_resolution(radii, quality, maximum, level)
    farthest = max(fine.reaches + coarse.reaches if content.edges else fine.reaches)
    margin = _margin(farthest, edges=content.edges, highlights=content.highlights)
    dtype = torch.float64 if content.double else computed_in(pixels, signed_radius)
    sample = (pixels.shape[0] + 1 + (layered is not None)) * dtype.itemsize

    def tiled(division: Division) -> tuple[Grid, Slices]:
        """The tiles, and the slices with their blur, for a division of the aperture."""
        each = sample * len(division.parts)
        grid = _grid_of(settings, size, pixels.device, layer_indices, each)
        like = pixels.new_empty(0, dtype=dtype.to_complex())
        slicing = partial(_slicing, radii, grid, largest(regions(grid, margin)), division, like)
        of_hidden = octaves(radii)
        return grid, Slices(
            composite_order(radii, layer_indices),
            of_hidden,
            visible=slicing(fine, layer_indices, 1),
            invented=slicing(coarse, _hidden_layers(of_hidden, coarse.spreads), stride),
        )

    return SharedFrame(
        size=size,
        settings=settings,
        quality=quality,
        dtype=dtype,
        beyond=(rows, columns),
        cut=inwards > min(rows, columns),
        farthest=farthest,
        margin=margin,
        content=content,
        radii=radii,
        tiled=tiled,
    )


def copies_of_tile(layer_of: list[int]) -> int:
    """The number of pictures of a tile held at once, given the layer number of each slice.

    These are blurred layers, the slices of one layer with their transforms, and the inputs.
    """
    layers = Counter(layer_of)
    return len(layers) + 4 * max(layers.values()) + 10


def _grid_of(
    settings: Settings,
    size: tuple[int, int],
    device: torch.device,
    layer_of: list[int],
    bytes_each: int,
) -> Grid:
    """The tiles of a frame of `size` (height, width) px.

    `layer_of`: for each slice the number of its layer; `bytes_each`: bytes of a pixel in all parts
    of the aperture.
    """
    if not launches_cost(device):
        return grid_over(*size) if settings.tile is None else grid_over(*size, settings.tile)
    maximum = tile_pixels(device, bytes_each * copies_of_tile(layer_of))
    sides = settings.tile or few_tiles(*size, maximum)
    region = math.isqrt(pieces(device, _COPIES_OF_REGION * bytes_each, 0))
    return grid_over(*size, sides)._replace(region=region)


class _Resolution(NamedTuple):
    """How the slices of a frame are blurred if its resolution is first halved `level` times."""

    level: int  # how many times the resolution of the frame is halved
    spreads: list[Spread]  # the spread of each slice, in coarse pixels of this resolution
    reaches: list[int]  # for each slice the greatest reach of its light in px of the frame


def computed_in(pixels: Tensor, signed_radius: Tensor) -> torch.dtype:
    """The dtype to compute in, unless float64 is needed: that of the inputs, at least float32."""
    given = torch.promote_types(pixels.dtype, signed_radius.dtype)
    return torch.promote_types(given, torch.float32)


def content_of(survey: Survey, quality: Quality, *, layered: Layered | None = None) -> Content:
    """The properties of a picture, from its survey."""
    limit = highlight_limit(survey)
    return Content(
        limits=(survey.minimum, survey.maximum),
        edges=layered is not None or max(survey.steepest) > EDGE,
        tilted=survey.steepest[0] ** 2 + survey.steepest[1] ** 2 > quality.min_slope**2,
        minimum=min(survey.darkest, 0.0),
        channels=survey.channels if layered is None else (),
        limit=limit,
        highlights=survey.brightest > limit,
        double=needs_double(survey, limit),
        alpha=Alpha.NONE if layered is None else layered.alpha,
        open=layered is not None and layered.open,
    )


def _hidden_layers(of_hidden: list[int], spreads: list[Spread]) -> list[int]:
    """For each hidden slice the number of its layer.

    Slices of an octave that are blurred in the same way share a layer. `of_hidden`: for each slice
    its octave.
    """
    pairs = zip(of_hidden, spreads, strict=True)
    kinds = [(octave, spread.level, spread.coarse == 0) for octave, spread in pairs]
    return list(accumulate((kind != before for before, kind in pairwise(kinds)), initial=0))


def _slicing(
    radii: tuple[float, ...],
    grid: Grid,
    region: tuple[int, int],  # greatest (height, width) in px
    division: Division,
    like: Tensor,
    resolution: _Resolution,
    layer_of: list[int],
    stride: int,
) -> Slicing:
    """How the slices of a surface are blurred at a resolution."""
    level, spreads, _ = resolution
    scaled = tuple(r / (1 << level) for r in radii)
    side, region = (_halved(size, level) for size in (grid.tiles[0][2:], region))
    opening = division.aperture, division.parts
    windows = transform_windows(scaled, spreads, layer_of, side, region, *opening, like, stride)
    reached = [spread.px for spread in spreads]
    return Slicing(stride, level, windows, layer_of, reached)


@lru_cache(maxsize=256)
def _at_resolution(
    radii: tuple[float, ...], quality: Quality, maximum: int, level: int
) -> _Resolution:
    """The slices at a resolution halved `level` times; reaches are at most `maximum` px."""
    step = 1 << level
    scaled = tuple(r / step for r in radii)
    layer_indices = layer_numbers(radii, quality)
    spreads = spreads_of(scaled, layer_indices, quality.full_resolution / step, -(-maximum // step))
    reaches = [spread.px for spread in spreads]
    if level:  # a pixel has shares in coarse pixels beside it, and is read between two
        reaches = [min((px + 2) * step - 1, maximum) for px in reaches]
    return _Resolution(level, spreads, reaches)


def _reach_of(
    limits: tuple[float, float], radii: tuple[float, ...], reaches: list[int], stride: int
) -> int:
    """The greatest reach in px of light from surfaces with radii within `limits`.

    `reaches`: for each slice the reach of its light in px; `stride`: 2 to use every other slice.
    """
    first, last = sorted(
        (max(bisect_right(radii, limits[0]) - 1, 0), bisect_left(radii, limits[1]))
    )
    return max(reaches[::stride][first // stride : -(-last // stride) + 1])


def _margin(farthest: int, *, edges: bool, highlights: bool) -> int:
    """The width in px of the border around a region on which its pixels depend.

    It is even, as regions are halved. `farthest`: greatest reach of light in px.
    """
    farthest += farthest % 2
    margin = NEIGHBOURHOOD + farthest + (PX_AROUND if edges else 0)
    if highlights:
        margin = max(margin, reached_by(farthest))
    return margin + margin % 2


def _halved(size: tuple[int, int], level: int) -> tuple[int, int]:
    """The (height, width) of a tile or region in coarse pixels, after `level` halvings."""
    # pixels lie between coarse pixels, and may begin in the middle of one
    more = 3 if level else 0
    return (size[0] >> level) + more, (size[1] >> level) + more


def _slice_radii(
    minimum: float, maximum: float, quality: Quality, settings: Settings
) -> tuple[float, ...]:
    """Slice radii in px over a range: `settings.num_layers` of them, or those of the quality.

    Raises ValueError if a kernel is larger than `settings.psf_ks`.
    """
    count, psf_ks = settings.num_layers, settings.psf_ks
    radii = (
        slice_radii(minimum, maximum, quality)
        if count is None
        else even_radii(minimum, maximum, count)
    )
    if psf_ks is None:
        return radii
    spread = max(abs(minimum), abs(maximum))
    needed = 2 * reach(spread, 1 << 30) + 1
    if needed > psf_ks:
        raise ValueError(
            f"psf_ks must be at least {needed} for a CoC radius of {spread:.2f} px, got {psf_ks}; "
            "leave it out to size kernels by the scene"
        )
    end = (psf_ks - 1) // 2 + 0.5
    return tuple(min(max(r, -end), end) for r in radii)

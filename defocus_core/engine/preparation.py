"""Preparation of a picture: its slices, their windows, its tiles and regions."""

from __future__ import annotations

import torch

from defocus_core.blur.fourier import reach
from defocus_core.blur.kernel_bank import Spread, Window, alike, spreads_of, windows
from defocus_core.compositing.highlights import reached_by, threshold
from defocus_core.engine.frame import NEIGHBOURHOOD, FillSlices, Frame
from defocus_core.engine.statistics import BRIGHTEST, Survey, survey
from defocus_core.images.source import Pixels, banded
from defocus_core.images.tiling import grid_over, largest, regions
from defocus_core.inpainting.frame_pyramid import EDGE
from defocus_core.inpainting.hidden_layers import PX_AROUND
from defocus_core.inpainting.known_layer import Behind
from defocus_core.layers.ladder import SHARP, evenly, layers, rungs
from defocus_core.layers.octaves import kept_apart, turns
from defocus_core.layers.quality import Quality
from defocus_core.optics.aperture import LEFT, RIGHT, Aperture, part_area, parts

# Brightness over the median, and by itself, beyond which float32 is not enough.
_RANGE, _SQUARED = 1e3, 1e15


def frame_of(
    pixels: Pixels,
    signed_radius: Pixels,
    *,
    aperture: Aperture,
    quality: Quality,
    left_right: bool,
    num_layers: int | None,
    psf_ks: int | None,
    hidden: Behind | None,
    threads: int,
    tile: int | None = None,
    quantised: bool = False,
) -> Frame:
    """Look at a picture as a whole; the arguments are those of `render`, for one picture.

    Its radii are repaired; `quantised` says that they had few levels.

    Raises:
        ValueError: If a value is not finite, or a CoC does not fit psf_ks.
    """
    H, W = signed_radius.shape
    cells = parts(aperture, quality.parts)
    centre = len(cells)
    groups = [slice(0, centre)]
    if left_right and centre == 1:
        cells = [*cells, LEFT, RIGHT]
        groups.append(slice(1, 3))
    dtype = torch.promote_types(torch.promote_types(pixels.dtype, signed_radius.dtype), torch.float)
    seen = survey(pixels, signed_radius, dtype, threads)
    least, most = seen.least, seen.most
    if hidden is not None:
        least, most = _with_hidden(hidden, least, most)
    radii = _slice_radii(least, most, quality, num_layers, psf_ks)
    numbers = layers(radii, quality)
    limit = threshold(seen.brightness, seen.brightest)
    dtype = torch.float64 if _needs_double(seen, limit) else dtype
    grid = grid_over(H, W) if tile is None else grid_over(H, W, tile)
    edges = max(seen.steepest) > EDGE
    halvings = 0 if num_layers or not edges else quality.hidden_halvings
    spreads = _spreads(radii, numbers, quality, (H, W), 0)
    coarse = _spreads(radii, numbers, quality, (H, W), halvings)
    reaches, of_coarse = [spread.px for spread in spreads], [spread.px for spread in coarse]
    if halvings:  # a pixel has shares in cells beside it, and is read between two
        most = max(H, W) - 1
        invented = [min((spread + 2) * (1 << halvings) - 1, most) for spread in of_coarse]
    else:
        invented = of_coarse
    farthest = max([*reaches, *(invented if edges else ())])
    farthest += farthest % 2
    margin = NEIGHBOURHOOD + farthest
    if edges:
        margin += PX_AROUND
    if seen.brightest > limit:
        margin = max(margin, reached_by(farthest))
    margin += margin % 2  # regions are halved
    within = largest(regions(grid, margin))
    side = grid.tiles[0].height, grid.tiles[0].width

    def halved(size: tuple[int, int], halvings: int) -> tuple[int, int]:
        """(height, width) of a tile or of a region after resolution is halved some times."""
        # pixels lie between cells, and may begin in the middle of one
        more = 3 if halvings else 0
        return (size[0] >> halvings) + more, (size[1] >> halvings) + more

    def windows_at(halvings: int, spreads: list[Spread], numbers: list[int]) -> list[Window]:
        """Windows of all slices after resolution is halved some times."""
        scaled = tuple(r / (1 << halvings) for r in radii)
        sizes = halved(side, halvings), halved(within, halvings)
        return windows(scaled, spreads, numbers, *sizes, aperture, cells, dtype, pixels.device)

    when = turns(radii, numbers)
    apart = kept_apart(radii, when.ahead)

    def filling(stride: int, halvings: int, spreads: list[Spread], px: list[int]) -> FillSlices:
        layers = alike(numbers, apart, spreads, halved(side, halvings))
        of_all = windows_at(halvings, spreads, layers)
        octave_of = dict(zip(layers, apart, strict=True))
        return FillSlices(stride, halvings, of_all, layers, octave_of, [s.px for s in spreads], px)

    stride = 1 if num_layers else quality.hidden_stride
    return Frame(
        size=(H, W),
        grid=grid,
        aperture=aperture,
        quality=quality,
        parts=cells,
        centre=centre,
        groups=groups,
        weights=[part_area(aperture, part) for part in cells],
        left_right=left_right,
        signed=seen.darkest < 0,
        dtype=dtype,
        limit=limit,
        radii=radii,
        reaches=reaches,
        layers=numbers,
        turns=when,
        windows=windows_at(0, spreads, numbers),
        known=filling(1, 0, spreads, reaches),
        invented=filling(stride, halvings, coarse, invented),
        edges=edges,
        quantised=quantised,
        tilted=seen.steepest[0] ** 2 + seen.steepest[1] ** 2 > quality.least_slope**2,
        margin=margin,
        sharp=None if num_layers else SHARP,
        ends=(seen.least, seen.most),
    )


def _spreads(
    radii: tuple[float, ...],
    numbers: list[int],
    quality: Quality,
    size: tuple[int, int],
    halvings: int,
) -> list[Spread]:
    """How slices are blurred, in cells of a resolution halved some times."""
    step = 1 << halvings
    scaled = tuple(r / step for r in radii)
    return spreads_of(scaled, numbers, quality.full_resolution / step, -(-(max(size) - 1) // step))


def _with_hidden(hidden: Behind, least: float, most: float) -> tuple[float, float]:
    """The least and greatest radius, of what is known to lie behind too.

    Raises:
        ValueError: If a value that is known is not finite.
    """
    for color, radius, mask in zip(*map(banded, hidden), strict=True):
        some = mask.bool()
        known = radius[some]
        for name, values in (("color", color[:, some]), ("signed_radius", known)):
            if not bool((values.abs() <= BRIGHTEST).all()):
                raise ValueError(
                    f"hidden.{name} must be finite and within ±{BRIGHTEST:g} where the mask is "
                    "true; leave unknown pixels out"
                )
        if len(known):
            least, most = min(least, float(known.min())), max(most, float(known.max()))
    return least, most


def _needs_double(seen: Survey, limit: float) -> bool:
    """Whether the rounding of float32 transforms, 1e-7 of the brightest, would show in the dark.

    What is brighter than the limit does not count: it is not transformed. Or whether squares of
    colours would be infinite.
    """
    bright = min(seen.brightest, limit)
    if max(bright, -seen.darkest) > _SQUARED:
        return True
    lit = seen.lit.total - seen.black
    if not lit:
        return False
    median = seen.black + (lit + 1) // 2
    low, high = seen.lit.about(median)
    if bright <= _RANGE * low or bright > _RANGE * high:
        return bright > _RANGE * high
    return bright > _RANGE * seen.lit.exactly(median)


def _slice_radii(
    least: float, most: float, quality: Quality, num_layers: int | None, psf_ks: int | None
) -> tuple[float, ...]:
    if num_layers is not None:
        radii = evenly(least, most, num_layers)
    else:
        radii = rungs(least, most, quality)
    if psf_ks is None:
        return radii
    spread = max(abs(least), abs(most))
    needed = 2 * reach(spread, 1 << 30) + 1
    if needed > psf_ks:
        raise ValueError(
            f"psf_ks must be at least {needed} for a CoC radius of {spread:.2f} px, got {psf_ks}; "
            "leave it out to size kernels by the scene"
        )
    end = (psf_ks - 1) // 2 + 0.5
    return tuple(min(max(r, -end), end) for r in radii)

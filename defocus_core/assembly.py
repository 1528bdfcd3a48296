"""The regions of a picture, computed one by one or at once, and put together."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count

import torch
from torch import Tensor

from defocus_core.backdrop import backdrop
from defocus_core.frame import Frame
from defocus_core.hidden import HiddenLayer
from defocus_core.ramps import AROUND, without_ramps
from defocus_core.recomputed import recomputed
from defocus_core.region import Region
from defocus_core.survey import bands
from defocus_core.threads import threaded
from defocus_core.tiling import Box, Grid, regions


def assembled(
    frame: Frame,
    pixels: Tensor,
    signed_radius: Tensor,
    *,
    hidden: HiddenLayer | None,
    threads: int,
    progress: Callable[[int, int], None] | None,
) -> tuple[Tensor, Tensor, dict[str, int]]:
    """Images, trust, and counts of the work done.

    The images are the centre, or centre, left and right: [1 or 3, C, H, W]; trust is [1, 1, H, W].

    Args:
        frame: What holds for the whole picture.
        pixels: [C, H, W], in any precision; the result has the same.
        signed_radius: [H, W] px.
        hidden: What is known behind the visible surface.
        threads: As for `render`.
        progress: As for `render`.
    """
    beyond = None
    if frame.edges:
        signed_radius = without_ramps_in_bands(signed_radius, threads)
        beyond = backdrop(pixels, signed_radius, frame.limit, frame.dtype, threads)
    rows = regions(frame.grid, frame.margin)
    grids = [grid for row in rows for grid in row]
    at_once = min(threads, len(grids))
    done = count(1)

    counts: list[dict[str, int]] = []

    def computed(grid: Grid) -> tuple[Tensor, Tensor]:
        region = Region(frame, grid, pixels, signed_radius, hidden, beyond)
        tiles = []
        for tile in threaded(recomputed(region.tile), range(len(grid.tiles)), threads // at_once):
            tiles.append(tile)
            number = next(done)
            if progress and number <= len(frame.grid.tiles):  # not when it is computed again
                progress(number, len(frame.grid.tiles))
        of_rows = [tiles[i : i + grid.columns] for i in range(0, len(tiles), grid.columns)]
        images, trust = (_joined([[t[kind] for t in row] for row in of_rows]) for kind in (0, 1))
        counts.append(region.counts())
        return images.to(pixels.dtype), trust.to(pixels.dtype)

    results = threaded(recomputed(computed), grids, at_once)
    if torch.is_grad_enabled():
        by_row = [[next(results) for _ in row] for row in rows]
        images, trust = (_joined([[r[kind] for r in row] for row in by_row]) for kind in (0, 1))
    else:
        kinds = 3 if frame.left_right else 1
        images = pixels.new_empty(kinds, *pixels.shape)
        trust = pixels.new_empty(1, 1, *frame.size)
        for grid, found in zip(grids, results, strict=True):
            for whole, part in zip((images, trust), found, strict=True):
                grid.box.of(whole).copy_(part)
    total = {name: sum(each[name] for each in counts) for name in counts[0]}
    return images, trust, {"slices": len(frame.radii), **total}


def without_ramps_in_bands(signed_radius: Tensor, threads: int) -> Tensor:
    """Radii [H, W] px with steps in the place of ramps, band by band."""
    H, W = signed_radius.shape
    frame = Box(0, 0, H, W)

    def steepened(rows: tuple[int, int]) -> Tensor:
        band = Box(rows[0], 0, rows[1] - rows[0], W)
        around = band.grown(AROUND, frame)
        given = around.of(signed_radius)
        found = without_ramps(given)
        return band.of(signed_radius) if found is given else band.seen_from(around).of(found)

    return torch.cat(list(threaded(steepened, bands(H), threads)))


def _joined(rows: list[list[Tensor]]) -> Tensor:
    """Pictures [..., h, w], beside and below each other, as one."""
    return torch.cat([torch.cat(row, -1) for row in rows], -2)

"""Regions and tiles that are in focus as far as light reaches: copied."""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.engine.frame import NEIGHBOURHOOD, Frame
from defocus_core.images.box import Box, Span
from defocus_core.images.source import Pixels
from defocus_core.images.tiling import BLOCK, Grid

# Every so many rows and columns are looked at first: most of what is out of focus shows there.
_SAMPLED = 8


def blurred_part(frame: Frame, grid: Grid, signed_radius: Pixels) -> Grid | None:
    """What must be computed of a region: its tiles, cut to what light out of focus reaches.

    Args:
        frame: What holds for the whole picture.
        grid: The tiles of the region.
        signed_radius: [H, W] px of the frame.

    Returns:
        None if nothing must.
    """
    if frame.sharp is None:
        return grid
    seen = grid.box.grown(frame.margin, frame.box)
    radii = seen.of(signed_radius).detach()
    sides: list[Span | None] = [None, None]
    for every in (_SAMPLED, 1):
        some = radii[::every, ::every]
        for dim, whole in enumerate(grid.box.sides):
            if sides[dim] != whole:
                found = _reached(frame, seen, some, every, dim)
                sides[dim] = found and found.within(whole)
    down, across = sides
    return grid.within(Box.over(down, across)) if down and across else None


def _reached(frame: Frame, seen: Box, radii: Tensor, every: int, dim: int) -> Span | None:
    """Blocks along an axis beyond which all is as it was; None if that is so everywhere.

    Args:
        frame: What holds for the whole picture.
        seen: A part of it.
        radii: [h, w] px of that, of every so many rows and columns.
        every: How many.
        dim: The axis: 0 for rows.
    """
    assert frame.sharp is not None
    least, most = radii.amin(1 - dim), radii.amax(1 - dim)
    at = torch.nonzero((least < -frame.sharp) | (most > frame.sharp))[:, 0]
    if not len(at):
        return None
    reach = _reach(frame, least.index_select(0, at), most.index_select(0, at))
    at = every * at + seen[dim]
    first, last = int((at - reach).amin()), int((at + reach).amax())
    return Span(first // BLOCK * BLOCK, (last // BLOCK + 1) * BLOCK)


def _reach(frame: Frame, least: Tensor, most: Tensor) -> Tensor | int:
    """How many px away pixels of radii between two ends [n] px can be told from those in focus."""
    if frame.edges:  # and what edges reveal
        return frame.margin
    ladder = torch.tensor(frame.radii, dtype=torch.float64, device=least.device)
    spread = torch.tensor(frame.reaches, device=least.device)
    nearest = torch.searchsorted(ladder, least.double(), right=True) - 1
    farthest = torch.searchsorted(ladder, most.double())
    ends = (end.clamp(0, len(ladder) - 1) for end in (nearest, farthest))
    return NEIGHBOURHOOD + torch.maximum(*(spread.index_select(0, end) for end in ends))


def counts_of_copies(frame: Frame, pixels: int, tiles: int) -> dict[str, int]:
    """What was computed of so many pixels that were copied, as `Region.counts` tells it.

    Args:
        frame: They are of.
        pixels: How many.
        tiles: How many tiles hold nothing else.
    """
    return {
        "pixels": pixels,
        "pixels_copied": pixels,
        "tiles": tiles,
        "slice_tiles": 2 * len(frame.windows) * tiles,
        "slice_tiles_done": 0,
        "slice_tiles_blurred": 0,
        "slice_tiles_reduced": 0,
        "slice_tiles_culled": 0,
        "layer_pixels": 0,
        "layer_pixels_done": 0,
        "tiles_culled": 0,
        "tiles_with_hidden": 0,
    }

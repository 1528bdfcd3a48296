"""The part of a region that is computed; pixels in focus beyond its blurred light are copied."""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.engine.frame import NEIGHBOURHOOD, Frame
from defocus_core.images.box import Box, Span
from defocus_core.images.source import Pixels
from defocus_core.images.tiling import BLOCK, Grid
from defocus_core.layers.ladder import SHARP


def blurred_part(frame: Frame, grid: Grid, signed_radius: Pixels) -> Grid | None:
    """The part of a region to compute: its tiles, cut to the pixels that blurred light reaches.

    Args:
        frame: The frame of the picture.
        grid: The tiles of the region.
        signed_radius: [H, W] px of the frame.

    Returns:
        None if all of the region is copied.
    """
    if not frame.copies_in_focus:
        return grid
    around = grid.box.grown(frame.margin, frame.box)
    radii = around.of(signed_radius).detach()
    down, across = (_reached(frame, around, radii, dim) for dim in (0, 1))
    return grid.within(Box.over(down, across)) if down and across else None


def _reached(frame: Frame, around: Box, radii: Tensor, dim: int) -> Span | None:
    """Blocks along an axis that blurred light reaches; None if none are reached.

    Args:
        frame: The frame of the picture.
        around: A part of the frame.
        radii: [h, w] px of the part.
        dim: The axis: 0 for rows.
    """
    least, most = radii.amin(1 - dim), radii.amax(1 - dim)
    at = torch.nonzero((least < -SHARP) | (most > SHARP))[:, 0]
    if not len(at):
        return None
    reach = _reach(frame, least.index_select(0, at), most.index_select(0, at))
    at = at + around[dim]
    first, last = int((at - reach).amin()), int((at + reach).amax())
    return Span(first // BLOCK * BLOCK, (last // BLOCK + 1) * BLOCK)


def _reach(frame: Frame, least: Tensor, most: Tensor) -> Tensor | int:
    """Px around pixels of radii [n] from least to most in which their blur changes the picture."""
    if frame.content.edges:  # which reveal hidden surfaces, too
        return frame.margin
    ladder = torch.tensor(frame.slices.radii, dtype=torch.float64, device=least.device)
    spread = torch.tensor(frame.slices.visible.reaches, device=least.device)
    nearest = torch.searchsorted(ladder, least.double(), right=True) - 1
    farthest = torch.searchsorted(ladder, most.double())
    ends = (end.clamp(0, len(ladder) - 1) for end in (nearest, farthest))
    return NEIGHBOURHOOD + torch.maximum(*(spread.index_select(0, end) for end in ends))

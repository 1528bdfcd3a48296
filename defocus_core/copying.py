"""What is in focus as far as light reaches it stays as it is: regions and tiles are copied."""

from __future__ import annotations

import torch

from defocus_core.frame import Frame
from defocus_core.source import Pixels
from defocus_core.tiling import Box, Grid


def blurred_part(frame: Frame, grid: Grid, signed_radius: Pixels) -> Grid | None:
    """The rectangle of tiles of a region that holds all that must be computed.

    The others see nothing that is out of focus.

    Args:
        frame: What holds for the whole picture.
        grid: The tiles of the region.
        signed_radius: [H, W] px of the frame.

    Returns:
        None if the whole region is in focus.
    """
    if frame.sharp is None:
        return grid
    around = grid.box.grown(frame.margin, frame.box)
    out = around.of(signed_radius).abs() > frame.sharp
    ends = []
    for dim, first in enumerate((around.top, around.left)):
        some = torch.nonzero(out.any(1 - dim))[:, 0]
        if not len(some):
            return None
        ends.append((first + int(some[0]), int(some[-1]) + 1 - int(some[0])))
    (top, height), (left, width) = ends
    return grid.seeing(Box(top, left, height, width).grown(frame.margin, frame.box))


def counts_of_copies(frame: Frame, tiles: list[Box]) -> dict[str, int]:
    """What was computed of tiles that were copied, as `Region.counts` tells it."""
    pixels = sum(tile.height * tile.width for tile in tiles)
    return {
        "pixels": pixels,
        "pixels_copied": pixels,
        "tiles": len(tiles),
        "slice_tiles": 2 * len(frame.windows) * len(tiles),
        "slice_tiles_done": 0,
        "slice_tiles_blurred": 0,
        "slice_tiles_reduced": 0,
        "slice_tiles_culled": 0,
        "tiles_culled": 0,
        "tiles_with_hidden": 0,
    }

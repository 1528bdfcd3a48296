"""What is in focus as far as light reaches it stays as it is: regions and tiles are copied."""

from __future__ import annotations

from defocus_core.ends import ends_of
from defocus_core.frame import Frame
from defocus_core.source import Pixels
from defocus_core.tiling import Box, Grid

# Every so many rows and columns are looked at first: most of what is out of focus shows there.
_SAMPLED = 8


def blurred_part(frame: Frame, grid: Grid, signed_radius: Pixels) -> Grid | None:
    """The rectangle of tiles of a region that holds all that must be computed.

    The rows and columns of tiles around it see nothing that is out of focus.

    Args:
        frame: What holds for the whole picture.
        grid: The tiles of the region.
        signed_radius: [H, W] px of the frame.

    Returns:
        None if the whole region is in focus.
    """
    if _in_focus(frame, grid, signed_radius):
        return None
    for beside in (False, True):
        for last in (False, True):
            while (count := grid.columns if beside else len(grid.tiles) // grid.columns) > 1:
                parts = grid.divided(count - 1 if last else 1, beside=beside)
                strip, rest = parts[::-1] if last else parts
                if not _in_focus(frame, strip, signed_radius):
                    break
                grid = rest
    return grid


def _in_focus(frame: Frame, grid: Grid, signed_radius: Pixels) -> bool:
    """Whether all that some tiles could see of a frame is in focus."""
    if frame.sharp is None:
        return False
    seen = grid.box.grown(frame.margin, frame.box).of(signed_radius)
    for some in (seen[::_SAMPLED, ::_SAMPLED], seen):
        least, most = ends_of(some)
        if bool((least < -frame.sharp) | (most > frame.sharp)):
            return False
    return True


def counts_of_copies(frame: Frame, tiles: list[Box]) -> dict[str, int]:
    """What was computed of tiles that were copied, as `Region.counts` tells it."""
    pixels = sum(tile.area for tile in tiles)
    return {
        "pixels": pixels,
        "pixels_copied": pixels,
        "tiles": len(tiles),
        "slice_tiles": 2 * len(frame.windows) * len(tiles),
        "slice_tiles_done": 0,
        "slice_tiles_blurred": 0,
        "slice_tiles_reduced": 0,
        "slice_tiles_culled": 0,
        "layer_pixels": 0,
        "layer_pixels_done": 0,
        "tiles_culled": 0,
        "tiles_with_hidden": 0,
    }

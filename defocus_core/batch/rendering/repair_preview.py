"""Where a depth is repaired: a PNG of the picture, and beside it the repair in false colour."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defocus_core.batch.jobs.job import Picture, Reading
from defocus_core.batch.lenses.lens import Lens
from defocus_core.batch.sources import lone_window, windows
from defocus_core.io.arrays import Keeping, bands
from defocus_core.io.images.color_space import quantised
from defocus_core.io.images.encode import display_encoded, write_samples

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from defocus_core.depth.diagnosis import DepthRepair
    from defocus_core.io.images.color_planes import Color

# Brightness of the grey picture below the false colours; px of radius from which these are full.
_DIMMED, _FULL = 0.5, 2.0
NEAR, FAR = (1.0, 0.55, 0.0), (0.25, 0.6, 1.0)  # sRGB


@dataclass(frozen=True)
class RepairedPicture:
    """A picture, and its radii before and after the repair of its depth.

    Attributes:
        color: the decoded colour.
        given: signed radii in px of the depth as it was read, [H, W].
        repaired: signed radii in px by which the picture is rendered, [H, W].
        repair: the record of the repair.
    """

    color: Color
    given: Any
    repaired: Any
    repair: DepthRepair


def repaired_picture(
    picture: Picture, reading: Reading, lens: Lens, keeping: Keeping
) -> RepairedPicture:
    """Read a picture, and repair its depth as `defocus render` would.

    Raises:
        InputError: a file cannot be used.
        UsageProblem: the options make no sense for it.
    """
    import torch

    from defocus_core.batch.depth import focusing
    from defocus_core.batch.rendering import job_steps
    from defocus_core.depth.repair import repair_depth

    color, depth = job_steps.read(picture, reading, keeping, lens.foclen / lens.sensor_width)
    focused = focusing.focused(lens, depth)
    radius, _ = focusing.radius_map(focused, depth, keeping)
    height, width = radius.shape
    infinity = None if depth.is_radius else focusing.radius_at_infinity(focused, (width, height))
    repaired, repair = repair_depth(
        lone_window(radius, "cpu"),
        windows(color.planes, "cpu"),
        infinity,
        torch.get_num_threads(),
        depth_repair=reading.depth_repair,
        edge_width=reading.edge_width,
    )
    return RepairedPicture(color, radius, repaired, repair)


def write_repair_preview(path: Path, picture: RepairedPicture) -> None:
    """Write the picture, and beside it the repair: orange made nearer, blue made farther.

    Colour is full from 2 px of radius on.

    Raises:
        InputError: the file cannot be written.
    """
    height, width = picture.given.shape
    write_samples(path, (height, 2 * width), _strips(picture), "png", {})


def _strips(picture: RepairedPicture) -> Iterator[NDArray[Any]]:
    import numpy as np

    channels = picture.color.channels
    planes = picture.color.planes[: len(channels)]
    for rows in bands(picture.given.shape):
        pixels = np.stack([plane[rows] for plane in planes], -1).astype(np.float32)
        shown, _, _ = display_encoded(pixels, channels, 8, keep_alpha=False)
        shown = np.broadcast_to(shown[..., :3], (*shown.shape[:2], 3))
        grey = _DIMMED * shown.mean(axis=2, dtype=np.float32)[:, :, None] / 255
        change = _change(picture, rows)[:, :, None]
        amount = np.sqrt(np.minimum(np.abs(change) / _FULL, 1))
        hue = np.where(change < 0, np.array(NEAR, np.float32), np.array(FAR, np.float32))
        mixed = grey + amount * (hue - grey)
        yield np.concatenate([shown, quantised(mixed.astype(np.float32), 8)], 1)


def _change(picture: RepairedPicture, rows: slice) -> NDArray[Any]:
    """Px by which radii in some rows were changed: negative where depth was made nearer."""
    from defocus_core.batch.sources import to_array

    change: NDArray[Any] = to_array(picture.repaired[rows]) - picture.given[rows]
    return change

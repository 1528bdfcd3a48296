"""Signs that 16 bits without a declared unit are of a named format, and no millimetres.

A row has the names of folders and files of a data set, or the sizes of its pictures, and what its
numbers are like; all of a row must fit. Formats in millimetres have none: they are read right.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from defocus_core.errors import InputError
from defocus_core.io.arrays import bands
from defocus_core.system.text import percent

_TOP = 65535  # of 16 bits
_PARTS = 6  # of a path, from its end, that are looked at
_KITTI_SIZES = ((1242, 375), (1241, 376), (1238, 374), (1226, 370), (1224, 370), (1216, 352))


@dataclass(frozen=True)
class Sign:
    """A sign of a format."""

    format: str
    path: str = ""  # an expression that the end of the path matches, in small letters
    sizes: tuple[tuple[int, int], ...] = ()  # (width, height) in px; empty for any
    zeros: tuple[float, float] = (0.0, 1.0)  # least and greatest share of pixels that are 0
    tops: float = 0.0  # least share of pixels that are 65535
    maximum: int = _TOP  # the greatest number


SIGNS = (
    Sign(
        "kitti",
        r"proj_depth/(groundtruth|velodyne_raw)/|_selection_cropped/|kitti",
        zeros=(0.2, 1),
        maximum=32000,
    ),
    Sign("kitti", sizes=_KITTI_SIZES, zeros=(0.5, 1), maximum=32000),
    Sign("vkitti2", r"vkitti|virtual.?kitti|frames/depth/camera_[01]/", zeros=(0, 0)),
    Sign("vkitti2", sizes=((1242, 375),), zeros=(0, 0), tops=0.001),
    Sign("matterport", r"undistorted_depth_images/|[0-9a-f]{32}_d[0-2]_[0-5]\.png$"),
    Sign("tum", r"rgbd_dataset_freiburg|rgbd_bonn|smart_?portraits"),
    Sign("ibims1", r"ibims-?1"),
    Sign("pointodyssey", r"point_?odyssey"),
    Sign("dynamicreplica", r"dynamic_?replica"),
    Sign("co3d", r"co3d|\.jpg\.geometric\.png$"),
    Sign("cityscapes", r"[a-z]+_\d{6}_\d{6}_disparity\.png$"),
)


def refuse_named(path: Path, values: Any) -> None:
    """Refuse 16 bits [H, W] as millimetres that have a sign of another format."""
    place, size = "/".join(path.absolute().parts[-_PARTS:]).lower(), values.shape[1::-1]
    likely = [
        (sign, found)
        for sign in SIGNS
        if (found := re.search(sign.path, place)) and (not sign.sizes or size in sign.sizes)
    ]
    if not likely:
        return
    zeros, tops, maximum = _counted(values)
    for sign, found in likely:
        if (
            sign.zeros[0] <= zeros <= sign.zeros[1]
            and sign.tops <= tops
            and maximum <= sign.maximum
        ):
            told = [f"its path has '{found[0]}'"] if sign.path else [f"{size[0]}x{size[1]} px"]
            told += [
                f"{percent(share)} are {n}" for n, share in ((0, zeros), (_TOP, tops)) if share
            ]
            problem = f"has 16 bits that may be {sign.format}, not millimetres: {', '.join(told)}"
            remedy = f"say ‹depth-format› {sign.format}, or ‹depth-unit› mm"
            raise InputError("unknown-unit", problem, remedy, path=path)


def _counted(values: Any) -> tuple[float, float, int]:
    """The shares of numbers that are 0 and 65535, and the greatest number."""
    zeros = tops = maximum = 0
    for rows in bands(values.shape):
        band = values[rows]
        zeros, tops = zeros + int((band == 0).sum()), tops + int((band == _TOP).sum())
        maximum = max(maximum, int(band.max()))
    pixels = values.shape[0] * values.shape[1]
    return zeros / pixels, tops / pixels, maximum

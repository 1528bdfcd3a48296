"""The matte of a picture: the coverage of its subject, whose edges are those of the depth.

Portrait modes and segmentations write it, 0 to 1.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, UsageProblem
from defocus_core.io.depth_formats.reading import stretched
from defocus_core.io.exr.header import is_exr
from defocus_core.io.exr.windows import Overscan
from defocus_core.io.images.color import read_color
from defocus_core.io.images.color_space import unit
from defocus_core.io.images.raster import choose_page, read_pages, read_samples
from defocus_core.io.safe_files import read_head
from defocus_core.picture.pair import stretch_words
from defocus_core.picture.scene import map_windows
from defocus_core.picture.take import Surfaces, Take
from defocus_core.system.text import note


def read(take: Take) -> Take:
    """The take with its matte, if it is rendered."""
    picture, color = take.job.picture, take.inputs.color
    if picture.over is not None:
        problem = "stands beside ‹over›, whose element has its own alpha"
        raise UsageProblem("contradiction", problem, "leave it out", field="matte")
    if not take.job.outputs.need_rendering:
        return take
    assert picture.matte is not None
    return take.reading(matte=read_matte(picture.matte.color, color.size, color.overscan))


def scene(surfaces: Surfaces) -> Surfaces:
    """The surface with its coverage."""
    take = surfaces.take
    return replace(surfaces, matte=map_windows(take.inputs.matte, take.device))


def read_matte(path: Path, size: tuple[int, int], overscan: Overscan) -> NDArray[np.float32]:
    """The coverage of a subject [H, W] in 0…1: the alpha of a file that has one, else its grey."""
    values = _values(path)
    (height, width), (columns, rows) = values.shape, size
    if (width, height) != size:
        if (share := stretched((width, height), size)) is None:
            problem = (
                f"is {width}x{height} px, of another aspect than its picture, {columns}x{rows}"
            )
            remedy = "give a matte of the picture"
            raise InputError("wrong-size", problem, remedy, path=path)
        if share:
            note(f"defocus: {path}: {width}x{height} px{stretch_words(share)}")
        values = _resized(values, size)
    pads = (overscan.top, overscan.bottom), (overscan.left, overscan.right)
    return np.pad(values, pads, mode="edge")


def _values(path: Path) -> NDArray[np.float32]:
    """The numbers of a file."""
    if is_exr(read_head(path)):
        color = read_color(path)
        colors = color.pixels if color.alpha is None else np.asarray(color.alpha[:])[:, :, None]
    else:
        page = choose_page(path, read_pages(path), None)
        pieces = list(read_samples(path, page.page))
        colors = np.zeros((page.height, page.width, len(page.channels)), np.float32)
        for window, samples in pieces:
            colors[window] = unit(samples)
        if "A" in page.channels:
            colors = colors[:, :, page.channels.index("A")][:, :, None]
    values = np.asarray(colors[:, :, 0], np.float32)
    if colors.shape[2] > 1 and (np.abs(colors[:, :, :3] - values[:, :, None]) > 0.1).any():
        problem, remedy = "has colours, and a matte is grey", "give the matte, not the picture"
        raise InputError("not-one-channel", problem, remedy, path=path)
    if not ((values >= 0) & (values <= 1)).all():
        problem = "has numbers beyond 0 to 1, which are not coverage"
        raise InputError("out-of-range", problem, "scale it to 0 to 1", path=path)
    return values


def _resized(values: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    """The matte at another size: it is smooth, unlike depth."""
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    roi = oiio.ROI(0, size[0], 0, size[1], 0, 1, 0, 1)
    buffer = oiio.ImageBuf(np.ascontiguousarray(values[:, :, None]))
    found = oiio.ImageBufAlgo.resize(buffer, roi=roi, filtername="triangle")
    return np.clip(np.asarray(found.get_pixels(oiio.FLOAT)).reshape(size[::-1]), 0, 1)

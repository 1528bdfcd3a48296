"""Depth brought to the size of its colour: by the nearest pixel, or guided by the colours."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from defocus_core.errors import InputError
from defocus_core.io.arrays import bands
from defocus_core.io.depth_formats.depth import Depth, require_valid
from defocus_core.io.depth_formats.reading import stretched, wrong_size
from defocus_core.io.images.color import Color
from defocus_core.picture.pair import stretch_words
from defocus_core.picture.sources import windows
from defocus_core.picture.take import InputPair


def pair(given: InputPair) -> InputPair:
    """The depth at the size of its colour; any mean of two surfaces is one that is not there."""
    color, depth, reading = given.color, given.depth, given.reading
    (height, width), (rows, columns) = color.shape[:2], depth.metres.shape
    share = stretched((columns, rows), (width, height))
    is_smaller = columns < width and rows < height
    if reading.resize_depth is None and not (is_smaller and share is not None):
        raise wrong_size(depth.path, (rows, columns), (width, height))
    if depth.is_radius and not depth.is_relative:
        problem = f"holds radii in px of a picture of {columns}x{rows} px"
        raise InputError("radii", problem, "give radii of the size of the colour", path=depth.path)
    if share is None:
        problem = f"is {columns}x{rows} px, of another aspect than the colour, {width}x{height} px"
        remedy = "give depth of the view that the colour shows, all of it"
        if stretched((rows, columns), (width, height)) is not None:
            remedy = "turn one of them; or say ‹turn-depth› if Exif turned the colour alone"
        raise InputError("wrong-size", problem, remedy, path=depth.path)
    resized = f"{columns}x{rows} px resized"
    metres = given.keeping.new((height, width), np.float32)
    if reading.resize_depth is None:
        words = f"{depth.path.name}: {resized} to {width}x{height} px, guided by the colours"
        depth = replace(depth, told=(*depth.told, words))
    if reading.resize_depth != "nearest":
        require_valid(depth)
        _fill_guided(metres, depth, color)
        note = f"{depth.note}, {resized}, guided by the colours{stretch_words(share)}"
        return given.with_depth(replace(depth, metres=metres, note=note))
    across = ((np.arange(width) + 0.5) * columns / width).astype(int)
    down = ((np.arange(height) + 0.5) * rows / height).astype(int)
    for band in bands((height, width)):
        first, last = int(down[band][0]), int(down[band][-1])
        metres[band] = depth.metres[first : last + 1][down[band] - first][:, across]
    note = f"{depth.note}, {resized} by nearest{stretch_words(share)}"
    return given.with_depth(replace(depth, metres=metres, note=note))


def _fill_guided(metres: Any, depth: Depth, color: Color) -> None:
    """Fill [H, W] with the depth of another size, its edges where the colours change."""
    import torch

    from defocus_core.depth.guided_resize import GuidedDepth

    given = torch.from_numpy(depth.metres[:].astype("float32"))
    if not depth.is_relative:
        guided = GuidedDepth(given, windows(color.planes, "cpu"))
        for rows in bands(metres.shape):
            metres[rows] = guided[rows].numpy()
        return
    # Disparity of any scale, taken as 1 at its farthest and 2 at its nearest number.
    far, near = (float(end) for end in torch.aminmax(given))
    if depth.inverted:
        far, near = near, far
    scale = (near - far) or 1.0
    guided = GuidedDepth(1 / (1 + (given - far) / scale), windows(color.planes, "cpu"))
    for rows in bands(metres.shape):
        metres[rows] = (far + scale * (1 / guided[rows] - 1)).float().numpy()

"""Deep OpenEXR parts as a picture in focus, or as layers.

In the picture in focus, colours and alpha are `over` each other; depth, and what is no colour, is
that of the nearest sample. Layers have one sample of each pixel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.arrays import Keeping
from defocus_core.io.exr.deep_merging import merged
from defocus_core.io.exr.deep_samples import ALPHA, BACK, DEPTH, FRONT, Strip, strips
from defocus_core.io.exr.header import Header
from defocus_core.io.exr.windows import NO_OVERSCAN, Overscan, Window

_DTYPES = {"uint": "uint32", "half": "float16", "float": "float32"}


@dataclass(frozen=True)
class DeepLayers:
    """The samples of a deep picture as layers of its frame, nearest first."""

    # For each the arrays [H, W] by name of the channel; with volumes `FRONT`, too
    layers: tuple[Mapping[str, Any], ...]
    merged: int  # number of pixels that had more samples than there are layers


def flat_channels(
    path: Path, header: Header, names: Mapping[str, str], keeping: Keeping, overscan: Overscan
) -> dict[str, Any]:
    """The picture in focus: the channels of the frame by name."""
    frame = header.display.grown(overscan)
    light = {n for n, kind in names.items() if kind != "uint" and not _is_distance(n)}
    planes = {
        name: keeping.new(
            (frame.height, frame.width), "float32" if name in light else _DTYPES[kind]
        )
        for name, kind in names.items()
    }
    for strip in strips(path, header):
        fractions = _fractions(strip)
        for name, plane in planes.items() if len(fractions) else ():  # planes begin as zeros
            values = strip.values[name]
            if name in light:
                size = strip.window.height * strip.window.width
                total = np.bincount(strip.pixel, values * fractions, size).astype(np.float32)
                rows = total.reshape(strip.window.height, strip.window.width)
            else:
                rows = strip.dense(strip.rank == 0, values)
            _paste(plane, rows, strip.window, frame)
    return planes


def deep_layers(
    path: Path,
    header: Header,
    names: tuple[str, ...],
    keeping: Keeping,
    overscan: Overscan = NO_OVERSCAN,
) -> DeepLayers:
    """The samples as layers, of which there are as many as the pixel with most samples needs."""
    frame, crowded = header.display.grown(overscan), 0
    layers: list[dict[str, Any]] = []
    kinds = {channel.name: channel.type for channel in header.channels}
    volumes = any(channel.plain == BACK for channel in header.channels)
    wanted = (*names, ALPHA, DEPTH, *((FRONT, BACK) if volumes else ()))
    for strip in strips(path, header, last=True):
        strip, count = merged(strip, (*names, ALPHA))
        crowded += count
        while len(layers) < max(1, strip.maximum):
            layers.append(
                {
                    name: keeping.new(
                        (frame.height, frame.width), _DTYPES[kinds.get(name, "float")]
                    )
                    for name in wanted
                }
            )
        for number, layer in enumerate(layers):
            chosen = np.flatnonzero(strip.rank == number)
            for name in wanted if len(chosen) else ():
                rows = strip.dense(chosen, strip.values[name])
                _paste(layer[name], rows, strip.window, frame)
    return DeepLayers(tuple(layers), crowded)


def _fractions(strip: Strip) -> NDArray[Any]:
    """The share [N] of each sample that nearer ones leave: the product of what each lets through.

    Twice as many samples at each step, for a pixel may have a million of them.
    """
    through, index = (1 - strip.values[ALPHA]).astype(np.float64), np.arange(len(strip.rank))
    step = 1
    while step < strip.maximum:
        later = index[strip.rank >= step]
        through[later] *= through[later - step]
        step *= 2
    return np.where(strip.rank > 0, np.roll(through, 1), 1.0)


def _is_distance(name: str) -> bool:
    return name.rpartition(".")[2].lower() in ("z", "zback", "depth")


def _paste(plane: Any, rows: NDArray[Any], window: Window, frame: Window) -> None:
    place, shown = frame.cut(window), window.cut(frame)
    if rows[shown].size:
        plane[place] = rows[shown]

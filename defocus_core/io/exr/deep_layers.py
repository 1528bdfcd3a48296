"""Deep OpenEXR parts as a picture in focus, or as layers with one sample of each pixel.

In the picture in focus, which is without blur, colours and alpha are composited by `over`; depth
and the other channels are those of the nearest sample.

Samples at one depth of a pixel, which come from two pictures, are mixed by the light that each
absorbs (P. Hillman, The Theory of OpenEXR Deep Samples; F. Kainz, Interpreting OpenEXR Deep Pixels,
2013).

Where a pixel has more samples than there may be layers, samples close to each other in 1 / distance
are merged, as blur is linear in 1 / distance. The light of each is weighted by the share that the
nearer ones of them let through, and added.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.exr.channel_choice import is_depth
from defocus_core.io.exr.deep_samples import (
    ALPHA,
    DEPTH,
    DeepSamples,
    ranks,
    read_deep_samples,
    seen,
)
from defocus_core.io.exr.header import DTYPES, Header
from defocus_core.io.exr.windows import Overscan


def flat_channels(
    path: Path, header: Header, names: Mapping[str, str], overscan: Overscan
) -> dict[str, Any]:
    """The channels [H, W] of the picture in focus by name.

    The arrays cover the display window with `overscan`. `names`: the type of each wanted channel by
    name.
    """
    frame, samples = header.display.grown(overscan), seen(read_deep_samples(path, header))
    share, window, planes = _fractions(samples), samples.window, {}
    for name, kind in names.items():
        values = samples.values[name]
        if kind == "uint" or is_depth(name):
            rows = samples.dense(samples.rank == 0, values).astype(DTYPES[kind])
        else:
            total = np.bincount(samples.pixel, values * share, window.height * window.width)
            rows = total.astype(np.float32).reshape(window.height, window.width)
        planes[name] = np.zeros((frame.height, frame.width), rows.dtype)
        frame.paste(planes[name], rows, window)
    return planes


def deep_layers(
    path: Path, header: Header, names: tuple[str, ...], overscan: Overscan
) -> tuple[list[dict[str, Any]], int]:
    """The samples of a deep part as layers, nearest first, as many as its fullest pixel needs.

    Returns for each layer the arrays [H, W] by channel, which cover the display window with
    `overscan`; and the number of pixels whose samples were merged as they had more than
    `MAX_LAYERS`.
    """
    frame, layers = header.display.grown(overscan), list[dict[str, Any]]()
    samples, crowded = merge_samples(seen(read_deep_samples(path, header)), (*names, ALPHA))
    kinds = {channel.name: channel.type for channel in header.channels}
    for number in range(max(1, samples.maximum)):
        chosen, layer = np.flatnonzero(samples.rank == number), dict[str, Any]()
        for name in (*names, ALPHA, DEPTH):
            layer[name] = np.zeros((frame.height, frame.width), DTYPES[kinds.get(name, "float")])
            frame.paste(layer[name], samples.dense(chosen, samples.values[name]), samples.window)
        layers.append(layer)
    return layers, crowded


def _fractions(samples: DeepSamples) -> NDArray[Any]:
    """The share [N] of each sample's light that nearer samples let through: a product of 1 - alpha.

    It takes log2 n rounds if the fullest pixel has n samples, which may be a million.
    """
    through, index = (1 - samples.values[ALPHA]).astype(np.float64), np.arange(len(samples.rank))
    step = 1
    while step < samples.maximum:
        later = index[samples.rank >= step]
        through[later] *= through[later - step]
        step *= 2
    return np.where(samples.rank > 0, np.roll(through, 1), 1.0)


_OPAQUE = 1e6  # absorption of alpha 1


def mix_samples(samples: DeepSamples, light: tuple[str, ...], mixed: NDArray[Any]) -> DeepSamples:
    """The samples sorted by depth; samples of equal depth become one in the pixels `mixed`.

    `light`: names of the channels that are mixed; `mixed`: flat indices of pixels in the window.
    """
    depth = np.nan_to_num(samples.values[DEPTH], nan=np.inf, posinf=np.inf)
    order = np.lexsort((depth, samples.pixel))
    pixel, values = samples.pixel[order], {n: samples.values[n][order] for n in (*light, DEPTH)}
    alpha, depth = values[ALPHA], values[DEPTH]
    same = (pixel[1:] == pixel[:-1]) & (depth[1:] == depth[:-1]) & np.isin(pixel[1:], mixed)
    if same.any():
        first = np.concatenate([[True], ~same])
        # What samples absorb adds up; 1 - exp(-absorbed) is their alpha.
        with np.errstate(divide="ignore"):
            absorbed = np.minimum(-np.log1p(-alpha.astype("f8")), _OPAQUE)
        group = np.cumsum(first) - 1
        total = np.bincount(group, absorbed)
        weights = _ratio(absorbed, alpha) * _ratio(-np.expm1(-total), total)[group]
        values = {n: np.bincount(group, weights * values[n]).astype("f4") for n in light}
        pixel, values[DEPTH] = pixel[first], depth[first]
    return DeepSamples(samples.window, pixel, ranks(pixel), values)


def _ratio(part: NDArray[Any], whole: NDArray[Any]) -> NDArray[Any]:
    ratio: NDArray[Any] = part / np.where(whole > 0, whole, 1)
    return ratio


MAX_LAYERS = 12


def merge_samples(samples: DeepSamples, light: tuple[str, ...]) -> tuple[DeepSamples, int]:
    """The samples merged to at most `MAX_LAYERS` per pixel, and the number of pixels that had more.

    `light`: names of channels, with that of alpha last.
    """
    crowded = int((np.bincount(samples.pixel) > MAX_LAYERS).sum())
    if not crowded:
        return samples, 0
    depth = samples.values[DEPTH].astype("f8")
    with np.errstate(divide="ignore", invalid="ignore"):
        near = np.nan_to_num(1 / depth, nan=0, posinf=0)
    group = _groups(samples, near)
    share = _fractions(samples._replace(pixel=group, rank=ranks(group)))
    values = {n: np.bincount(group, share * samples.values[n]).astype("f4") for n in light}
    weights = share * samples.values[ALPHA]
    total = np.bincount(group, weights)
    first = np.flatnonzero(np.diff(group, prepend=-1))
    with np.errstate(divide="ignore"):
        middle = np.maximum(total, 1e-30) / np.bincount(group, weights * near)
    values[DEPTH] = np.where(np.bincount(group) > 1, middle, depth[first]).astype("f4")
    pixel = samples.pixel[first]
    return DeepSamples(samples.window, pixel, ranks(pixel), values), crowded


def _groups(samples: DeepSamples, near: NDArray[Any]) -> NDArray[np.intp]:
    """The number [N] of each sample's group, at most `MAX_LAYERS` groups in a pixel.

    Groups are separated at the widest steps between the samples of a pixel; `near`: [N] 1 / depth.
    """
    step = np.where(samples.rank > 0, np.roll(near, 1) - near, np.inf)
    mixed = np.arange(len(step)) * 0.6180339887498949 % 1  # spreads cuts at equal steps
    order = np.lexsort((mixed, -step, samples.pixel))
    place = np.empty(len(step), np.intp)
    place[order] = ranks(samples.pixel[order])
    return np.cumsum(place < MAX_LAYERS) - 1

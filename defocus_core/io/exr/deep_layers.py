"""Deep OpenEXR parts as a picture in focus, or as layers that have one sample of each pixel.

In the picture in focus, colours and alpha are `over` each other; depth, and what is no colour, is
that of the nearest sample.

Of two pictures in one pixel, what lies in one place is mixed by what each absorbs (P. Hillman, The
Theory of OpenEXR Deep Samples; F. Kainz, Interpreting OpenEXR Deep Pixels, 2013).

Of a pixel of more samples than layers, the two neighbours nearest to each other in 1 / distance
become one, until there are few enough: blur is linear in 1 / distance. The nearer one weakens the
light of the farther one by its alpha, and both count by what shows of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.exr.channel_choice import is_depth
from defocus_core.io.exr.deep_samples import ALPHA, DEPTH, Strip, seen, strips
from defocus_core.io.exr.header import DTYPES, Header
from defocus_core.io.exr.windows import Overscan


def flat_channels(
    path: Path, header: Header, names: Mapping[str, str], overscan: Overscan
) -> dict[str, Any]:
    """The picture in focus: the channels of the frame by name."""
    frame = header.display.grown(overscan)
    light = {n for n, kind in names.items() if kind != "uint" and not is_depth(n)}
    planes = {
        name: np.zeros((frame.height, frame.width), "float32" if name in light else DTYPES[kind])
        for name, kind in names.items()
    }
    for strip in map(seen, strips(path, header)):
        fractions = _fractions(strip)
        for name, plane in planes.items() if len(fractions) else ():  # planes begin as zeros
            values = strip.values[name]
            if name in light:
                size = strip.window.height * strip.window.width
                total = np.bincount(strip.pixel, values * fractions, size).astype(np.float32)
                rows = total.reshape(strip.window.height, strip.window.width)
            else:
                rows = strip.dense(strip.rank == 0, values)
            frame.paste(plane, rows, strip.window)
    return planes


def deep_layers(
    path: Path,
    header: Header,
    names: tuple[str, ...],
    overscan: Overscan,
) -> tuple[list[dict[str, Any]], int]:
    """The samples as layers, nearest first, as many as the pixel with most samples needs.

    Returns the arrays [H, W] of each by name of the channel, and the number of pixels that had more
    samples than there are layers.
    """
    frame, crowded = header.display.grown(overscan), 0
    layers: list[dict[str, Any]] = []
    kinds = {channel.name: channel.type for channel in header.channels}
    wanted = (*names, ALPHA, DEPTH)
    for strip in map(seen, strips(path, header)):
        strip, count = merge_samples(strip, (*names, ALPHA))
        crowded += count
        while len(layers) < max(1, strip.maximum):
            types = {name: DTYPES[kinds.get(name, "float")] for name in wanted}
            layers.append({n: np.zeros((frame.height, frame.width), types[n]) for n in wanted})
        for number, layer in enumerate(layers):
            chosen = np.flatnonzero(strip.rank == number)
            for name in wanted if len(chosen) else ():
                rows = strip.dense(chosen, strip.values[name])
                frame.paste(layer[name], rows, strip.window)
    return layers, crowded


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


_OPAQUE = 1e6  # absorption of alpha 1


def mix_samples(strip: Strip, light: tuple[str, ...], mixed: NDArray[Any]) -> Strip:
    """The samples sorted by depth; those of one place are one in the pixels `mixed`."""
    depth = np.nan_to_num(strip.values[DEPTH], nan=np.inf, posinf=np.inf)
    order = np.lexsort((depth, strip.pixel))
    values = [strip.values[name][order] for name in (*light, DEPTH)]
    pixel, values = _mix(strip.pixel[order], values, mixed)
    rank = np.arange(len(pixel)) - np.searchsorted(pixel, pixel)
    named = zip((*light, DEPTH), values, strict=True)
    return Strip(strip.window, pixel, rank, {n: each.astype("f4") for n, each in named})


def _mix(
    pixel: NDArray[Any], values: list[NDArray[Any]], where: NDArray[Any]
) -> tuple[NDArray[Any], list[NDArray[Any]]]:
    """Sorted samples, their alpha and depth last, in which those of one place are one."""
    *light, alpha, depth = values
    same = (pixel[1:] == pixel[:-1]) & (depth[1:] == depth[:-1]) & np.isin(pixel[1:], where)
    if not same.any():
        return pixel, values
    first = np.concatenate([[True], ~same])
    # What samples absorb adds up; 1 - exp(-absorbed) is their alpha.
    with np.errstate(divide="ignore"):
        absorbed = np.minimum(-np.log1p(-alpha.astype("f8")), _OPAQUE)
    group = np.cumsum(first) - 1
    total = np.bincount(group, absorbed)
    weights = _ratio(absorbed, alpha) * _ratio(-np.expm1(-total), total)[group]
    mixed = [np.bincount(group, weights * each) for each in (*light, alpha)]
    return pixel[first], [*mixed, depth[first]]


def _ratio(part: NDArray[Any], whole: NDArray[Any]) -> NDArray[Any]:
    ratio: NDArray[Any] = part / np.where(whole > 0, whole, 1)
    return ratio


MAX_LAYERS = 12
_MERGED = 1 << 18  # samples merged at once, were each pixel to have as many


def merge_samples(strip: Strip, light: tuple[str, ...]) -> tuple[Strip, int]:
    """The strip with `MAX_LAYERS` samples a pixel at most, and how many pixels had more."""
    crowded = np.unique(strip.pixel[strip.rank >= MAX_LAYERS])
    if not len(crowded):
        return strip, 0
    kept, names = ~np.isin(strip.pixel, crowded), (*light, DEPTH)
    pieces = [[strip.pixel[kept], strip.rank[kept], *(strip.values[n][kept] for n in names)]]
    for some in _alike(crowded, np.bincount(strip.pixel)[crowded]):
        values, near = _merge_pixels(strip, some, light)
        alive = near >= 0
        rank = np.cumsum(alive, 1) - 1
        with np.errstate(divide="ignore"):
            numbers = [*(each[alive] for each in values), 1 / near[alive]]
        pieces.append([np.repeat(some, alive.sum(1)), rank[alive], *numbers])
    pixel, rank, *merged = map(np.concatenate, zip(*pieces, strict=True))
    named = zip(names, merged, strict=True)
    return Strip(strip.window, pixel, rank, {n: x.astype("f4") for n, x in named}), len(crowded)


def _alike(pixels: NDArray[Any], counts: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Pixels in order, some at a time, that have about as many samples."""
    order, first = np.argsort(counts, kind="stable"), 0
    while first < len(order):
        sizes = counts[order[first : first + _MERGED]]
        fit = np.searchsorted(sizes * np.arange(1, len(sizes) + 1), _MERGED, "right")
        end = first + max(int(fit), 1)
        yield np.sort(pixels[order[first:end]])
        first = end


def _merge_pixels(
    strip: Strip, pixels: NDArray[Any], light: tuple[str, ...]
) -> tuple[list[NDArray[Any]], NDArray[Any]]:
    """Values [P, K] of pixels, and 1 / distance; -1 where a sample was merged into the one before.

    `pixels`: [P] pixels that have too many.
    """
    chosen = np.flatnonzero(np.isin(strip.pixel, pixels))
    at = np.searchsorted(pixels, strip.pixel[chosen]), strip.rank[chosen]
    shape = len(pixels), int(strip.rank[chosen].max()) + 1
    near = np.full(shape, -1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        near[at] = np.nan_to_num(1 / strip.values[DEPTH][chosen], nan=0, posinf=0)
    values = [np.zeros(shape) for _ in light]
    for name, each in zip(light, values, strict=True):
        each[at] = strip.values[name][chosen]
    while (excess := (near >= 0).sum(1) - MAX_LAYERS).max() > 0:
        # living samples in order
        order = np.argsort(near < 0, axis=1, kind="stable")[:, : MAX_LAYERS + excess.max()]
        near = np.take_along_axis(near, order, 1)
        values = [np.take_along_axis(each, order, 1) for each in values]
        which, one = _nearest_pairs(near, excess)
        two, left = one + 1, 1 - values[-1][which, one]
        weights = values[-1][which, one], values[-1][which, two] * left
        total = np.maximum(weights[0] + weights[1], 1e-30)
        near[which, one] = (weights[0] * near[which, one] + weights[1] * near[which, two]) / total
        for each in values:
            each[which, one] += each[which, two] * left
        near[which, two] = -1
    return values, near


def _nearest_pairs(near: NDArray[Any], excess: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Pixel, and first sample, of pairs that are merged sooner or later if the nearest come first.

    A merged pair is no nearer to its neighbours than its samples were. So of `excess` merges none
    is of samples farther apart than as many steps are; up to there the pairs that are nearer to
    each other than to their neighbours are merged as they are, whichever comes first.

    `near`: [P, K] 1 / distance of samples in order, -1 behind the last; `excess`: [P] how many
    samples are to be merged into others.
    """
    step = np.where(near[:, 1:] >= 0, near[:, :-1] - near[:, 1:], np.inf)
    row = np.arange(len(near))
    limit = np.sort(step, 1)[row, np.maximum(excess, 1) - 1][:, None]
    beside = np.pad(step, ((0, 0), (1, 1)), constant_values=np.inf)
    # of equal steps in a row every other one is taken, from the first
    falls = beside[:, :-2] > step
    run = np.arange(step.shape[1]) - np.maximum.accumulate(
        np.where(beside[:, :-2] != step, np.arange(step.shape[1]), 0), 1
    )
    start = np.take_along_axis(falls, np.arange(step.shape[1]) - run, 1)
    local = (start & (run % 2 == 0) | ~start & (run % 2 == 1)) & (beside[:, 2:] >= step)
    local &= step <= limit
    ties = local & (step == limit)
    allowed = excess - (step < limit).sum(1)
    local &= ~ties | (np.cumsum(ties, 1) <= allowed[:, None])
    local &= excess[:, None] > 0
    which, first = np.nonzero(local)
    return which, first

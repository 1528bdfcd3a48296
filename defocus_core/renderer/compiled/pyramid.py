"""A pyramid of two layers, see `inpainting/two_layer_pyramid.py`.

A level is values [h, w, 2, K], means over the farthest surface of each coarse pixel and the next
one, and limits [h, w, 2, 3]: the share of the coarse pixel that they take, and their least and
greatest radius. The first three values are colour, the fourth is the radius, further ones the
structure tensor.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from defocus_core.renderer.compiled.coarse import CoarseAxis
from defocus_core.renderer.compiled.jit import compiled, entry

F32 = np.float32
# Rows of a level that are made at once; rows of the finer one beside theirs that they hang on,
# those of the structure tensor included.
_ROWS, _BESIDE = 32, 2
# As in `inpainting/two_layer_pyramid.py`.
_ALIKE, _GROWTH, _WIDER, _LEAST_WEIGHT = 1.013, 1.5, 1.99, 1e-30


@entry
def coarser(values, limits, down, across, taps, alike, out, out_limits):
    """The next coarser level: of each coarse pixel the farthest surface, and the next one.

    down, across: `CoarseAxis` of the coarser level; taps: [rows, 2] and [columns, 2], the pixels
    that have a share in coarse pixel k, counted from 2 k, and their shares; alike: range of radii
    in px that counts as one surface.
    """
    height, width, _, count = values.shape
    total, mean = np.zeros(2), np.zeros((2, count))
    rows, columns = taps
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            top = F32(-np.inf)
            for s in range(2):
                limit = top - alike if s else F32(0)
                least, most = F32(np.inf), F32(-np.inf)
                total[s] = 0
                mean[s] = 0
                # the top of those that are left, then the sum of those near it
                for step in range(2):
                    for a in range(rows.shape[0]):
                        y = 2 * i + np.int64(rows[a, 0]) - down.before
                        if y < 0 or y >= height:
                            continue
                        for b in range(columns.shape[0]):
                            x = 2 * j + np.int64(columns[b, 0]) - across.before
                            if x < 0 or x >= width:
                                continue
                            for k in range(2):
                                weight = limits[y, x, k, 0]
                                if weight <= 0 or (s and limits[y, x, k, 1] > limit):
                                    continue
                                if step == 0:
                                    most = max(most, limits[y, x, k, 2])
                                    continue
                                if limits[y, x, k, 1] <= most - alike:
                                    continue
                                share = weight * rows[a, 1] * columns[b, 1]
                                total[s] += share
                                least = min(least, limits[y, x, k, 1])
                                for c in range(count):
                                    mean[s, c] += share * values[y, x, k, c]
                    if most == -np.inf:
                        break
                if s == 0:
                    top = most
                for c in range(count):
                    out[i, j, s, c] = mean[s, c] / max(total[s], _LEAST_WEIGHT)
                out_limits[i, j, s, 0] = min(total[s], 1.0)
                out_limits[i, j, s, 1], out_limits[i, j, s, 2] = least, most


def _taps(place: CoarseAxis, *, overlapping: bool) -> NDArray[np.float64]:
    """The pixels that have a share in coarse pixel k, counted from 2 k, and their shares."""
    if place.odd:
        return np.array([(-1, 0.5), (0, 1.0), (1, 0.5)])
    if overlapping:
        return np.array([(-1, 0.25), (0, 0.75), (1, 0.75), (2, 0.25)])
    return np.array([(0, 1.0), (1, 1.0)])


Level = tuple[NDArray[np.float32], NDArray[np.float32]]


def next_level(level: Level, number: int, down: CoarseAxis, across: CoarseAxis) -> Level:
    """The level of a number made of the one before, in places of its own."""

    def rows_of(rows: slice) -> Level:
        return level[0][rows], level[1][rows]

    return _made_of(rows_of, level[0].shape[0], level[0].shape[-1], number, down, across)


def _made_of(
    rows_of: Callable[[slice], Level],
    height: int,
    count: int,
    number: int,
    down: CoarseAxis,
    across: CoarseAxis,
) -> Level:
    """The level of a number, of `count` values, made of bands of rows of the one before."""
    size = down.length, across.length, 2
    out = np.zeros((*size, count), np.float32), np.empty((*size, 3), np.float32)
    alike = F32(_ALIKE * _GROWTH ** max(number - 2, 0))
    taps = tuple(_taps(place, overlapping=number > 1) for place in (down, across))
    for first in range(0, down.length, _ROWS):
        last = min(first + _ROWS, down.length)
        top, end = 2 * first - down.before, 2 * last - down.before
        rows = slice(max(top - _BESIDE, 0), min(end + _BESIDE, height))
        place = down._replace(before=rows.start - top)
        coarser(*rows_of(rows), place, across, taps, alike, *(x[first:last] for x in out))
    return out


@entry
def first_level(light, radius, limit, nearer, values, limits):
    """The pixels of a picture as a level, without highlights and what nearer surfaces cover.

    light: [H, 4 W] of their own surfaces; limit: brightness of a highlight; nearer: [H, 4 W] light
    of nearer surfaces, or [0, 0].
    """
    height, width = radius.shape
    for y in range(height):
        for x in range(width):
            coverage, r, brightest = light[y, 4 * x + 3], radius[y, x], F32(0)
            for c in range(3):
                values[y, x, 0, c] = light[y, 4 * x + c] / max(coverage, F32(1e-30))
                brightest = max(brightest, values[y, x, 0, c])
            values[y, x, 0, 3] = r
            weight = F32(1) if brightest <= limit else F32(0)
            if nearer.shape[0] > 0:
                weight *= F32(1) - nearer[y, 4 * x + 3]
                weight = F32(0) if weight < F32(1.013e-3) else weight
            limits[y, x, 0, 0] = weight
            limits[y, x, 0, 1] = r if weight > 0 else F32(np.inf)
            limits[y, x, 0, 2] = r if weight > 0 else F32(-np.inf)
            limits[y, x, 1, 0] = 0
            limits[y, x, 1, 1], limits[y, x, 1, 2] = F32(np.inf), F32(-np.inf)


# Greatest difference in px between the radii of neighbours at half resolution on one surface.
_SAME = 1.013


@entry
def add_structure(values, limits, out):
    """The structure tensor of the first surface as three more values: out [h, w, 2, 7]."""
    height, width = values.shape[:2]
    for y in range(height):
        for x in range(width):
            r = limits[y, x, 0, 2]
            xx = xy = yy = F32(0)
            own = limits[y, x, 1, 0] <= 0  # an edge has no slope
            up = own and y > 0 and _is_alike(limits, y - 1, x, r)
            down = own and y + 1 < height and _is_alike(limits, y + 1, x, r)
            left = own and x > 0 and _is_alike(limits, y, x - 1, r)
            right = own and x + 1 < width and _is_alike(limits, y, x + 1, r)
            v0, v1 = y - 1 if up else y, y + 1 if down else y
            u0, u1 = x - 1 if left else x, x + 1 if right else x
            rows, columns = F32(1) / max(v1 - v0, 1), F32(1) / max(u1 - u0, 1)
            for c in range(3):
                a = (values[y, u1, 0, c] - values[y, u0, 0, c]) * columns
                b = (values[v1, x, 0, c] - values[v0, x, 0, c]) * rows
                xx += a * a
                xy += a * b
                yy += b * b
            for s in range(2):
                for c in range(4):
                    out[y, x, s, c] = values[y, x, s, c]
                for c in range(4, 7):
                    out[y, x, s, c] = F32(0)
            out[y, x, 0, 4], out[y, x, 0, 5], out[y, x, 0, 6] = xx, xy, yy


@compiled
def _is_alike(limits, y, x, r):
    """Whether a coarse pixel holds one surface, of about a radius."""
    return limits[y, x, 1, 0] <= 0 and abs(limits[y, x, 0, 2] - r) < F32(_SAME)


def most_levels(span: float) -> int:
    """The number of levels that a pyramid may have, for radii that span so many px."""
    return max(2, math.ceil(math.log2(max(_WIDER * span, 1))))


def half_level(
    light: NDArray[np.float32],
    radius: NDArray[np.float32],
    limit: float,
    nearer: NDArray[np.float32] | None,
    down: CoarseAxis,
    across: CoarseAxis,
) -> Level:
    """The level of half resolution of a picture; arguments of `first_level`."""
    (height, width), most = radius.shape, 2 * (_ROWS + _BESIDE)
    values, limits = np.zeros((most, width, 2, 4), F32), np.empty((most, width, 2, 3), F32)
    blank = np.zeros((0, 0), np.float32)

    def rows_of(rows: slice) -> Level:
        band = values[: rows.stop - rows.start], limits[: rows.stop - rows.start]
        others = blank if nearer is None else nearer[rows]
        first_level(light[rows], radius[rows], F32(limit), others, *band)
        return band

    return _made_of(rows_of, height, 4, 1, down, across)


def _quarter_level(half: Level, down: CoarseAxis, across: CoarseAxis) -> Level:
    """The level of a quarter of the resolution, with the structure tensor of half of it."""
    height, width = half[0].shape[:2]
    structured = np.empty((2 * (_ROWS + _BESIDE), width, 2, 7), np.float32)

    def rows_of(rows: slice) -> Level:
        values, limits = (x[rows] for x in half)
        add_structure(values, limits, structured[: len(values)])
        return structured[: len(values)], limits

    return _made_of(rows_of, height, 7, 2, down, across)


def pyramid_of(
    half: Level, span: float, down: list[CoarseAxis], across: list[CoarseAxis]
) -> list[Level]:
    """The levels from half resolution on, for radii that span so many px."""
    levels = [half, _quarter_level(half, down[2], across[2])]
    while max(levels[-1][0].shape[:2]) > 1 and 1 << len(levels) < _WIDER * span:
        n = len(levels) + 1
        levels.append(next_level(levels[-1], n, down[n], across[n]))
    return levels

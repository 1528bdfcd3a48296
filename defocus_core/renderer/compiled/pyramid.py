"""A pyramid with two surfaces per coarse pixel, see `inpainting/two_layer_pyramid.py`.

Each coarse pixel has means over its farthest surface and over the next one. Each surface has
limits: the share of the coarse pixel that it covers, and its least and greatest radius.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.renderer.compiled.coarse import Coarse
from defocus_core.renderer.compiled.jit import compiled
from defocus_core.renderer.engine.limits import (
    GROWTH,
    LEAST_WEIGHT,
    ONE_SURFACE,
    ROUNDED,
    SAME_AT_HALF,
    WIDER,
)

F32 = np.float32


class Levels(NamedTuple):
    """The coarse pixels of several levels, one level after another."""

    # [n, 2, 4 or 7] of each surface colour, radius, and maybe the structure tensor
    values: NDArray[np.float32]
    limits: NDArray[np.float32]  # [n, 2, 3]
    size: NDArray[np.int64]  # [levels, 3] where each begins, its height and its width
    place: NDArray[np.float64]  # [levels, 3] px of a coarse pixel, and row and column of pixel 0


def levels_for(coarse: Coarse, span: float) -> tuple[Levels, Levels]:
    """Empty levels: the level of half resolution, and all coarser ones.

    `coarse`: the coarse pixels of all these levels; `span`: greatest minus least radius, in px.
    """
    most = 2
    while coarse.length[most].max() > 1 and 1 << most < WIDER * span:
        most += 1
    half, others = (
        _room(coarse, levels, count)
        for levels, count in ((range(1, 2), 4), (range(2, most + 1), 7))
    )
    return half, others


def _room(coarse: Coarse, levels: range, count: int) -> Levels:
    """Empty levels with room for `count` values of each surface."""
    sizes = coarse.length[levels.start : levels.stop]
    ends = sizes.prod(1).cumsum()
    size = np.column_stack([ends - sizes.prod(1), sizes])
    place = np.column_stack([[1 << n for n in levels], coarse.origin[levels.start : levels.stop]])
    values, limits = (np.empty((ends[-1], 2, n), np.float32) for n in (count, 3))
    return Levels(values, limits, size, place)


@compiled
def fill_levels(light, radius, limit, coarse, half, levels):
    """Fill levels from a picture, leaving out highlights and what nearer surfaces cover.

    light: [n, H, 4 W], first of the surface at the depth of each pixel, then of nearer surfaces
    that cover a share of the pixel; radius: [H, W] px of the first; limit: brightness that a
    highlight exceeds; half, levels: from `levels_for`.
    """
    height, width = radius.shape
    values, limits = np.empty((4 * width, 2, 4), F32), np.empty((4 * width, 2, 3), F32)
    h, w = half.size[0, 1], half.size[0, 2]
    none, one = np.int64(0), np.int64(1)  # called functions would be compiled anew for literals
    for i in range(h):
        top = 2 * i - 1 - coarse.before[1, 0]
        for y in range(max(top, 0), min(top + 4, height)):
            _read_pixels(light, radius, limit, y, values, limits, (y - top) * width)
        source = values, limits, none, top, height, width
        _make_row(source, i, coarse, one, half.values, half.limits, i * w)
    structured, limits = np.empty((4 * w, 2, 7), F32), np.empty((4 * w, 2, 3), F32)
    for n in range(levels.size.shape[0]):
        begin, rows, columns = levels.size[n, 0], levels.size[n, 1], levels.size[n, 2]
        for i in range(rows):
            at = begin + i * columns
            if n > 0:
                before = levels.size[n - 1]
                source = levels.values, levels.limits, before[0], none, before[1], before[2]
                _make_row(source, i, coarse, n + 2, levels.values, levels.limits, at)
                continue
            top = 2 * i - 1 - coarse.before[2, 0]
            for y in range(max(top, 0), min(top + 4, h)):
                _read_structured(half, y, structured, limits, (y - top) * w)
            source = structured, limits, none, top, h, w
            _make_row(source, i, coarse, n + 2, levels.values, levels.limits, at)


@compiled
def _taps(odd, number):
    """The pixels averaged to coarse pixel k, counted from pixel 2 k, and their shares.

    odd: whether the axis has an odd length; number: the number of the level. Returns the first
    pixel, the pixel after the last, and shares.
    """
    shares = np.empty(4)
    for t in range(4):
        shares[t] = 1 - abs(t - 1 if odd else t - 1.5) / 2
    if odd or number > 1:
        return -1, 2 if odd else 3, shares
    shares[:] = 1
    return 0, 2, shares


@compiled
def _make_row(source, i, coarse, number, out, out_limits, at):
    """Compute row `i` of a level: the farthest surface in each coarse pixel, and the next one.

    source: values and limits of the finer level, the index at which its row `top` begins, `top`,
    and its height and width; number: the number of the level; out, out_limits: written from index
    `at` on.
    """
    values, limits, base, top, height, width = source
    alike, count = F32(ONE_SURFACE * GROWTH ** max(number - 2, 0)), values.shape[2]
    a0, a1, down = _taps(coarse.odd[0], number)
    b0, b1, across = _taps(coarse.odd[1], number)
    y0, x0 = 2 * i - coarse.before[number, 0], -coarse.before[number, 1]
    a0, a1 = max(a0, -y0), min(a1, height - y0)
    mean = np.zeros(count)
    for j in range(coarse.length[number, 1]):
        farthest = F32(-np.inf)
        for s in range(2):
            limit = farthest - alike if s else F32(0)
            least, most, total = F32(np.inf), F32(-np.inf), 0.0
            mean[:] = 0
            # the greatest radius of the remaining surfaces, then the sum of surfaces near it
            for step in range(2):
                for a in range(a0, a1):
                    for b in range(b0, b1):
                        x = x0 + 2 * j + b
                        if x < 0 or x >= width:
                            continue
                        p = base + (y0 + a - top) * width + x
                        for k in range(2):
                            weight = limits[p, k, 0]
                            if weight <= 0 or (s and limits[p, k, 1] > limit):
                                continue
                            if step == 0:
                                most = max(most, limits[p, k, 2])
                                continue
                            if limits[p, k, 1] <= most - alike:
                                continue
                            share = weight * down[a + 1] * across[b + 1]
                            total += share
                            least = min(least, limits[p, k, 1])
                            for c in range(count):
                                mean[c] += share * values[p, k, c]
                if most == -np.inf:
                    break
            if s == 0:
                farthest = most
            for c in range(count):
                out[at + j, s, c] = mean[c] / max(total, LEAST_WEIGHT)
            out_limits[at + j, s, 0] = min(total, 1.0)
            out_limits[at + j, s, 1], out_limits[at + j, s, 2] = least, most


@compiled
def _read_pixels(light, radius, limit, y, values, limits, at):
    """Write row `y` of a picture to `values` and `limits` from index `at` on.

    light, radius, limit: as for `fill_levels`.
    """
    for x in range(radius.shape[1]):
        coverage, r, brightest = light[0, y, 4 * x + 3], radius[y, x], F32(0)
        for c in range(3):
            values[at + x, 0, c] = light[0, y, 4 * x + c] / max(coverage, F32(LEAST_WEIGHT))
            brightest = max(brightest, values[at + x, 0, c])
        values[at + x, 0, 3] = r
        weight = F32(1) if brightest <= limit else F32(0)
        if light.shape[0] > 1:
            weight *= F32(1) - light[1, y, 4 * x + 3]
            weight = F32(0) if weight < F32(ROUNDED) else weight
        limits[at + x, 0, 0], limits[at + x, 1, 0] = weight, F32(0)
        limits[at + x, 0, 1] = r if weight > 0 else F32(np.inf)
        limits[at + x, 0, 2] = r if weight > 0 else F32(-np.inf)


@compiled
def _read_structured(half, y, values, limits, at):
    """Write row `y` of the level of half resolution to `values` and `limits` from index `at` on.

    Values 4 to 6 are the structure tensor xx, xy, yy of the farthest surface, 0 of the other one.
    """
    height, width = half.size[0, 1], half.size[0, 2]
    own, ends = half.values, half.limits
    for x in range(width):
        p = y * width + x
        r, alone = ends[p, 0, 2], ends[p, 1, 0] <= 0  # an edge has no slope
        up = p - width if alone and y > 0 and _is_alike(ends, p - width, r) else p
        down = p + width if alone and y + 1 < height and _is_alike(ends, p + width, r) else p
        left = p - 1 if alone and x > 0 and _is_alike(ends, p - 1, r) else p
        right = p + 1 if alone and x + 1 < width and _is_alike(ends, p + 1, r) else p
        rows, columns = F32(1) / max((down - up) // width, 1), F32(1) / max(right - left, 1)
        for s in range(2):
            for c in range(7):
                values[at + x, s, c] = own[p, s, c] if c < 4 else F32(0)
            for c in range(3):
                limits[at + x, s, c] = ends[p, s, c]
        for c in range(3):
            a = (own[right, 0, c] - own[left, 0, c]) * columns
            b = (own[down, 0, c] - own[up, 0, c]) * rows
            values[at + x, 0, 4] += a * a
            values[at + x, 0, 5] += a * b
            values[at + x, 0, 6] += b * b


@compiled
def _is_alike(limits, p, r):
    """Whether coarse pixel `p` holds a single surface, with a radius close to `r`."""
    return limits[p, 1, 0] <= 0 and abs(limits[p, 0, 2] - r) < F32(SAME_AT_HALF)

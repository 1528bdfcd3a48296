"""Surfaces to be blurred: light, radii, slots and slopes, at full or reduced resolution.

A disc many px wide blurs away fine detail: pixels of large radii are averaged to 1/2, 1/4, ... of
the resolution, separately for surfaces nearer than focus and for surfaces beyond it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.renderer.compiled.jit import compiled, entry
from defocus_core.renderer.compiled.openings import FIRST
from defocus_core.renderer.compiled.spread import spread_line, step_of
from defocus_core.renderer.layers.slopes import AREA, HALF_WIDTH, SAME, SMALL

F32 = np.float32
_SMALL = SMALL**2


class SlotSurfaces(NamedTuple):
    """The surfaces at each pixel: the one at its depth, then nearer ones that partly cover it."""

    light: NDArray[np.float32]  # [n, H, 4 W] three colours premultiplied by coverage, and coverage
    radius: NDArray[np.float32]  # [n, H, W] signed, in its own pixels
    slot: NDArray[np.int16]  # [n, H, W], -1 where coverage is 0
    # [2, H, W] slope of the radius of the first one, px per px, x and y; [2, 0, 0] if it is level
    slope: NDArray[np.float32]
    # [H, 4 W] light to add to the left half of the first one, see `lost_shifts`; [0, 0] if none
    moved: NDArray[np.float32]


@compiled
def _find_slots(light, radius, table, level, slot):
    """Write the slot of each pixel by its radius: slot [n, H, W], -1 where coverage is 0.

    radius: in pixels of `level`; table: [2, n], slots of radii nearer than focus and beyond it, in
    steps of 1 / STEPS px of level 0.
    """
    count, height, width = radius.shape
    most = table.shape[1] - 1
    for k in range(count):
        for y in range(height):
            for x in range(width):
                r = radius[k, y, x]
                q = min(step_of(r) << level, most)
                slot[k, y, x] = table[np.int64(r > 0), q] if light[k, y, 4 * x + 3] > 0 else -1


@entry
def surfaces_of(light, radius, table, level, minimum, lost):
    """`SlotSurfaces` of light [n, H, 4 W] and radii [n, H, W].

    table: see `_find_slots`; level: the level of resolution of the pixels; minimum: slope below
    which surfaces count as level; lost: [2, n] of `lost_shifts`, which are restored, or [2, 0] to
    restore none.
    """
    slot = np.empty(radius.shape, np.int16)
    _find_slots(light, radius, table, level, slot)
    moved = np.zeros((0, 0), np.float32)
    if lost.shape[1] > 0:
        moved = np.zeros(light.shape[1:], np.float32)
        _find_moved(light[0], radius[0], lost, moved)
    return SlotSurfaces(light, radius, slot, _slopes(radius[0], minimum), moved)


@compiled
def _limited(a, b):
    """A weighted mean of two differences, in which the smaller one has more weight."""
    a2, b2 = a * a + F32(_SMALL), b * b + F32(_SMALL)
    return (a * b2 + b * a2) / (a2 + b2)


@compiled
def _slopes(radius, minimum):
    """The slopes [2, H, W] of radii, at most 1 long; [2, 0, 0] if none exceeds `minimum`."""
    height, width = radius.shape
    slope, steep = np.empty((2, height, width), np.float32), np.empty((height, width), np.uint8)
    found = False
    for y in range(height):
        up, down = max(y - 1, 0), min(y + 1, height - 1)
        for x in range(width):
            r = radius[y, x]
            left, right = max(x - 1, 0), min(x + 1, width - 1)
            a, b = r - radius[y, left], radius[y, right] - r
            c, d = r - radius[up, x], radius[down, x] - r
            a, b = b if left == x else a, a if right == x else b
            c, d = d if up == y else c, c if down == y else d
            gx, gy = _limited(a, b), _limited(c, d)
            square = gx * gx + gy * gy
            steep[y, x] = square > minimum * minimum
            found |= square > minimum * minimum
            if square > 1:
                short = F32(1) / np.sqrt(square)
                gx, gy = gx * short, gy * short
            slope[0, y, x], slope[1, y, x] = gx, gy
    if found and _keep_wide_slopes(slope, steep):
        return slope
    return np.zeros((2, 0, 0), np.float32)


@compiled
def _keep_wide_slopes(slope, steep):
    """Set slopes to 0 where few of the pixels around are steep; return whether any are left.

    steep: [H, W], 1 where a pixel is steep.
    """
    height, width = steep.shape
    columns, counts = np.zeros(width + 1, np.int32), np.zeros(width, np.int32)
    kept = False
    for y in range(-HALF_WIDTH, height):
        for x in range(width):
            if y + HALF_WIDTH < height:
                counts[x] += steep[y + HALF_WIDTH, x]
            if y > HALF_WIDTH:
                counts[x] -= steep[y - HALF_WIDTH - 1, x]
        if y < 0:
            continue
        for x in range(width):
            columns[x + 1] = columns[x] + counts[x]
        rows = min(y + HALF_WIDTH + 1, height) - max(y - HALF_WIDTH, 0)
        for x in range(width):
            first, end = max(x - HALF_WIDTH, 0), min(x + HALF_WIDTH + 1, width)
            many = columns[end] - columns[first] > AREA * (rows * (end - first))
            if steep[y, x] and many:
                kept = True
            else:
                slope[0, y, x] = slope[1, y, x] = 0
    return kept


@compiled
def _find_moved(light, radius, lost, moved):
    """Write the light to add to the left half where its shifts are lost: moved [H, 4 W].

    lost: [2, n] of `lost_shifts`; coverage stays 0.
    """
    height, width = radius.shape
    for y in range(height):
        for x in range(width):
            r = radius[y, x]
            q = step_of(r)
            shift = lost[np.int64(r > 0), q] if q < lost.shape[1] else F32(0)
            before = x > 0 and abs(radius[y, x - 1] - r) < F32(SAME)
            after = x + 1 < width and abs(radius[y, x + 1] - r) < F32(SAME)
            weight = -shift / max(F32(before) + F32(after), F32(1))
            first, last = x - 1 if before else x, x + 1 if after else x
            if weight == 0 or first == last:
                continue
            whole = light[y, 4 * x + 3]
            a = whole * weight / max(light[y, 4 * first + 3], F32(1e-6))
            b = whole * weight / max(light[y, 4 * last + 3], F32(1e-6))
            for i in range(3):
                moved[y, 4 * x + i] = b * light[y, 4 * last + i] - a * light[y, 4 * first + i]


@compiled
def spread_row(surfaces, y, band, opening, room):
    """Spread the row of the surfaces that is closest to row y, over the rows [band[0], band[1]).

    surfaces: `SlotSurfaces`; opening: `Opening`; room: `Room`.
    """
    line, (count, height, width) = room.line, surfaces.radius.shape
    light, radius, slot, slope, moved = surfaces
    before, row = line.before, min(max(y, 0), height - 1)
    to_light, to_radius, to_slot, to_slope, to_moved = line[:5]
    sloping, moving = slope.shape[1] > 0, moved.shape[0] > 0
    for k in range(count):
        own = k == 0  # parts of nearer surfaces have other slopes, which are not known
        for j in range(width + 2 * before):  # what goes on beyond the frame is as on its edge
            x = min(max(j - before, 0), width - 1)
            to_slot[j], to_radius[j] = slot[k, row, x], radius[k, row, x]
            for i in range(4):
                to_light[4 * j + i] = light[k, row, 4 * x + i]
                if moving:
                    to_moved[4 * j + i] = moved[row, 4 * x + i] if own else F32(0)
            if sloping:
                to_slope[0, j] = slope[0, row, x] if own and x == j - before else F32(0)
                to_slope[1, j] = slope[1, row, x] if own and y == row else F32(0)
        spread_line(line, y, band, opening, room.ring)


@compiled
def _clear(sums, slot, first, end):
    for view in range(sums.shape[0]):
        for i in range(4):
            for x in range(first, end):
                sums[view, slot, i, x] = 0


@compiled
def add_points(surfaces, y, shares, room):
    """Add the light near focus that stays in its pixel to the sums of row y.

    surfaces: `SlotSurfaces`; shares: for each radius in steps, the share of the light that is
    spread over a disc; room: `Room`.
    """
    sums, ends, views = room.sums, room.ends, room.ring.views
    light, radius, slot, _, moved = surfaces
    for k in range(radius.shape[0]):
        moving = k == 0 and moved.shape[0] > 0
        for x in range(radius.shape[2]):
            s, q = slot[k, y, x], step_of(radius[k, y, x])
            if s < 0 or q >= FIRST:
                continue
            if ends[1, s] < 0:
                ends[0, s], ends[1, s] = x, x - 1
            _clear(sums, s, x, ends[0, s])
            _clear(sums, s, ends[1, s] + 1, x + 1)
            for view in range(views):
                for i in range(4):
                    sums[view, s, i, x] += light[k, y, 4 * x + i] * (F32(1) - shares[q])
                    if moving and view == 1:
                        sums[1, s, i, x] += moved[y, 4 * x + i] * (F32(1) - shares[q])
            ends[0, s], ends[1, s] = min(ends[0, s], x), max(ends[1, s], x)


@entry
def halved(surfaces, levels, level, side, coarse, table):
    """Surfaces on one side of focus, averaged to the coarse pixels of `level`.

    surfaces: `SlotSurfaces` in pixels of the next finer level; levels: for each slot, the level at
    which it is blurred: slots of finer levels are left out; side: whether beyond focus; coarse:
    `Coarse`; table: see `_find_slots`. Pixels on the edge of the frame are repeated beyond it.
    """
    h, w = coarse.length[level, 0], coarse.length[level, 1]
    light, radius = np.zeros((1, h, 4 * w), np.float32), np.zeros((1, h, w), np.float32)
    sloping = surfaces.slope.shape[1] > 0
    slope = np.zeros((2, h, w), np.float32) if sloping else np.zeros((2, 0, 0), np.float32)
    for i in range(h):
        for k in range(surfaces.radius.shape[0]):
            for a in range(2 + coarse.odd[0]):
                y = 2 * i + a - coarse.before[level, 0] - coarse.odd[0]
                down = F32(0.5) if not coarse.odd[0] or a == 1 else F32(0.25)
                _add_row(
                    surfaces, k, y, (levels, level, side), coarse, down, i, light, radius, slope
                )
        for j in range(w):
            coverage = light[0, i, 4 * j + 3]
            if coverage <= 0:
                continue
            radius[0, i, j] = F32(0.5) * radius[0, i, j] / coverage
            if sloping:
                slope[0, i, j] /= coverage
                slope[1, i, j] /= coverage
    slot = np.empty(radius.shape, np.int16)
    _find_slots(light, radius, table, level, slot)
    return SlotSurfaces(light, radius, slot, slope, np.zeros((0, 0), np.float32))


@compiled
def _add_row(surfaces, k, y, wanted, coarse, down, i, light, radius, slope):
    """Add row `y` of surface `k`, times the share `down`, to row `i` of coarse pixels.

    wanted: levels, level and side, as for `halved`; light, radius, slope: coarse pixels; radii and
    slopes are weighted by coverage.
    """
    (levels, level, side), (height, width) = wanted, surfaces.radius.shape[1:]
    given, radii, slot, slopes, _ = surfaces
    row, odd, before = min(max(y, 0), height - 1), coarse.odd[1], coarse.before[level, 1]
    sloping = k == 0 and slopes.shape[1] > 0
    for j in range(radius.shape[2]):
        for b in range(2 + odd):
            x = 2 * j + b - before - odd
            column = min(max(x, 0), width - 1)
            s, r = slot[k, row, column], radii[k, row, column]
            if s < 0 or levels[s] < level or (r > 0) != side:
                continue
            share = down * (F32(0.5) if not odd or b == 1 else F32(0.25))
            for c in range(4):
                light[0, i, 4 * j + c] += share * given[k, row, 4 * column + c]
            weight = share * given[k, row, 4 * column + 3]
            radius[0, i, j] += weight * r
            if sloping and x == column:
                slope[0, i, j] += weight * slopes[0, row, column]
            if sloping and y == row:
                slope[1, i, j] += weight * slopes[1, row, column]

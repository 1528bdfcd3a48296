"""Surfaces as they are spread: light, radii, layers and slopes of pixels, at full size or less.

A disc many px wide blurs away fine detail: pixels of large radii are averaged to half, a quarter,
... of the resolution, those nearer than focus and those beyond it apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.renderer.compiled.jit import compiled, entry
from defocus_core.renderer.compiled.openings import HALF, STEPS
from defocus_core.renderer.compiled.spread import spread_line

F32 = np.float32


class SlotSurface(NamedTuple):
    """One surface at each pixel."""

    light: NDArray[np.float32]  # [H, 4 W] three colours premultiplied by coverage, and coverage
    radius: NDArray[np.float32]  # [H, W] signed, in its own pixels
    slot: NDArray[np.int16]  # [H, W], -1 where nothing is
    slope: NDArray[np.float32]  # [2, H, W] of the radius, px per px, x and y; [2, 0, 0] if level
    # [H, 4 W] what the light of the left half has more, see `lost` of openings; [0, 0] if nothing
    moved: NDArray[np.float32]


@entry
def slots_of(radius, light, table, out):
    """The slot of each pixel by its radius: out [H, W], -1 where coverage is 0.

    table: [2, n] of radii nearer than focus and beyond it, in STEPS of a px.
    """
    height, width = radius.shape
    most = table.shape[1] - 1
    for y in range(height):
        for x in range(width):
            r = radius[y, x]
            q = min(np.int64(abs(r) * F32(STEPS) + F32(1 - HALF)), most)
            out[y, x] = table[np.int64(r > 0), q] if light[y, 4 * x + 3] > 0 else -1


# As in `layers/slopes.py`.
_SMALL, _AROUND, _AREA = 0.05**2, 5, 0.345


@compiled
def _limited(a, b):
    """A mean of two differences in which the lesser counts more."""
    a2, b2 = a * a + F32(_SMALL), b * b + F32(_SMALL)
    return (a * b2 + b * a2) / (a2 + b2)


@entry
def find_slopes(radius, minimum, slope, steep):
    """The slope of each pixel's surface, at most 1 long: slope [2, H, W], steep [H, W] uint8.

    Returns whether any is longer than the minimum.
    """
    height, width = radius.shape
    found = False
    for y in range(height):
        up, down = max(y - 1, 0), min(y + 1, height - 1)
        for x in range(width):
            r = radius[y, x]
            left, right = max(x - 1, 0), min(x + 1, width - 1)
            a, b = r - radius[y, left], radius[y, right] - r
            c, d = r - radius[up, x], radius[down, x] - r
            if left == x:
                a = b
            if right == x:
                b = a
            if up == y:
                c = d
            if down == y:
                d = c
            gx, gy = _limited(a, b), _limited(c, d)
            square = gx * gx + gy * gy
            steep[y, x] = square > minimum * minimum
            found |= square > minimum * minimum
            if square > 1:
                short = F32(1) / np.sqrt(square)
                gx, gy = gx * short, gy * short
            slope[0, y, x], slope[1, y, x] = gx, gy
    return found


@entry
def keep_wide_slopes(slope, steep):
    """Take away slopes that hold for few of the pixels around; returns whether any is left."""
    height, width = steep.shape
    columns = np.zeros(width + 1, np.int32)
    counts = np.zeros(width, np.int32)
    kept = False
    for y in range(min(_AROUND, height)):
        for x in range(width):
            counts[x] += steep[y, x]
    for y in range(height):
        if y + _AROUND < height:
            for x in range(width):
                counts[x] += steep[y + _AROUND, x]
        if y > _AROUND:
            for x in range(width):
                counts[x] -= steep[y - _AROUND - 1, x]
        for x in range(width):
            columns[x + 1] = columns[x] + counts[x]
        rows = min(y + _AROUND + 1, height) - max(y - _AROUND, 0)
        for x in range(width):
            first, end = max(x - _AROUND, 0), min(x + _AROUND + 1, width)
            many = columns[end] - columns[first] > _AREA * (rows * (end - first))
            if steep[y, x] and many:
                kept = True
            else:
                slope[0, y, x] = slope[1, y, x] = 0
    return kept


def slopes(radius: NDArray[np.float32], minimum: float) -> NDArray[np.float32]:
    """The slopes [2, H, W] of a surface, see `layers/slopes.py`; [2, 0, 0] if it is level."""
    slope, steep = np.empty((2, *radius.shape), np.float32), np.empty(radius.shape, np.uint8)
    if find_slopes(radius, F32(minimum), slope, steep) and keep_wide_slopes(slope, steep):
        return slope
    return np.zeros((2, 0, 0), np.float32)


# Neighbours whose radii differ by less, in px, are of one surface.
_SAME = 0.513


@entry
def find_moved(light, radius, lost, moved):
    """What the left half has more where shifts are lost: moved [H, 4 W], coverage as it is."""
    height, width = radius.shape
    for y in range(height):
        for x in range(width):
            r = radius[y, x]
            q = np.int64(abs(r) * F32(STEPS) + F32(1 - HALF))
            shift = lost[np.int64(r > 0), q] if q < lost.shape[1] else F32(0)
            before = x > 0 and abs(radius[y, x - 1] - r) < F32(_SAME)
            after = x + 1 < width and abs(radius[y, x + 1] - r) < F32(_SAME)
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
def read_line(surface, y, before, line):
    """Copy the row nearest to y to a line, with what goes on beyond the frame."""
    height, width = surface.radius.shape
    row = min(max(y, 0), height - 1)
    sloping, moving = surface.slope.shape[1] > 0, surface.moved.shape[0] > 0
    beyond = y != row
    for j in range(width + 2 * before):
        x = min(max(j - before, 0), width - 1)
        line.slot[j] = surface.slot[row, x]
        line.radius[j] = surface.radius[row, x]
        for i in range(4):
            line.light[4 * j + i] = surface.light[row, 4 * x + i]
            if moving:
                line.moved[4 * j + i] = surface.moved[row, 4 * x + i]
        if sloping:
            line.slope[0, j] = surface.slope[0, row, x] if x == j - before else F32(0)
            line.slope[1, j] = F32(0) if beyond else surface.slope[1, row, x]


@compiled
def spread_row(surface, y, band, opening, room):
    """Spread the row of a surface that is nearest to y within the rows [band[0], band[1])."""
    read_line(surface, y, room.line.before, room.line)
    spread_line(room.line, y, band, opening, room.ring, room.work)


@entry
def add_halved(light, radius, slope, present, shift, odd, out, sums):
    """Add the pixels present [H, W] to coarse ones that they are part of.

    shift: (down, across) pixels missing before the first; odd: the same, whether every second pixel
    makes a coarse one with half of its neighbours. out: [h, 4 w] light; sums: [3, h, w] coverage
    times radius and slopes. Pixels beyond the frame are those on its edge.
    """
    height, width = radius.shape
    h, w = out.shape[0], out.shape[1] // 4
    sloping = slope.shape[1] > 0
    rows, columns = 2 + odd[0], 2 + odd[1]
    for i in range(h):
        for a in range(rows):
            y = 2 * i + a - shift[0] - odd[0]
            row = min(max(y, 0), height - 1)
            down = F32(0.5) if odd[0] == 0 or a == 1 else F32(0.25)
            for j in range(w):
                for b in range(columns):
                    x = 2 * j + b - shift[1] - odd[1]
                    column = min(max(x, 0), width - 1)
                    if not present[row, column]:
                        continue
                    share = down * (F32(0.5) if odd[1] == 0 or b == 1 else F32(0.25))
                    for c in range(4):
                        out[i, 4 * j + c] += share * light[row, 4 * column + c]
                    weight = share * light[row, 4 * column + 3]
                    sums[0, i, j] += weight * radius[row, column]
                    if sloping:
                        if x == column:
                            sums[1, i, j] += weight * slope[0, row, column]
                        if y == row:
                            sums[2, i, j] += weight * slope[1, row, column]


@entry
def finish_halved(out, sums, radius, slope):
    """Means of what was added: radius [h, w] in coarse pixels, slope [2, h, w] or [2, 0, 0]."""
    h, w = radius.shape
    for i in range(h):
        for j in range(w):
            coverage = out[i, 4 * j + 3]
            if coverage <= 0:
                continue
            radius[i, j] = F32(0.5) * sums[0, i, j] / coverage
            if slope.shape[1] > 0:
                slope[0, i, j] = sums[1, i, j] / coverage
                slope[1, i, j] = sums[2, i, j] / coverage


@entry
def is_of(slot, levels, radius, level, side, out):
    """Whether pixels are of a slot that is spread at a coarser level, and of a side of focus."""
    height, width = slot.shape
    found = False
    for y in range(height):
        for x in range(width):
            s = slot[y, x]
            out[y, x] = s >= 0 and levels[s] > level and (radius[y, x] > 0) == side
            found |= out[y, x] > 0
    return found

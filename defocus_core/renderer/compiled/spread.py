"""Light of pixels spread over their discs: additions at the ends of spans, summed along rows.

A pixel adds its light where its disc begins in a row and takes it away where it ends; running sums
along the row are the discs. Rows are kept in a ring, for each slot as many as its widest disc has.
Light is premultiplied: three colours and coverage, one pixel after another.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.renderer.compiled.jit import compiled
from defocus_core.renderer.compiled.openings import FIRST, HALF, SECOND, STEPS

F32 = np.float32
_NOTHING = 1 << 30
# Pixels of one radius that are spread one by one: a run of so few takes longer.
_FEW = 12


class SurfaceRow(NamedTuple):
    """A row of pixels with those that go on beyond the frame on both sides."""

    light: NDArray[np.float32]  # [4 n]
    radius: NDArray[np.float32]  # [n] px
    slot: NDArray[np.int16]  # [n], -1 where nothing is
    slope: NDArray[np.float32]  # [2, n] px per px, x and y
    moved: NDArray[np.float32]  # [4 n] what the light of the left half has more
    before: int  # pixels before the first one of the frame


class Ring(NamedTuple):
    """Differences along the rows that discs still reach."""

    sums: NDArray[np.float32]  # rows of `views` times 4 (width + 2)
    pixels: NDArray[np.float32]  # the same as pixels [n, 4]
    start: NDArray[np.int64]  # [slots] first row of each slot
    rows: NDArray[np.int64]  # [slots] number of its rows
    first: NDArray[np.int64]  # [rows] first pixel that differs from 0
    last: NDArray[np.int64]  # [rows] last one; -1 where none does
    reached: NDArray[np.int64]  # [slots, 3] by the line that is spread, see `_mark`
    views: int  # 1: the centre; 2: the centre and its left half
    width: int


class Room(NamedTuple):
    """Room to spread slots in."""

    ring: Ring
    line: SurfaceRow
    work: NDArray[np.float32]  # [6, 4 n] to compute in
    reach: int  # the greatest of the slots, in rows


def room_of(reach: list[int], views: int, width: int) -> Room:
    """Room for slots that reach so many rows each; 0 for slots that are not spread."""
    most = max(reach, default=0)
    rows = [most + n + 1 if n else 0 for n in reach]
    start = np.cumsum([0, *rows])
    total = int(start[-1])
    sums = np.zeros(total * views * 4 * (width + 2), np.float32)
    ring = Ring(
        sums,
        sums.reshape(-1, 4),
        start[:-1].astype(np.int64),
        np.array(rows, np.int64),
        np.full(total, _NOTHING, np.int64),
        np.full(total, -1, np.int64),
        np.array([[_NOTHING, -1, 0]] * len(rows), np.int64).reshape(-1, 3),
        views,
        width,
    )
    n = width + 2 * most
    line = SurfaceRow(
        *(np.zeros(4 * n, np.float32), np.zeros(n, np.float32), np.zeros(n, np.int16)),
        *(np.zeros((2, n), np.float32), np.zeros(4 * n, np.float32), most),
    )
    return Room(ring, line, np.empty((6, 4 * n), np.float32), most)


@compiled
def add_ends(sums, a, c, x0, n, width, off, sign):
    """Add a run of pixels, whose spans end `off` px from their middles, to a row at index a.

    c: [4 n] light; x0: the first pixel.
    """
    p = off + F32(0.5)
    i0 = np.int64(np.int32(p + F32(8192))) - 8192
    f = F32((p - F32(i0)) * sign)
    g = F32(sign - f)
    s, j = x0 + i0, 0
    if s < 0:
        j = min(-s, n)
        for t in range(j):
            for i in range(4):
                sums[a + i] += c[4 * t + i] * sign
        if j == n:
            return
    if s + n > width:
        if width - s <= j:
            return
        n = width - s
    o = a + 4 * s
    for i in range(4):
        sums[o + 4 * j + i] += c[4 * j + i] * g
    m = 4 * (n - j - 1)
    if m > 0:
        d = sums[o + 4 * (j + 1) : o + 4 * n]
        c1, c0 = c[4 * (j + 1) : 4 * n], c[4 * j : 4 * (n - 1)]
        for t in range(m):
            d[t] += c1[t] * g + c0[t] * f
    for i in range(4):
        sums[o + 4 * n + i] += c[4 * (n - 1) + i] * f


@compiled
def add_span(pixels, a, width, begin, end, q0, q1, q2, q3):
    """Add the span [begin, end] px of one pixel to a row of pixels [n, 4] that begins at a."""
    begin, end = min(max(begin, F32(0)), width), min(max(end, F32(0)), width)
    below_begin, below_end = np.floor(begin), np.floor(end)
    f, g = begin - below_begin, end - below_end
    f1, g1 = F32(1) - f, F32(1) - g
    o = np.uint64(a + np.int64(np.int32(below_begin)))  # unsigned: not counted from the end
    pixels[o, 0] += q0 * f1
    pixels[o, 1] += q1 * f1
    pixels[o, 2] += q2 * f1
    pixels[o, 3] += q3 * f1
    o += np.uint64(1)
    pixels[o, 0] += q0 * f
    pixels[o, 1] += q1 * f
    pixels[o, 2] += q2 * f
    pixels[o, 3] += q3 * f
    o = np.uint64(a + np.int64(np.int32(below_end)))
    pixels[o, 0] -= q0 * g1
    pixels[o, 1] -= q1 * g1
    pixels[o, 2] -= q2 * g1
    pixels[o, 3] -= q3 * g1
    o += np.uint64(1)
    pixels[o, 0] -= q0 * g
    pixels[o, 1] -= q1 * g
    pixels[o, 2] -= q2 * g
    pixels[o, 3] -= q3 * g


@compiled
def _spread_pixel(pixels, light, moved, lean, spans, q, place, to, half):
    """Spread one pixel over rows of pixels [n, 4].

    light: its four channels; moved: what three of them have more in the left half; lean: its
    slopes, divided by its radius; q: the number of its radius; place: column and row, the first row
    that its disc reaches and the one after the last, and the side of focus; to: the first row of
    its slot in the ring, the number of its rows, views, and pixels in a row; half: the area of the
    disc divided by that of its left half.
    """
    q0, q1, q2, q3 = light
    gx, gy = lean
    m0, m1, m2 = moved
    column, row, begin, end, side = place
    start, rows, views, width = to
    reach = spans.shape[2] // 2
    x, zero, one, right = F32(column) + F32(0.5), F32(0), F32(1), F32(width)
    tilted = gx != 0 or gy != 0
    moving = views == 2 and (m0 != 0 or m1 != 0 or m2 != 0)
    k = begin % rows
    for y in range(begin, end):
        dy = y - row
        lo, hi = spans[side, q, reach + dy, 0], spans[side, q, reach + dy, 1]
        a = (start + k) * views * (width + 2)
        k = k + 1 if k + 1 < rows else 0
        if hi <= lo or x + hi <= zero or x + lo >= right:
            continue
        if moving:  # over the whole disc: the right half has as much less in the same places
            add_span(pixels, a + width + 2, right, x + lo, x + hi, m0, m1, m2, zero)
        if not tilted:
            add_span(pixels, a, right, x + lo, x + hi, q0, q1, q2, q3)
            if views == 2:
                b, e = (lo, min(hi, zero)) if side else (max(lo, zero), hi)
                if e > b:
                    h0, h1, h2 = q0 * half, q1 * half, q2 * half
                    add_span(pixels, a + width + 2, right, x + b, x + e, h0, h1, h2, q3 * half)
            continue
        middle = min(max(zero, lo), hi)
        w = one + gy * F32(dy)
        v0 = max(w + gx * F32(0.5) * (lo + middle), zero)
        v1 = max(w + gx * F32(0.5) * (middle + hi), zero)
        m = x + middle
        add_span(pixels, a, right, x + lo, m, q0 * v0, q1 * v0, q2 * v0, q3 * v0)
        add_span(pixels, a, right, m, x + hi, q0 * v1, q1 * v1, q2 * v1, q3 * v1)
        if views == 2:
            b, e = (x + lo, m) if side else (m, x + hi)
            w = v0 if side else v1
            w *= half
            add_span(pixels, a + width + 2, right, b, e, q0 * w, q1 * w, q2 * w, q3 * w)


@compiled
def _run_of(line, j, n, scale, moves, work):
    """Copy n pixels of a line, times a scale, to work: light, what slopes add to it, and moves.

    Returns whether some have slopes across, down, and moves.
    """
    c, cx, cy, cm = work[0], work[1], work[2], work[5]
    for t in range(4 * n):
        c[t] = line.light[4 * j + t] * scale
    upright = level = moving = False
    for t in range(n):
        upright |= line.slope[0, j + t] != 0
        level |= line.slope[1, j + t] != 0
    if upright or level:
        for t in range(n):
            turned = F32(1) / line.radius[j + t]
            gx, gy = line.slope[0, j + t] * turned, line.slope[1, j + t] * turned
            for i in range(4):
                cx[4 * t + i] = c[4 * t + i] * gx
                cy[4 * t + i] = c[4 * t + i] * gy
    if moves:
        for t in range(4 * n):
            cm[t] = line.moved[4 * j + t] * scale
            moving |= cm[t] != 0
    return upright, level, moving


@compiled
def _spread_run(line, j, n, place, opening, q, ring, slot, scale, half, work):
    """Spread n pixels of one radius, from the j-th of a line on.

    place, scale, half: as of `_spread_pixel`, without the column; and one divided by the area.
    """
    width, views = ring.width, ring.views
    y, begin, end, side = place
    stride = 4 * (width + 2)
    x0 = j - line.before
    zero, one = F32(0), F32(1)
    c, cx, cy, tl, tr, cm = work[0], work[1], work[2], work[3], work[4], work[5]
    upright, level, moving = _run_of(line, j, n, scale, views == 2, work)
    reach = opening.reach
    for row in range(begin, end):
        dy = row - y
        lo, hi = opening.spans[side, q, reach + dy, 0], opening.spans[side, q, reach + dy, 1]
        if hi <= lo:
            continue
        a = (ring.start[slot] + row % ring.rows[slot]) * views * stride
        b, e = (lo, min(hi, zero)) if side else (max(lo, zero), hi)
        if moving:  # over the whole disc, as above
            add_ends(ring.sums, a + stride, cm, x0, n, width, lo, one)
            add_ends(ring.sums, a + stride, cm, x0, n, width, hi, -one)
        if not upright:
            light = c
            if level:
                light, away = tl, F32(dy)
                for t in range(4 * n):
                    tl[t] = c[t] + cy[t] * away
            add_ends(ring.sums, a, light, x0, n, width, lo, one)
            add_ends(ring.sums, a, light, x0, n, width, hi, -one)
            if views == 2 and e > b:
                add_ends(ring.sums, a + stride, light, x0, n, width, b, half)
                add_ends(ring.sums, a + stride, light, x0, n, width, e, -half)
            continue
        middle = min(max(zero, lo), hi)
        left, right, away = F32(0.5) * (lo + middle), F32(0.5) * (middle + hi), F32(dy)
        for t in range(4 * n):
            light_there = c[t] + cy[t] * away
            tl[t] = light_there + cx[t] * left
            tr[t] = light_there + cx[t] * right
        own = tl if side else tr
        if views == 2 and e > b:
            add_ends(ring.sums, a + stride, own, x0, n, width, b, half)
            add_ends(ring.sums, a + stride, own, x0, n, width, e, -half)
        add_ends(ring.sums, a, tl, x0, n, width, lo, one)
        add_ends(ring.sums, a, tr, x0, n, width, hi, -one)
        for t in range(4 * n):
            tr[t] -= tl[t]
        add_ends(ring.sums, a, tr, x0, n, width, middle, one)


@compiled
def _mark(ring, reached, y, band, before):
    """Note which pixels the slots of a line reach: [slots, 3] first, last and radius in px."""
    for s in range(reached.shape[0]):
        if reached[s, 1] < 0:
            continue
        r = reached[s, 2]
        first, last = reached[s, 0] - before - r, reached[s, 1] - before + r
        first, last = max(first, 0), min(last, ring.width)
        for row in range(max(y - r, band[0]), min(y + r + 1, band[1])):
            k = ring.start[s] + row % ring.rows[s]
            ring.first[k] = min(ring.first[k], first)
            ring.last[k] = max(ring.last[k], last)
        reached[s, 0], reached[s, 1], reached[s, 2] = _NOTHING, -1, 0


@compiled
def spread_line(line, y, band, opening, ring, work):
    """Spread the pixels of a line at row y, within the rows [band[0], band[1])."""
    # arrays of records are counted each time they are named: once is enough
    light, radius, slots, slope = line.light, line.radius, line.slot, line.slope
    spans, area, left_area, shares = opening.spans, opening.area, opening.left_area, opening.share
    pixels, starts, rows, reached = ring.pixels, ring.start, ring.rows, ring.reached
    more = line.moved
    before, reach, views, width = line.before, opening.reach, ring.views, ring.width
    # not 0 itself: what is called would be compiled for a literal, too
    x, count, most = np.int64(0), radius.shape[0], area.shape[0] - 1
    while x < count:
        slot = slots[x]
        if slot < 0:
            x += 1
            continue
        r = radius[x]
        q, side = min(np.int64(abs(r) * F32(STEPS) + F32(1 - HALF)), most), np.int64(r > 0)
        n = 1
        while x + n < count and slots[x + n] == slot:
            other = radius[x + n]
            if np.int64(other > 0) != side:
                break
            if min(np.int64(abs(other) * F32(STEPS) + F32(1 - HALF)), most) != q:
                break
            n += 1
        share = shares[q]
        for k in range(2):
            if k == 1:  # the rest of pixels near focus
                share = F32(1) - share
                if q >= SECOND or q < FIRST or share <= 0:
                    break
            p = q if q >= SECOND else SECOND if q >= FIRST and k == 0 else FIRST
            rn = min(p // STEPS + 1, reach)
            if share <= 0:
                continue
            reached[slot, 0] = min(reached[slot, 0], x)
            reached[slot, 1] = max(reached[slot, 1], x + n)
            reached[slot, 2] = max(reached[slot, 2], rn + 1)
            scale, half = area[p] * share, left_area[side, p] / area[p]
            begin, end = max(y - rn, band[0]), min(y + rn + 1, band[1])
            if n >= _FEW:
                place = y, begin, end, side
                _spread_run(line, x, n, place, opening, p, ring, slot, scale, half, work)
                continue
            to = starts[slot], rows[slot], views, width
            for j in range(x, x + n):
                q0, q1 = light[4 * j] * scale, light[4 * j + 1] * scale
                q2, q3 = light[4 * j + 2] * scale, light[4 * j + 3] * scale
                turned = F32(1) / radius[j]
                lean = slope[0, j] * turned, slope[1, j] * turned
                place = j - before, y, begin, end, side
                m0, m1, m2 = more[4 * j] * scale, more[4 * j + 1] * scale, more[4 * j + 2] * scale
                _spread_pixel(
                    *(pixels, (q0, q1, q2, q3), (m0, m1, m2), lean, spans, p, place, to, half)
                )
        x += n
    _mark(ring, reached, y, band, before)


@compiled
def take_row(ring, slot, y, view, out):
    """The sums of a row of a slot: [4, width] planes in `out`, from the first to the last pixel.

    Returns both; the last is -1 where nothing is.
    """
    k = ring.start[slot] + y % ring.rows[slot]
    first, last = ring.first[k], min(ring.last[k], ring.width - 1)
    if ring.last[k] < 0 or first > last:
        return 0, -1
    a = (k * ring.views + view) * 4 * (ring.width + 2)
    s0 = s1 = s2 = s3 = F32(0)
    for x in range(first, last + 1):
        o = a + 4 * x
        s0 += ring.sums[o]
        s1 += ring.sums[o + 1]
        s2 += ring.sums[o + 2]
        s3 += ring.sums[o + 3]
        out[0, x], out[1, x], out[2, x], out[3, x] = s0, s1, s2, s3
    return first, last


@compiled
def clear_row(ring, slot, y):
    """Make room for another row of a slot, where row y was."""
    k = ring.start[slot] + y % ring.rows[slot]
    if ring.last[k] >= 0:
        stride = 4 * (ring.width + 2)
        for view in range(ring.views):
            a = (k * ring.views + view) * stride
            ring.sums[a + 4 * ring.first[k] : a + min(4 * (ring.last[k] + 2), stride)] = 0
    ring.first[k], ring.last[k] = _NOTHING, -1


@compiled
def add_points(light, radius, slots, shares, slot, row, first, last):
    """Add to the sums of a slot [4, width], not 0 from first to last, what stays in its pixels.

    light: [4 width]; shares: of the disc near focus. Returns the first and last pixel
    that is not 0.
    """
    zero = F32(0)
    for x in range(radius.shape[0]):
        if slots[x] != slot:
            continue
        q = np.int64(abs(radius[x]) * F32(STEPS) + F32(1 - HALF))
        if q >= FIRST:
            continue
        if last < 0:
            first = last = x
            row[0, x] = row[1, x] = row[2, x] = row[3, x] = zero
        while last < x:
            last += 1
            row[0, last] = row[1, last] = row[2, last] = row[3, last] = zero
        while first > x:
            first -= 1
            row[0, first] = row[1, first] = row[2, first] = row[3, first] = zero
        share = F32(1) - shares[q]
        row[0, x] += light[4 * x] * share
        row[1, x] += light[4 * x + 1] * share
        row[2, x] += light[4 * x + 2] * share
        row[3, x] += light[4 * x + 3] * share
    return first, last

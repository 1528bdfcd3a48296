"""Light of pixels spread over their discs: additions at the ends of spans, summed along rows.

In each row, a pixel adds its light where its disc begins and subtracts it where its disc ends; the
running sums along the row are the discs. Rows are kept in a ring buffer, for each slot as many as
its widest disc has. Light is premultiplied: three colours and coverage, one pixel after another.
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
    """A row of pixels, continued beyond the frame on both sides."""

    light: NDArray[np.float32]  # [4 n]
    radius: NDArray[np.float32]  # [n] px
    slot: NDArray[np.int16]  # [n], -1 where coverage is 0
    slope: NDArray[np.float32]  # [2, n] px per px, x and y
    moved: NDArray[np.float32]  # [4 n] light to add to the left half
    work: NDArray[np.float32]  # [4, 4 n] to compute in
    before: int  # pixels before the first one of the frame


class Ring(NamedTuple):
    """A ring buffer of the rows that discs can still reach, as differences between pixels."""

    sums: NDArray[np.float32]  # flat: rows of `views` times 4 (width + 2) numbers
    pixels: NDArray[np.float32]  # the same as pixels [n, 4]
    start: NDArray[np.int64]  # [slots] first row of each slot
    rows: NDArray[np.int64]  # [slots] number of rows of each slot; 0 for slots that are not spread
    first: NDArray[np.int64]  # [rows] first pixel that differs from 0
    last: NDArray[np.int64]  # [rows] last pixel that differs from 0; -1 if none does
    reached: NDArray[np.int64]  # [slots, 3] pixels that the present line reaches, see `_mark`
    views: int  # 1: the centre; 2: the centre and its left half
    width: int


class Room(NamedTuple):
    """Memory in which slots are spread, and memory for one row of their sums."""

    ring: Ring
    line: SurfaceRow
    sums: NDArray[np.float32]  # [1 or 3, slots, 4, width], of two views also the right half
    ends: NDArray[np.int64]  # [2, slots] first and last pixel of a row that is not 0; -1 if none
    reach: int  # the greatest of the slots, in rows


def room_of(reach: list[int], views: int, width: int) -> Room:
    """Memory in which the light of slots is spread over discs.

    reach: for each slot, the number of rows that its discs reach up and down; 0 for slots that are
    not spread; views: 2 if the left half is needed, else 1; width: of a row in px.
    """
    most = max(reach, default=0)
    rows = np.array([most + n + 1 if n else 0 for n in reach], np.int64)
    start = rows.cumsum() - rows
    total, n = int(rows.sum()), width + 2 * most
    sums = np.zeros(total * views * 4 * (width + 2), np.float32)
    marks = np.full(total, _NOTHING, np.int64), np.full(total, -1, np.int64)
    reached = np.full((len(reach), 3), [_NOTHING, -1, 0], np.int64)
    ring = Ring(sums, sums.reshape(-1, 4), start, rows, *marks, reached, views, width)
    pixels = np.zeros(4 * n, np.float32), np.zeros(n, np.float32), np.zeros(n, np.int16)
    slope, work = np.zeros((2, n), np.float32), np.empty((4, 4 * n), np.float32)
    line = SurfaceRow(*pixels, slope, np.zeros(4 * n, np.float32), work, most)
    taken = np.empty((2 * views - 1, len(reach), 4, width), np.float32)
    return Room(ring, line, taken, np.empty((2, len(reach)), np.int64), most)


@compiled
def add_ends(sums, a, c, x0, n, width, off, sign):
    """Add the light of adjacent pixels to a row where their spans begin (or end).

    sums: rows of differences; a: index of the row; c: [4 n] light; x0: the first pixel; n: number
    of pixels; off: px from the middle of a pixel to the beginning (end) of its span; sign: 1 (-1).
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
def _add_end(pixels, a, width, end, q0, q1, q2, q3):
    """Add the light of one pixel to a row of differences at position `end`, in px.

    pixels: [n, 4]; a: index of the row's first pixel; q0 to q3: three colours and coverage.
    """
    end = min(max(end, F32(0)), width)
    below = np.floor(end)
    f = end - below
    g = F32(1) - f
    o = np.uint64(a + np.int64(np.int32(below)))  # unsigned: not counted from the end
    pixels[o, 0] += q0 * g
    pixels[o, 1] += q1 * g
    pixels[o, 2] += q2 * g
    pixels[o, 3] += q3 * g
    o += np.uint64(1)
    pixels[o, 0] += q0 * f
    pixels[o, 1] += q1 * f
    pixels[o, 2] += q2 * f
    pixels[o, 3] += q3 * f


@compiled
def add_span(pixels, a, width, begin, end, light, share):
    """Add the span from `begin` to `end` px of one pixel to a row of differences.

    pixels: [n, 4]; a: index of the row's first pixel; share: by which the light is multiplied.
    """
    q0, q1, q2, q3 = light[0] * share, light[1] * share, light[2] * share, light[3] * share
    _add_end(pixels, a, width, begin, q0, q1, q2, q3)
    _add_end(pixels, a, width, end, -q0, -q1, -q2, -q3)


@compiled
def _spread_pixel(pixels, light, moved, lean, spans, q, place, to, half):
    """Spread one pixel over the rows that its disc reaches; pixels: those of `Ring`.

    light: [4] of the pixel; moved: [4] light to add to the left half; lean: the slopes of the
    radius along x and y, divided by the radius; spans: see `Opening`; q: the radius in steps;
    place: column and row of the pixel, first row that the disc reaches, row after the last, and
    side of focus; to: `start` and `rows` of the slot in `Ring`, and the `views` and `width` of
    `Ring`; half: area of the disc divided by the area of its left half.
    """
    gx, gy = lean
    column, row, begin, end, side = place
    start, rows, views, width = to
    reach = spans.shape[2] // 2
    x, zero, one, right = F32(column) + F32(0.5), F32(0), F32(1), F32(width)
    tilted = gx != 0 or gy != 0
    moving = views == 2 and (moved[0] != 0 or moved[1] != 0 or moved[2] != 0)
    k = begin % rows
    for y in range(begin, end):
        dy = y - row
        lo, hi = spans[side, q, reach + dy, 0], spans[side, q, reach + dy, 1]
        a = (start + k) * views * (width + 2)
        k = k + 1 if k + 1 < rows else 0
        if hi <= lo or x + hi <= zero or x + lo >= right:
            continue
        if moving:  # over the whole disc: the right half has as much less in the same places
            add_span(pixels, a + width + 2, right, x + lo, x + hi, moved, one)
        middle = min(max(zero, lo), hi)
        before = after = one
        if tilted:
            w = one + gy * F32(dy)
            before = max(w + gx * F32(0.5) * (lo + middle), zero)
            after = max(w + gx * F32(0.5) * (middle + hi), zero)
            add_span(pixels, a, right, x + lo, x + middle, light, before)
            add_span(pixels, a, right, x + middle, x + hi, light, after)
        else:
            add_span(pixels, a, right, x + lo, x + hi, light, one)
        if views == 2:
            b, e, share = (lo, middle, before) if side else (middle, hi, after)
            if e > b:
                add_span(pixels, a + width + 2, right, x + b, x + e, light, share * half)


@compiled
def _run_of(line, j, n, scale, moves):
    """Copy n pixels from index `j` of a line on, times `scale`, to `line.work`.

    Rows of `work`: light; light times slope along y, divided by radius; moved light, if `moves`.
    Returns whether any pixel has a slope along y, and whether any has moved light.
    """
    c, cy, cm = line.work[0], line.work[1], line.work[2]
    sloping = moving = False
    for t in range(4 * n):
        c[t] = line.light[4 * j + t] * scale
    for t in range(n):
        sloping |= line.slope[1, j + t] != 0
    if sloping:
        for t in range(n):
            gy = line.slope[1, j + t] * (F32(1) / line.radius[j + t])
            for i in range(4):
                cy[4 * t + i] = c[4 * t + i] * gy
    if moves:
        for t in range(4 * n):
            cm[t] = line.moved[4 * j + t] * scale
            moving |= cm[t] != 0
    return sloping, moving


@compiled
def _spread_run(line, j, n, place, opening, q, ring, slot, scale, half):
    """Spread n pixels from index `j` of a line on, with one radius and without horizontal slopes.

    place: row, first row that the discs reach, row after the last, and side of focus; q: the radius
    in steps; scale: share of the light divided by the area of the disc; half: as for
    `_spread_pixel`.
    """
    width, views, sums = ring.width, ring.views, ring.sums
    y, begin, end, side = place
    stride = 4 * (width + 2)
    x0, reach = j - line.before, opening.reach
    zero, one = F32(0), F32(1)
    light, c, cy, cm = line.work[3], line.work[0], line.work[1], line.work[2]
    sloping, moving = _run_of(line, j, n, scale, views == 2)
    for row in range(begin, end):
        dy = row - y
        lo, hi = opening.spans[side, q, reach + dy, 0], opening.spans[side, q, reach + dy, 1]
        if hi <= lo:
            continue
        a = (ring.start[slot] + row % ring.rows[slot]) * views * stride
        if moving:  # as above
            add_ends(sums, a + stride, cm, x0, n, width, lo, one)
            add_ends(sums, a + stride, cm, x0, n, width, hi, -one)
        own = light if sloping else c
        if sloping:
            away = F32(dy)
            for t in range(4 * n):
                light[t] = c[t] + cy[t] * away
        add_ends(sums, a, own, x0, n, width, lo, one)
        add_ends(sums, a, own, x0, n, width, hi, -one)
        b, e = (lo, min(hi, zero)) if side else (max(lo, zero), hi)
        if views == 2 and e > b:
            add_ends(sums, a + stride, own, x0, n, width, b, half)
            add_ends(sums, a + stride, own, x0, n, width, e, -half)


@compiled
def _mark(ring, reached, y, band, before):
    """Record in the ring which pixels a line reaches, for each slot; then reset `reached`.

    ring: `Ring`; reached: [slots, 3] first pixel of the line, pixel after the last, and greatest
    radius in px; y: row of the line; before: pixels of the line before the frame.
    """
    for s in range(reached.shape[0]):
        if reached[s, 1] < 0:
            continue
        r = reached[s, 2]
        first = max(reached[s, 0] - before - r, 0)
        last = min(reached[s, 1] - before + r, ring.width)
        for row in range(max(y - r, band[0]), min(y + r + 1, band[1])):
            k = ring.start[s] + row % ring.rows[s]
            ring.first[k] = min(ring.first[k], first)
            ring.last[k] = max(ring.last[k], last)
        reached[s, 0], reached[s, 1], reached[s, 2] = _NOTHING, -1, 0


@compiled
def step_of(radius):
    """The size of a radius in steps of 1 / STEPS px, whatever its sign."""
    return np.int64(abs(radius) * F32(STEPS) + F32(1 - HALF))


@compiled
def _same_from(slots, radius, x, most):
    """The number of pixels from x on with the same slot, radius in steps, and side of focus.

    most: the greatest radius in steps. Returns the number, the radius in steps, and the side.
    """
    slot, side, q, n = slots[x], radius[x] > 0, min(step_of(radius[x]), most), 1
    while x + n < radius.shape[0] and slots[x + n] == slot:
        other = radius[x + n]
        if (other > 0) != side or min(step_of(other), most) != q:
            break
        n += 1
    return n, q, np.int64(side)


@compiled
def spread_line(line, y, band, opening, ring):
    """Spread the pixels of a line, at row y, over the rows of `ring` in [band[0], band[1]).

    line: `SurfaceRow`; opening: `Opening`; ring: `Ring`.
    """
    # arrays of records are counted each time they are named: once is enough
    light, radius, slots, slope, more = line.light, line.radius, line.slot, line.slope, line.moved
    spans, area, left_area, shares = opening.spans, opening.area, opening.left_area, opening.share
    pixels, starts, rows, reached = ring.pixels, ring.start, ring.rows, ring.reached
    before, reach, views, width = line.before, opening.reach, ring.views, ring.width
    # not a literal 0, for which called functions would be compiled anew
    x, count, most = np.int64(0), radius.shape[0], area.shape[0] - 1
    while x < count:
        slot = slots[x]
        if slot < 0 or rows[slot] == 0:
            x += 1
            continue
        n, q, side = _same_from(slots, radius, x, most)
        share, upright = shares[q], False
        for j in range(x, x + n):
            upright |= slope[0, j] != 0
        for k in range(2):
            if k == 1:  # the rest of pixels near focus
                share = F32(1) - share
                if q >= SECOND or q < FIRST:
                    break
            if share <= 0:
                continue
            p = q if q >= SECOND else SECOND if q >= FIRST and k == 0 else FIRST
            rn = min(p // STEPS + 1, reach)
            reached[slot, 0] = min(reached[slot, 0], x)
            reached[slot, 1] = max(reached[slot, 1], x + n)
            reached[slot, 2] = max(reached[slot, 2], rn + 1)
            scale, half = area[p] * share, left_area[side, p] / area[p]
            begin, end = max(y - rn, band[0]), min(y + rn + 1, band[1])
            if n >= _FEW and not upright:
                place = y, begin, end, side
                _spread_run(line, x, n, place, opening, p, ring, slot, scale, half)
                continue
            to = starts[slot], rows[slot], views, width
            for j in range(x, x + n):
                q0, q1 = light[4 * j] * scale, light[4 * j + 1] * scale
                q2, q3 = light[4 * j + 2] * scale, light[4 * j + 3] * scale
                turned = F32(1) / radius[j]
                lean = slope[0, j] * turned, slope[1, j] * turned
                place = j - before, y, begin, end, side
                m0, m1, m2 = more[4 * j] * scale, more[4 * j + 1] * scale, more[4 * j + 2] * scale
                own, moved = (q0, q1, q2, q3), (m0, m1, m2, F32(0))
                _spread_pixel(pixels, own, moved, lean, spans, p, place, to, half)
        x += n
    _mark(ring, reached, y, band, before)


@compiled
def take_rows(room, y):
    """Write the sums along row y of all slots to `room.sums`, and clear the row in the ring.

    room: `Room`.
    """
    ring, ends, stride = room.ring, room.ends, 4 * (room.ring.width + 2)
    sums = ring.sums
    for s in range(ring.rows.shape[0]):
        ends[0, s], ends[1, s] = 0, -1
        if ring.rows[s] == 0:
            continue
        k = ring.start[s] + y % ring.rows[s]
        if ring.last[k] < 0:
            continue
        first, last = ring.first[k], min(ring.last[k], ring.width - 1)
        if first <= last:
            ends[0, s], ends[1, s] = first, last
        for view in range(ring.views):
            a = (k * ring.views + view) * stride
            s0 = s1 = s2 = s3 = F32(0)
            out = room.sums[view, s]
            for x in range(first, last + 1):
                o = a + 4 * x
                s0 += sums[o]
                s1 += sums[o + 1]
                s2 += sums[o + 2]
                s3 += sums[o + 3]
                out[0, x], out[1, x], out[2, x], out[3, x] = s0, s1, s2, s3
            sums[a + 4 * first : a + min(4 * (ring.last[k] + 2), stride)] = 0
        ring.first[k], ring.last[k] = _NOTHING, -1

"""Layers at reduced resolution: their rows are summed once, and read between coarse pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.renderer.compiled.jit import compiled, entry
from defocus_core.renderer.compiled.spread import add_points, clear_row, take_row
from defocus_core.renderer.compiled.surfaces import spread_row

F32 = np.float32


class CoarseLayers(NamedTuple):
    """The layers of slots that are spread in coarse pixels."""

    values: NDArray[np.float32]  # of each slot [views, height, 4, width]
    at: NDArray[np.int64]  # [slots] where a slot begins; -1 for slots at full resolution
    # [slots, 5] of each its height and width, how many px a coarse pixel is wide, and as a number
    # of eighths of a coarse pixel where the middle of pixel 0 is, down and across
    place: NDArray[np.int64]
    first: NDArray[np.int64]  # [slots, rows] the first coarse pixel that is not 0
    last: NDArray[np.int64]  # [slots, rows] the last one; -1 where none is
    cubic: NDArray[np.bool_]  # [slots] whether it is read by cubics


EIGHTHS = 64


@entry
def spread_reduced(surface, opening, room, slots, near, reduced):
    """Spread a surface over the rows of its slots; what they hold already stays.

    slots: those whose rows are taken; near: [slots] bool, those with pixels near focus.
    """
    height, width = surface.radius.shape
    ring, line = room.ring, np.empty((4, width), np.float32)
    band = np.int64(0), height  # of the type that other callers give: a literal is compiled anew
    for y in range(-room.reach, height + room.reach):
        spread_row(surface, y, band, opening, room)
        row = y - room.reach
        if row < 0:
            continue
        for s in slots:
            for view in range(ring.views):
                first, last = take_row(ring, s, row, view, line)
                if near[s]:
                    first, last = add_points(
                        *(surface.light[row], surface.radius[row], surface.slot[row]),
                        *(opening.share, s, line, first, last),
                    )
                if last < 0:
                    continue
                at = reduced.at[s] + (view * height + row) * 4 * width
                for i in range(4):
                    for x in range(first, last + 1):
                        reduced.values[at + i * width + x] += line[i, x]
                reduced.first[s, row] = min(reduced.first[s, row], first)
                reduced.last[s, row] = max(reduced.last[s, row], last)
            clear_row(ring, s, row)


@compiled
def _weights(position, cubic, weights):
    """The shares of four coarse pixels around a place; returns the first of them."""
    below = np.floor(position)
    t = F32(position - below)
    u = F32(1) - t
    if cubic:  # Keys 1981
        half = F32(0.5)
        weights[0] = -half * t * u * u
        weights[1] = F32(1) + t * t * (F32(1.5) * t - F32(2.5))
        weights[2] = F32(1) + u * u * (F32(1.5) * u - F32(2.5))
        weights[3] = -half * u * t * t
    else:
        weights[0], weights[1], weights[2], weights[3] = F32(0), u, t, F32(0)
    return np.int64(below) - 1


@compiled
def read_reduced(reduced, slot, view, y, out, room):
    """Row y of a slot in px: [4, width] in `out`, from the first to the last pixel.

    room: [4, n] of coarse pixels. Returns both; the last is -1 where nothing is.
    """
    height, width = reduced.place[slot, 0], reduced.place[slot, 1]
    step, cubic = reduced.place[slot, 2], reduced.cubic[slot]
    weights = np.empty(4, np.float32)
    place = reduced.place[slot, 3] / EIGHTHS + y / step
    row = _weights(place, cubic, weights)
    first, last = width, np.int64(-1)
    for k in range(4):
        r = min(max(row + k, 0), height - 1)
        if weights[k] != 0 and reduced.last[slot, r] >= 0:
            first, last = min(first, reduced.first[slot, r]), max(last, reduced.last[slot, r])
    if last < 0:
        return 0, -1
    # a pixel on each side is read, too
    room[:, max(first - 2, 0) : min(last + 3, width)] = 0
    for k in range(4):
        r = min(max(row + k, 0), height - 1)
        if weights[k] == 0 or reduced.last[slot, r] < 0:
            continue
        begin, end, share = reduced.first[slot, r], reduced.last[slot, r] + 1, weights[k]
        for i in range(4):
            at = reduced.at[slot] + ((view * height + r) * 4 + i) * width
            for x in range(begin, end):
                room[i, x] += share * reduced.values[at + x]
    return _read_across(reduced, slot, first, last, out, room)


@compiled
def _read_across(reduced, slot, first, last, out, room):
    """Pixels between coarse ones of a row, of which first to last are not 0."""
    width, step, cubic = reduced.place[slot, 1], reduced.place[slot, 2], reduced.cubic[slot]
    origin = reduced.place[slot, 4] / EIGHTHS
    count = out.shape[1]
    begin = max(np.int64(np.floor((first - 2 - origin) * step)), 0)
    end = min(np.int64(np.ceil((last + 2 - origin) * step)), count - 1)
    weights = np.empty(4, np.float32)
    lead, tail = max(first - 2, 0), min(last + 2, width - 1)
    for phase in range(step):
        # pixels that lie alike between coarse ones
        start = begin + phase
        if start > end:
            break
        column = _weights(origin + start / step, cubic, weights)
        w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
        n = (end - start) // step + 1
        for i in range(4):
            for k in range(n):
                c = column + k
                c0, c1 = min(max(c, lead), tail), min(max(c + 1, lead), tail)
                c2, c3 = min(max(c + 2, lead), tail), min(max(c + 3, lead), tail)
                out[i, start + k * step] = (
                    w0 * room[i, c0] + w1 * room[i, c1] + w2 * room[i, c2] + w3 * room[i, c3]
                )
    return begin, end

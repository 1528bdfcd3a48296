"""Layers that are blurred at reduced resolution, then interpolated to full resolution by rows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.renderer.compiled.jit import compiled, entry
from defocus_core.renderer.compiled.spread import take_rows
from defocus_core.renderer.compiled.surfaces import add_points, spread_row

F32 = np.float32

SUBPIXELS = 64  # positions among coarse pixels are stored in 1 / 64 of a coarse pixel


class CoarseLayers(NamedTuple):
    """The layers of slots that are blurred at reduced resolution."""

    values: NDArray[np.float32]  # flat: [views, height, 4, width] of each slot
    at: NDArray[np.int64]  # [slots] index in `values` of each slot; -1 for slots at full resolution
    # [slots, 5] height, width, px of a coarse pixel, and the place of the middle of pixel 0 of the
    # frame among coarse pixels, down and across, times SUBPIXELS
    place: NDArray[np.int64]
    ends: NDArray[np.int64]  # [2, slots, rows] first and last coarse pixel that is not 0, or -1
    cubic: NDArray[np.bool_]  # [slots] whether interpolation is cubic, else linear: edges are sharp


@entry
def spread_reduced(surfaces, opening, room, reduced):
    """Spread surfaces over their discs; write the slots that have rows in `room` to `reduced`.

    surfaces: `SlotSurfaces`; opening: `Opening`; room: `Room`; reduced: `CoarseLayers`.
    """
    height, width = surfaces.radius.shape[1:]
    values, sums = reduced.values, room.sums
    band = np.int64(0), height  # of the type that other callers give: a literal is compiled anew
    for y in range(-room.reach, height + room.reach):
        spread_row(surfaces, y, band, opening, room)
        row = y - room.reach
        if row < 0:
            continue
        take_rows(room, row)
        add_points(surfaces, row, opening.share, room)
        for s in range(room.ends.shape[1]):
            first, last = room.ends[0, s], room.ends[1, s]
            if last < 0:
                continue
            reduced.ends[0, s, row], reduced.ends[1, s, row] = first, last
            for view in range(room.ring.views):
                at = reduced.at[s] + (view * height + row) * 4 * width
                for i in range(4):
                    for x in range(first, last + 1):
                        values[at + i * width + x] = sums[view, s, i, x]


@compiled
def _weights(position, cubic, weights):
    """Write cubic or linear weights of four coarse pixels at a position; return the first index."""
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
def read_reduced(reduced, slot, y, room, row):
    """Interpolate row `y` of a slot to full resolution, into `room.sums`.

    reduced: `CoarseLayers`; room: `Room`; row: [4, n] scratch for a row of coarse pixels.
    """
    height, width = reduced.place[slot, 0], reduced.place[slot, 1]
    step, cubic = reduced.place[slot, 2], reduced.cubic[slot]
    weights, values = np.empty(4, np.float32), reduced.values
    top = _weights(reduced.place[slot, 3] / SUBPIXELS + y / step, cubic, weights)
    first, last = width, np.int64(-1)
    for k in range(4):
        r = min(max(top + k, 0), height - 1)
        if weights[k] != 0 and reduced.ends[1, slot, r] >= 0:
            first = min(first, reduced.ends[0, slot, r])
            last = max(last, reduced.ends[1, slot, r])
    if last < 0:
        return
    for view in range(room.ring.views):
        row[:, max(first - 2, 0) : min(last + 3, width)] = 0  # a pixel on each side is read, too
        for k in range(4):
            r = min(max(top + k, 0), height - 1)
            if weights[k] == 0 or reduced.ends[1, slot, r] < 0:
                continue
            for i in range(4):
                at = reduced.at[slot] + ((view * height + r) * 4 + i) * width
                for x in range(reduced.ends[0, slot, r], reduced.ends[1, slot, r] + 1):
                    row[i, x] += weights[k] * values[at + x]
        ends = _read_across(reduced, slot, first, last, room.sums[view, slot], row)
        room.ends[0, slot], room.ends[1, slot] = ends


@compiled
def _read_across(reduced, slot, first, last, out, row):
    """Interpolate a row of coarse pixels horizontally to full resolution, into `out`.

    first, last: the first and the last coarse pixel that is not 0. Returns the same for `out`.
    """
    width, step, cubic = reduced.place[slot, 1], reduced.place[slot, 2], reduced.cubic[slot]
    origin = reduced.place[slot, 4] / SUBPIXELS
    begin = max(np.int64(np.floor((first - 2 - origin) * step)), 0)
    end = min(np.int64(np.ceil((last + 2 - origin) * step)), out.shape[1] - 1)
    weights = np.empty(4, np.float32)
    lead, tail = max(first - 2, 0), min(last + 2, width - 1)
    for start in range(begin, min(begin + step, end + 1)):  # pixels that lie alike between them
        column = _weights(origin + start / step, cubic, weights)
        w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
        for i in range(4):
            for k in range((end - start) // step + 1):
                c = column + k
                c0, c1 = min(max(c, lead), tail), min(max(c + 1, lead), tail)
                c2, c3 = min(max(c + 2, lead), tail), min(max(c + 3, lead), tail)
                out[i, start + k * step] = (
                    w0 * row[i, c0] + w1 * row[i, c1] + w2 * row[i, c2] + w3 * row[i, c3]
                )
    return begin, end

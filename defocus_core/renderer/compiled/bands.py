"""Rendering of a band of rows: layers are spread over their discs and composited row by row."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.renderer.compiled.composite import composite_row
from defocus_core.renderer.compiled.jit import compiled, entry
from defocus_core.renderer.compiled.reduced import CoarseLayers, read_reduced
from defocus_core.renderer.compiled.spread import take_rows
from defocus_core.renderer.compiled.surfaces import SlotSurfaces, add_points, spread_row

F32 = np.float32


class Bounds(NamedTuple):
    """Limits of the values of views, see `compositing/saturating_sum.py`."""

    # [C, 4] least and greatest value of each channel, widened for rounding, then those of left and
    # right, which are wider
    range: NDArray[np.float32]
    minimum: float  # least light
    negative: float  # light below which a pixel of left or right is counted as negative
    left: float  # the left half's share of the area of the aperture
    apart: float  # difference of left and right, divided by that without crosstalk


class BandInputs(NamedTuple):
    """Inputs that all bands of a picture share."""

    surfaces: SlotSurfaces
    reduced: CoarseLayers
    steps: NDArray[np.int64]  # the order of slots, see `composite`
    sides: NDArray[np.int64]  # [slots] side of focus, see `composite_row`
    needed: NDArray[np.uint8]  # [slots] the least `sight` at which each slot shows
    sight: NDArray[np.uint8]  # [H, W] the farthest slot seen, or [1, 0] if nothing limits it
    lights: NDArray[np.float32]  # [views, C, H, W] to add, or [views, C, 1, 0]
    bounds: Bounds


@compiled
def _take_all(surfaces, reduced, shares, left, y, room, coarse):
    """Write row y of all layers, also those blurred at reduced resolution, to `room.sums`.

    surfaces: `SlotSurfaces`; reduced: `CoarseLayers`; shares: as in `Opening`; left: the left
    half's share of the aperture; room: `Room`; coarse: [4, W] scratch.
    """
    take_rows(room, y)
    add_points(surfaces, y, shares, room)
    sums, ends, right = room.sums, room.ends, F32(1 - left)
    for s in range(ends.shape[1]):
        if reduced.at[s] >= 0:
            read_reduced(reduced, s, y, room, coarse)
        if sums.shape[0] == 3:
            for i in range(4):
                for x in range(ends[0, s], ends[1, s] + 1):
                    sums[2, s, i, x] = (sums[0, s, i, x] - F32(left) * sums[1, s, i, x]) / right


@compiled
def _clamped(value, least, greatest):
    return min(max(value, least), greatest)


@compiled
def finish_centre(front, lights, bounds, out):
    """Write the colours and the trust of a row of the centre view to out [C + 1, W].

    front: [5, W], the composited row, see `composite`; lights: [C, W] to add, or [C, 0] for none.
    """
    count = out.shape[0] - 1
    for x in range(front.shape[1]):
        full = max(front[3, x], F32(1e-6))
        for i in range(count):
            color = front[i, x] / full
            if lights.shape[1] > 0:
                color += lights[i, x]
            out[i, x] = _clamped(color, bounds.range[i, 0], bounds.range[i, 1])
        out[count, x] = _clamped(F32(1) - front[4, x] / full, F32(0), F32(1))


@compiled
def finish_pair(left, right, of_left, of_right, centre, bounds, counted):
    """Correct a row of left and right so that their mean, weighted by area, is the centre.

    left, right: [C, W], overwritten; of_left, of_right: lights [C, W] to add, or [C, 0] for none;
    centre: [C, W]. Returns the number of pixels that were negative, which `counted` [W] marks.
    """
    found = 0
    counted[:] = 0
    zero, one, two = F32(0), F32(1), F32(2)
    share, minimum, apart = F32(bounds.left), F32(bounds.minimum), F32(bounds.apart)
    ratio = (one - share) / share
    for i in range(left.shape[0]):
        least, greatest = bounds.range[i, 2], bounds.range[i, 3]
        for x in range(left.shape[1]):
            a, b, c = left[i, x], right[i, x], centre[i, x]
            if of_left.shape[1] > 0:
                a += of_left[i, x]
                b += of_right[i, x]
            if counted[x] == 0 and min(a, b) < F32(bounds.negative):
                counted[x] = 1
                found += 1
            a = max(a - minimum, zero) * two * share
            b = max(b - minimum, zero) * two * (one - share)
            total = a + b
            part = a / total if total > 0 else F32(0.5)
            lit = two * (c - minimum)
            a = lit * part / (two * share) + minimum
            b = lit * (one - part) / (two * (one - share)) + minimum
            darkest = max(c - ratio * max(greatest - c, zero), least)
            brightest = min(c + ratio * (c - least), greatest)
            added = _clamped(a, darkest, brightest) - a
            a, b = a + added, b - added / ratio
            left[i, x], right[i, x] = c + (a - c) * apart, c + (b - c) * apart
    return found


@entry
def render_band(given, opening, room, band, out):
    """Render the rows [band[0], band[1]) of a picture into out [views, C + 1, H, W].

    given: `BandInputs`; opening: `Opening`; room: `Room`. The last channel is the trust. Returns
    the number of pixels of left and right that were negative.
    """
    surfaces, reduced, steps, sides, needed, sight, lights, bounds = given
    width, colors = out.shape[3], out.shape[1] - 1
    front, space = np.empty((5, width), np.float32), np.empty((3, 6, width), np.float32)
    coarse, counted, negative = np.empty((4, width), np.float32), np.empty(width, np.uint8), 0
    for y in range(band[0] - room.reach, band[1] + room.reach):
        spread_row(surfaces, y, band, opening, room)
        row = y - room.reach
        if row < band[0]:
            continue
        _take_all(surfaces, reduced, opening.share, bounds.left, row, room, coarse)
        seen, lit = sight[min(row, sight.shape[0] - 1)], min(row, lights.shape[2] - 1)
        for view in range(out.shape[0]):
            composite_row(steps, room.sums[view], room.ends, sides, seen, needed, front, space)
            if view == 0:
                finish_centre(front, lights[0, :, lit], bounds, out[0, :, row])
                continue
            for i in range(colors):
                for x in range(width):
                    out[view, i, row, x] = front[i, x] / max(front[3, x], F32(1e-6))
        if out.shape[0] == 3:
            left, right, centre = out[1, :colors, row], out[2, :colors, row], out[0, :colors, row]
            of_left, of_right = lights[1, :, lit], lights[2, :, lit]
            negative += finish_pair(left, right, of_left, of_right, centre, bounds, counted)
    return negative

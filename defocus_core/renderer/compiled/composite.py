"""Layers of a row composited front to back, in the order of `engine/layer_order.py`.

The order is a list of steps. A row is an array [5, W]: three colours times coverage, coverage, and
the coverage that is invented.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from defocus_core.renderer.compiled.jit import compiled
from defocus_core.renderer.engine import limits
from defocus_core.renderer.layers.slice_radii import ALONE, MORE

F32 = np.float32
# Steps, each with the number of a slot.
SHOW, FILL, MARK, BEFORE, ASIDE, CLOSE, FILL_ALL, TOGETHER = range(8)
_LEAST = 1e-9  # coverage that shows nothing
_BRIGHT = 0.497  # coverage of the brightest light there is, which is less than 2 units


def order_of(slots: Sequence[float], octaves: dict[int, int]) -> NDArray[np.int64]:
    """The compositing steps [n, 2], each a kind of step and the number of a slot.

    slots: least radius of each visible slot in px, nearest first; octaves: for each octave of
    hidden content, the number of its slot.
    """
    near = [k for k, r in enumerate(slots) if r <= -ALONE]
    far = [k for k, r in enumerate(slots) if r >= ALONE]
    later: dict[int, list[int]] = {}
    for octave in sorted(octave for octave in octaves if octave):
        limit = MORE * ALONE * 2.0 ** abs(octave)
        first = next((k for k in far if slots[k] >= limit), None)
        if first is not None:
            later.setdefault(first, []).append(octave)
    steps = [(SHOW, k) for k in near]
    apart = bool(near)
    steps += [(MARK, 0)] * apart
    steps += [(SHOW, k) for k in range(len(slots)) if k not in near and k not in far]
    steps += [(FILL, octaves[0])] if 0 in octaves else []
    if apart:
        before = [octave for each in later.values() for octave in each if octave < 0]
        steps += [(BEFORE, 0), *[(FILL, octaves[octave]) for octave in sorted(before)], (ASIDE, 0)]
    for k in far:
        for octave in later.get(k, []):
            if not apart or octave > 0:
                steps.append((FILL, octaves[octave]))
                steps += [(CLOSE, 0)] * apart
        steps.append((SHOW, k))
    steps += [(FILL_ALL, 0)] * bool(octaves)
    steps += [(TOGETHER, 0)] * apart
    return np.array(steps, np.int64).reshape(-1, 2)


@compiled
def add_behind(front, layer, first, last, invented, sight, needed):
    """Composite a layer [4, W] behind the row `front` [5, W] where `sight` reaches the layer.

    first, last: its first and last pixel; invented: 1 for an invented layer, else 0; sight: [W] the
    farthest slot seen, empty if sight is not limited; needed: the least sight at which the layer
    shows.
    """
    limited = sight.shape[0] > 0
    for x in range(first, last + 1):
        coverage = layer[3, x]
        room = max(F32(1) - front[3, x], F32(0))
        # a half may have light without coverage, see `find_moved`: it takes room as if it had some
        brightest = max(abs(layer[0, x]), abs(layer[1, x]), abs(layer[2, x]))
        taken = max(coverage, F32(_BRIGHT) * brightest, F32(_LEAST))
        share = min(room / taken, F32(1))
        if limited and sight[x] < needed:
            share = F32(0)
        front[0, x] += share * layer[0, x]
        front[1, x] += share * layer[1, x]
        front[2, x] += share * layer[2, x]
        front[3, x] += share * coverage
        front[4, x] += invented * share * coverage


@compiled
def set_aside(front, covered, before, aside):
    """Move the row, which holds all layers nearer than focus, to `aside`, and begin a new one.

    covered: [W] coverage by visible layers nearer than focus; before: [W] coverage of the row
    before hidden layers nearer than focus were added; aside: [6, W], the five channels of the row,
    then the coverage with which the new row begins: that by other layers, or 1 where those nearer
    than focus leave no room.
    """
    for x in range(front.shape[1]):
        near = covered[x] + front[3, x] - before[x]
        going = F32(1) if near > F32(1 - limits.MIN_ROOM) else front[3, x] - near
        for i in range(5):
            aside[i, x] = front[i, x]
            front[i, x] = 0
        aside[5, x] = front[3, x] = going


@compiled
def close_gaps(front, aside):
    """Close gaps that are small compared with the coverage set aside: they are numerical errors.

    front, aside: as for `set_aside`.
    """
    for x in range(front.shape[1]):
        gap = max(F32(1) - front[3, x], F32(0))
        near = aside[3, x] - aside[5, x]
        error = max(F32(limits.GAP_ERROR) * near, F32(limits.LEAST_ERROR))
        added = gap * min(max(F32(2) - gap / error, F32(0)), F32(1))
        room = max(F32(1) - aside[5, x], F32(limits.MIN_ROOM))
        larger = F32(1) + added / max(room - gap, F32(limits.MIN_ROOM))
        front[0, x] *= larger
        front[1, x] *= larger
        front[2, x] *= larger
        front[4, x] *= larger
        front[3, x] += added


@compiled
def put_together(front, aside):
    """Composite the row set aside over the layers composited since then."""
    for x in range(front.shape[1]):
        coverage = front[3, x] - aside[5, x]
        room = F32(1) - aside[3, x]
        share = F32(1) if coverage <= room else room / coverage
        share = share if coverage > F32(_LEAST) and room > 0 else F32(0)
        for i in range(3):
            front[i, x] = aside[i, x] + share * front[i, x]
        front[3, x] = aside[3, x] + share * coverage
        front[4, x] = aside[4, x] + share * front[4, x]


@compiled
def composite_row(steps, rows, ends, sides, sight, needed, front, room):
    """Composite a row of all layers, `rows` [slots, 4, W], into `front` [5, W].

    steps: from `order_of`; ends: [2, slots] first and last pixel of each layer where it is not 0,
    or -1 if it is empty; sides: [slots] from `Slots.sides`; sight: [W] or empty, and needed:
    [slots], as for `add_behind`; room: [3, 6, W] scratch.
    """
    front[:] = 0
    covered, before, aside, whole = room[0, 0], room[0, 1], room[1], room[2]
    for n in range(steps.shape[0]):
        step, slot = steps[n, 0], steps[n, 1]
        if step in (SHOW, FILL):
            row, invented = rows[slot], F32(step == FILL)
            add_behind(front, row, ends[0, slot], ends[1, slot], invented, sight, needed[slot])
        elif step in (MARK, BEFORE):
            marked = covered if step == MARK else before
            for x in range(front.shape[1]):
                marked[x] = front[3, x]
        elif step == ASIDE:
            set_aside(front, covered, before, aside)
        elif step == CLOSE:
            close_gaps(front, aside)
        elif step == FILL_ALL:
            if _whole_hidden(rows, ends, sides, sight, needed, whole, room[0]):
                last = np.int64(front.shape[1] - 1)
                add_behind(front, whole, np.int64(0), last, F32(1), sight[:0], np.uint8(0))
        elif step == TOGETHER:
            put_together(front, aside)


@compiled
def _whole_hidden(rows, ends, sides, sight, needed, whole, room):
    """Write all hidden octaves to `whole` as one layer; return whether there are any.

    The octaves on one side of focus are summed; nearer sides cover farther ones. whole: [6, W];
    room: [6, W] scratch; all others as for `composite_row`.
    """
    found = False
    whole[:] = 0
    for side in range(-1, 2):
        some = False
        total = room[2:6]
        for slot in range(rows.shape[0]):
            if sides[slot] != side or ends[1, slot] < 0:
                continue
            if not some:
                total[:] = 0
                some = True
            for x in range(ends[0, slot], ends[1, slot] + 1):
                if sight.shape[0] == 0 or sight[x] >= needed[slot]:
                    for i in range(4):
                        total[i, x] += rows[slot, i, x]
        if some:
            last = np.int64(whole.shape[1] - 1)
            add_behind(whole, total, np.int64(0), last, F32(0), sight[:0], np.uint8(0))
            found = True
    return found

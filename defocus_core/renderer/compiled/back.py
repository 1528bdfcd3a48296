"""The compiled back: the views of a picture whose surfaces are known."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.optics.outline import Outline
from defocus_core.renderer.compiled.bands import BandInputs, Bounds, render_band
from defocus_core.renderer.compiled.coarse import CoarseAxis, coarse_axes
from defocus_core.renderer.compiled.composite import order_of
from defocus_core.renderer.compiled.openings import LOST, areas_below, lost_shifts, opening
from defocus_core.renderer.compiled.reduced import EIGHTHS, CoarseLayers, spread_reduced
from defocus_core.renderer.compiled.sight import farthest_seen, keep_in_frame, needed
from defocus_core.renderer.compiled.slots import Slots, slots_between
from defocus_core.renderer.compiled.spread import room_of
from defocus_core.renderer.compiled.surfaces import (
    SlotSurface,
    add_halved,
    find_moved,
    finish_halved,
    is_of,
    slopes,
    slots_of,
)
from defocus_core.tensors.threads import threaded

_LEVEL = np.zeros((2, 0, 0), np.float32)
_STILL = np.zeros((0, 0), np.float32)
_NOTHING = SlotSurface(_STILL, _STILL, np.zeros((0, 0), np.int16), _LEVEL, _STILL)
# Radius in px that openings are drawn for at least, so that their shifts are known.
_LEAST = math.ceil(LOST)
# Rows that a thread renders at least: each reads the rows around its own, too.
_ROWS = 96


class Samples(NamedTuple):
    """What one surface has at each pixel."""

    light: NDArray[np.float32]  # [H, 4 W] three colours premultiplied by coverage, and coverage
    radius: NDArray[np.float32]  # [H, W] signed, px; of what is hidden in coarse pixels


class Sampled(NamedTuple):
    """The surfaces of a picture."""

    own: Samples  # what the depth names
    nearer: Samples | None  # parts of nearer surfaces in the same pixels
    hidden: Samples | None  # what is continued behind edges, in coarse pixels of two by two px


def render(
    sampled: Sampled,
    lights: NDArray[np.float32],
    bounds: Bounds,
    *,
    outline: Outline,
    min_slope: float,
    edges: bool,
    threads: int,
) -> tuple[NDArray[np.float32], int]:
    """The views [1 or 3, C + 1, H, W] of a picture, colours and trust; how many px were negative.

    lights: [1 or 3, C, H, W] to add, of as many views as are wanted, or [1 or 3, C, 1, 0];
    outline: of the opening; min_slope: of the radius, px per px, below which a surface counts as
    level; edges: whether surfaces hide others.
    """
    own, nearer, hidden = sampled
    visible = [own] if nearer is None else [own, nearer]
    slots = slots_between(_range(visible, 1), hidden and _range([hidden], 2))
    views = (len(lights) + 1) // 2
    surfaces = [_surface(samples, slots.tables[0]) for samples in visible]
    slope, moved = slopes(own.radius, min_slope), surfaces[0].moved
    if views == 2 and slots.least[0] < LOST and slots.least[-1] > -LOST:
        moved = np.zeros_like(own.light)
        find_moved(own.light, own.radius, lost_shifts(outline), moved)
    surfaces[0] = surfaces[0]._replace(slope=slope, moved=moved)
    sight = np.empty((1, 0), np.uint8)
    if edges:
        beyond = own._replace(radius=_a_slice_beyond(own.radius))
        sight = farthest_seen(_surface(beyond, slots.tables[0]).slot, own.radius)
        del beyond  # a large array
    reduced = _spread_reduced(surfaces, hidden, slots, views, outline)
    whole = [s for s, level in enumerate(slots.level) if level == 0]
    first, *others = surfaces = [_only(each, slots, whole) for each in surfaces]
    (H, W), channels = own.radius.shape, len(bounds.range)
    given = BandInputs(
        own=first,
        nearer=others[0] if others else _NOTHING,
        reduced=reduced,
        near=slots.has_points(0),
        steps=order_of(slots.least, slots.octaves),
        sides=slots.sides,
        needed=needed(slots),
        sight=sight,
        lights=lights,
        bounds=bounds,
    )
    out = np.empty((2 * views - 1, channels + 1, H, W), np.float32)
    count = max(1, min(threads, H // _ROWS))
    ends = [H * k // count for k in range(count + 1)]

    def band(rows: tuple[int, int]) -> int:
        room = room_of(slots.rows(0, whole), views, W)
        return int(render_band(given, opening(outline, max(room.reach, _LEAST)), room, rows, out))

    negative = sum(threaded(band, list(pairwise(ends)), count))
    keep_in_frame(own.radius, areas_below(outline), out[0, -1])
    return out, negative


def _a_slice_beyond(radius: NDArray[np.float32]) -> NDArray[np.float32]:
    """Radii [H, W] px that are farther by about half the distance of slices of the torch back."""
    beyond = np.abs(radius)
    beyond *= 0.06
    np.maximum(beyond, 0.37, out=beyond)
    beyond += radius
    return beyond


def _only(surface: SlotSurface, slots: Slots, wanted: list[int]) -> SlotSurface:
    """A surface without the pixels of other slots than those wanted."""
    kept = [s if s in wanted else -1 for s in range(len(slots.level))]
    return surface._replace(slot=np.array([*kept, -1], np.int16)[surface.slot])


def _range(samples: Iterable[Samples], scale: int) -> tuple[float, float]:
    """The least and the greatest radius in px of what is there."""
    ends = []
    for light, radius in samples:
        held = radius[light[:, 3::4] > 0]
        ends += [float(held.min()), float(held.max())] if held.size else []
    return scale * min(ends), scale * max(ends)


def _surface(samples: Samples, table: NDArray[np.int16]) -> SlotSurface:
    """Samples as a level surface with slots."""
    slot = np.empty(samples.radius.shape, np.int16)
    slots_of(samples.radius, samples.light, table, slot)
    return SlotSurface(samples.light, samples.radius, slot, _LEVEL, _STILL)


def _spread_reduced(
    surfaces: list[SlotSurface],
    hidden: Samples | None,
    slots: Slots,
    views: int,
    outline: Outline,
) -> CoarseLayers:
    """Spread the layers whose discs are wide, and what is hidden."""
    H, W = surfaces[0].radius.shape
    deepest = max(slots.level)
    down, across = coarse_axes(H, deepest), coarse_axes(W, deepest)
    count = len(slots.level)
    place = np.zeros((count, 5), np.int64)
    at, total = np.full(count, -1, np.int64), 0
    for s, level in enumerate(slots.level):
        y, x = down[level], across[level]
        origins = [round(axis.origin * EIGHTHS) for axis in (y, x)]
        place[s] = (y.length, x.length, 1 << level, *origins)
        if level:
            at[s], total = total, total + views * y.length * 4 * x.length
    first = np.full((count, place[:, 0].max()), 1 << 30, np.int64)
    last = np.full(first.shape, -1, np.int64)
    cubic = np.arange(count) < slots.visible
    reduced = CoarseLayers(np.zeros(total, np.float32), at, place, first, last, cubic)
    for side in (False, True):
        parts = surfaces
        for level in range(1, deepest + 1):
            coarse = _halved(parts, slots, level, side, down[level], across[level])
            if coarse is None:
                break
            _spread_at(coarse, slots, level, views, reduced, outline)
            parts = [coarse]
    if hidden is not None:
        _spread_at(_surface(hidden, slots.hidden), slots, 1, views, reduced, outline)
    return reduced


def _halved(
    surfaces: list[SlotSurface],
    slots: Slots,
    level: int,
    side: bool,
    down: CoarseAxis,
    across: CoarseAxis,
) -> SlotSurface | None:
    """What of surfaces is spread at a level or beyond, on a side of focus; None if nothing is."""
    size = down.length, across.length
    sloping = any(surface.slope.size for surface in surfaces)
    light, sums = np.zeros((size[0], 4 * size[1]), np.float32), np.zeros((3, *size), np.float32)
    shift, odd = (down.before, across.before), (int(down.odd), int(across.odd))
    found, levels = False, np.array(slots.level, np.int64)
    for surface in surfaces:
        present = np.empty(surface.radius.shape, np.uint8)
        if is_of(surface.slot, levels, surface.radius, level - 1, side, present):
            found = True
            add_halved(
                surface.light, surface.radius, surface.slope, present, shift, odd, light, sums
            )
    if not found:
        return None
    radius = np.zeros(size, np.float32)
    slope = np.zeros((2, *size), np.float32) if sloping else _LEVEL
    finish_halved(light, sums, radius, slope)
    return _surface(Samples(light, radius), slots.tables[level])._replace(slope=slope)


def _spread_at(
    surface: SlotSurface,
    slots: Slots,
    level: int,
    views: int,
    reduced: CoarseLayers,
    outline: Outline,
) -> None:
    """Spread the slots of a surface that are of a level."""
    held = set(np.unique(surface.slot).tolist())
    mine = [s for s in sorted(held) if s >= 0 and slots.level[s] == level]
    if mine:
        room = room_of(slots.rows(level, mine), views, surface.radius.shape[1])
        surface = _only(surface, slots, mine)
        near = slots.has_points(level)
        spread_reduced(surface, opening(outline, room.reach), room, np.array(mine), near, reduced)

"""The compiled back: it renders the views of a picture whose surfaces are known."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.optics.outline import Outline
from defocus_core.renderer.compiled.bands import BandInputs, Bounds, render_band
from defocus_core.renderer.compiled.coarse import coarse_pixels
from defocus_core.renderer.compiled.composite import order_of
from defocus_core.renderer.compiled.openings import LOST, areas_below, lost_shifts, opening
from defocus_core.renderer.compiled.reduced import SUBPIXELS, CoarseLayers, spread_reduced
from defocus_core.renderer.compiled.sight import farthest_seen, keep_in_frame
from defocus_core.renderer.compiled.slots import Slots, slots_between
from defocus_core.renderer.compiled.spread import room_of
from defocus_core.renderer.compiled.surfaces import SlotSurfaces, halved, surfaces_of
from defocus_core.tensors.threads import in_threads

# Radius in px that openings are drawn for at least, so that their shifts are known.
_LEAST = 4
# Rows that a thread renders at least: each reads the rows around its own, too.
_ROWS = 96
_NOTHING = np.zeros((2, 0), np.float32)


class Samples(NamedTuple):
    """The surfaces of a picture: light and radius at each pixel."""

    # [1 or 2, H, 4 W] three colours premultiplied by coverage, and coverage: of the surface at
    # the depth of each pixel, then of the part of a nearer surface in the same pixel
    light: NDArray[np.float32]
    radius: NDArray[np.float32]  # [1 or 2, H, W] signed, px
    range: tuple[float, float]  # least and greatest radius
    hidden: HiddenSamples | None = None  # surfaces continued behind edges


class HiddenSamples(NamedTuple):
    """Hidden surfaces continued behind edges, in coarse pixels of two by two px."""

    light: NDArray[np.float32]  # [1, h, 4 w] as of `Samples`
    radius: NDArray[np.float32]  # [1, h, w] signed, in coarse pixels
    range: tuple[float, float]  # least and greatest radius in px where coverage is not 0


def render(
    samples: Samples,
    lights: NDArray[np.float32],
    bounds: Bounds,
    *,
    outline: Outline,
    min_slope: float,
    edges: bool,
    threads: int,
) -> tuple[NDArray[np.float32], int]:
    """The views [1 or 3, C + 1, H, W] of a picture, and the number of negative pixels.

    A view holds the C colours and then the trust.

    lights: [1 or 3, C, H, W] to add to the views centre, left and right, or [1 or 3, C, 1, 0] for
    none; outline: the outline of the lens opening; min_slope: slope of the radius, px per px, below
    which a surface counts as level; edges: whether surfaces hide others.
    """
    light, radius = samples.light, samples.radius
    slots = slots_between(samples.range, samples.hidden and samples.hidden.range)
    views = (len(lights) + 1) // 2
    (H, W), channels = radius.shape[1:], len(bounds.range)
    whole = {*np.flatnonzero(slots.levels == 0).tolist()}
    reach = slots.rows(0, whole)
    drawn = opening(outline, max(_LEAST, *reach))
    is_near = slots.least[0] < LOST and slots.least[-1] > -LOST
    lost = lost_shifts(outline, drawn.reach - 1) if views == 2 and is_near else _NOTHING
    surfaces = surfaces_of(light, radius, slots.visible, 0, np.float32(min_slope), lost)
    sight = np.empty((1, 0), np.uint8)
    if edges:
        sight = farthest_seen(light[0], radius[0], slots.visible)
    given = BandInputs(
        surfaces=surfaces,
        reduced=_reduced(surfaces, samples.hidden, slots, views, outline),
        steps=order_of(slots.least, slots.octaves),
        sides=slots.sides,
        needed=slots.needed,
        sight=sight,
        lights=lights,
        bounds=bounds,
    )
    out = np.empty((2 * views - 1, channels + 1, H, W), np.float32)
    count = max(1, min(threads, H // _ROWS))
    ends = [H * k // count for k in range(count + 1)]

    def band(rows: tuple[int, int]) -> int:
        return int(render_band(given, drawn, room_of(reach, views, W), rows, out))

    negative = sum(in_threads(band, list(pairwise(ends)), count))
    if max(-samples.range[0], samples.range[1]) > 0.5:
        keep_in_frame(radius[0], areas_below(outline), out[0, -1])
    return out, negative


def _reduced(
    surfaces: SlotSurfaces, hidden: HiddenSamples | None, slots: Slots, views: int, outline: Outline
) -> CoarseLayers:
    """The layers of wide discs and the hidden surfaces, blurred at reduced resolution.

    views: 2 if left is rendered too, else 1.
    """
    levels = slots.levels.tolist()
    coarse = coarse_pixels(surfaces.radius.shape[1:], max(levels))
    origins = np.rint(coarse.origin * SUBPIXELS).astype(np.int64)
    steps = 1 << np.arange(len(origins))
    place = np.column_stack([coarse.length, steps, origins])[slots.levels]
    sizes = np.where(slots.levels > 0, 4 * views * place[:, 0] * place[:, 1], 0)
    at = np.where(slots.levels > 0, sizes.cumsum() - sizes, -1)
    ends = np.full((2, len(levels), place[:, 0].max()), -1)
    cubic = np.arange(len(levels)) < len(slots.least)
    reduced = CoarseLayers(np.zeros(sizes.sum(), np.float32), at, place, ends, cubic)

    def spread(parts: SlotSurfaces, level: int, which: set[int]) -> None:
        if which:
            room = room_of(slots.rows(level, which), views, parts.radius.shape[2])
            spread_reduced(parts, opening(outline, room.reach), room, reduced)

    for side in (False, True):
        mine = {s for s, r in enumerate(slots.least) if levels[s] and (r > 0) == side}
        parts = surfaces
        for level in range(1, max((levels[s] for s in mine), default=0) + 1):
            parts = halved(parts, slots.levels, level, side, coarse, slots.visible)
            spread(parts, level, {s for s in mine if levels[s] == level})
    if hidden is not None:
        light, radius, _ = hidden
        parts = surfaces_of(light, radius, slots.hidden, 1, np.float32(math.inf), _NOTHING)
        spread(parts, 1, set(slots.octaves.values()))
    return reduced

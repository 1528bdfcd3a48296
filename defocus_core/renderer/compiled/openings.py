"""Lens openings as spans: the first and last pixel of each row of a blur disc of each radius."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.optics.outline import CurvedPolygon, Disc, Outline, Polygon, Squeezed
from defocus_core.renderer.layers.slice_radii import SHARP, SOFT
from defocus_core.tensors.ties import off_round

# Radii are rounded to 1 / STEPS px, upwards above this fraction of a step: a little more than half,
# which no round number has, so that the last bit of a radius does not change the picture.
STEPS, HALF = 16, off_round(0.5)
# Radii in px of the discs near focus: a pixel between two is a mean of both that keeps the second
# moment of the blur, as the slices of the torch back. Up to SHARP it is a point.
NEAR = (0.75, 1.5)
FIRST, SECOND = (round(r * STEPS) for r in NEAR)
# Heights at which the chords of an opening are summed, and corners of the arc of a blade.
_HEIGHTS, _CORNERS = 1 << 10, 16
# Intervals of the width of an opening between which areas are interpolated, and heights in each.
_AREAS, _PER_AREA = 128, 4


class Opening(NamedTuple):
    """The blur discs of an opening, as spans, for radii of 0, 1 / STEPS, ... px up to `reach`."""

    spans: NDArray[np.float32]  # [2, n, 2 reach + 1, 2] px, nearer than focus and beyond it
    area: NDArray[np.float32]  # [n] one divided by the area in px
    left_area: NDArray[np.float32]  # [2, n] the same of the half whose lens points are u.x < 0
    # [n] weight in the blur; near focus, the rest is the next smaller disc of NEAR, or a point
    share: NDArray[np.float32]
    reach: int


def has_spans(outline: Outline) -> bool:
    """Whether each row of an opening is one span: a disc or polygon of blades, squeezed or not."""
    shape = outline.outline if isinstance(outline, Squeezed) else outline
    return isinstance(shape, Disc | Polygon | CurvedPolygon)


@lru_cache(maxsize=8)
def opening(outline: Outline, reach: int) -> Opening:
    """The spans of an opening up to a radius of `reach` px; `has_spans` must be true of it."""
    n, reach = reach * STEPS + 2, reach + 1
    radii = np.maximum(np.arange(n) / STEPS, NEAR[0])[:, None]
    places = np.linspace(-1, 1, _HEIGHTS + 1)
    begin, end = _chords(outline, (places[1:] + places[:-1]) / 2)
    rows = (np.arange(-reach, reach + 2) - 0.5) / radii
    width, moment = (
        np.diff(np.interp(rows, places, np.append(0, each.cumsum()) * (2 / _HEIGHTS)))
        for each in (end - begin, (end * end - begin * begin) / 2)
    )
    width *= radii * radii
    middle = moment * radii**3 / np.maximum(width, 1e-9)
    ahead, behind = middle - width / 2, middle + width / 2
    beyond = np.stack([ahead, behind], -1)
    spans = np.stack([-beyond[:, ::-1, ::-1], beyond]).astype(np.float32)
    left = np.stack([_left(spans, side)[1] - _left(spans, side)[0] for side in (0, 1)])
    share = np.ones(n)
    share[:SECOND] = _near_focus(np.arange(SECOND) / STEPS)[:n]
    return Opening(
        spans,
        (1 / width.sum(1)).astype(np.float32),
        (1 / left.sum(2, dtype=np.float64)).astype(np.float32),
        share.astype(np.float32),
        reach,
    )


@lru_cache(maxsize=8)
def areas_below(outline: Outline) -> NDArray[np.float32]:
    """The share of an opening's area that is above u.y and to the left of u.x: array [y, x].

    u.y and u.x are evenly spaced from -1 to 1.
    """
    places = np.linspace(-1, 1, _AREAS + 1)
    y = places[:-1, None] + (np.arange(_PER_AREA) + 0.5) * (2 / (_AREAS * _PER_AREA))
    begin, end = (x[..., None] for x in _chords(outline, y))
    below = np.zeros((_AREAS + 1, _AREAS + 1))
    np.clip(places - begin, 0, end - begin).sum(1).cumsum(0, out=below[1:])
    shares: NDArray[np.float32] = (below / below[-1, -1]).astype(np.float32)
    return shares


def left_share(outline: Outline) -> float:
    """The share of an opening's area with u.x < 0; `has_spans` must be true of it."""
    shape = outline.outline if isinstance(outline, Squeezed) else outline
    if isinstance(shape, Disc):
        return 0.5
    assert isinstance(shape, Polygon | CurvedPolygon)
    x, y = _corners(shape)
    after, down = np.roll(x, -1), np.roll(y, -1) - y
    low, high = np.minimum(x, after), np.maximum(x, after)
    crossing = np.minimum(low, 0) ** 2 / (2 * np.minimum(low - high, -1e-12))
    left = np.where(high > 0, crossing, (low + high) / 2)  # means of min(x, 0) along the rim
    return abs(float(left @ down)) / abs(float((x + after) @ down) / 2)


def _left(spans: NDArray[Any], side: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Begin and end [n, rows] of the part of each span that belongs to the left half.

    spans: [2, n, rows, 2]; side: 0 nearer than focus, 1 beyond it.
    """
    begin, end = spans[side, :, :, 0], spans[side, :, :, 1]
    begin, end = (begin, end.clip(max=0)) if side else (begin.clip(min=0), end)
    return begin, np.maximum(begin, end)


def _chords(outline: Outline, y: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """The x at which rows of an opening, at heights `y` (down), begin and end; equal outside.

    All are in units of the radius of the lens.
    """
    if isinstance(outline, Squeezed):
        inner = _chords(outline.outline, y * float(outline.down))
        return tuple(x / float(outline.across) for x in inner)
    if isinstance(outline, Disc):
        half = np.sqrt(np.maximum(1 - y * y, 0))
        return -half, half
    assert isinstance(outline, Polygon | CurvedPolygon)
    x, height = _corners(outline)
    top, bottom = int(height.argmin()), int(height.argmax())
    chains = []
    for first, last in ((top, bottom), (bottom, top)):
        place = np.arange(first, last + 1 + len(x) * (last < first)) % len(x)
        place = place if first == top else place[::-1]
        chains.append(np.interp(y, height[place], x[place]))
    inside = (y > height[top]) & (y < height[bottom])
    begin, end = np.minimum(*chains), np.maximum(*chains)
    return begin, np.where(inside, end, begin)


def _corners(outline: Polygon | CurvedPolygon) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Coordinates x and y (down) of points along the rim of a polygon, in radii of the lens."""
    half, curvature = math.pi / outline.sides, float(getattr(outline, "curvature", 0.0))
    middle = np.radians(outline.rotation) + half * (2 * np.arange(outline.sides)[:, None] + 1)
    if not curvature:
        return np.cos(middle - half)[:, 0], -np.sin(middle - half)[:, 0]
    radius = 1 / curvature
    distance = math.cos(half) - math.sqrt(radius**2 - math.sin(half) ** 2)
    angle = math.asin(math.sin(half) / radius) * np.linspace(-1, 1, _CORNERS, endpoint=False)
    x = distance * np.cos(middle) + radius * np.cos(middle + angle)
    y = distance * np.sin(middle) + radius * np.sin(middle + angle)
    return x.ravel(), -y.ravel()


# Radius in px above which lost shifts are not restored: less than 0.03 px is lost there.
LOST = 2.25


@lru_cache(maxsize=8)
def lost_shifts(outline: Outline, reach: int) -> NDArray[np.float32]:
    """How many px of its shift the disc of the left half loses by sampling: [2, n] of two sides.

    The sides are radii nearer than focus, then beyond it.

    n counts radii of 0, 1 / STEPS, ... px. Only shifts of less than a pixel, near focus, are lost.
    reach: radius in px up to which the opening is drawn, at least 4.
    """
    most, far, pixel = math.ceil(LOST * STEPS), 4 * STEPS, np.arange(-reach - 1, reach + 2)
    drawn = opening(outline, reach)
    spans, share = drawn.spans[:, : far + 1].astype(np.float64), drawn.share[:most]
    r = np.arange(most) / STEPS
    begun = ((r - SHARP) / (SOFT - SHARP)).clip(0, 1)
    lost = np.zeros((2, most + 1), np.float32)
    for side in (0, 1):
        begin, end = _left(spans, side)
        # of a lens, for a radius of 1 px, and as pixels have it
        middle = ((end**2 - begin**2) / 2)[far].sum() / (end - begin)[far].sum() / 4
        edges = np.stack([begin, end])[:, :most, :, None].clip(pixel - 0.5, pixel + 0.5)
        moved = ((edges[1] - edges[0]) * pixel).sum((1, 2)) / (end - begin)[:most].sum(1)
        first, second = moved[FIRST], moved[SECOND]
        mixed = np.where(r < NEAR[1], (1 - share) * first + share * second, moved)
        lost[side, :most] = begun * r * middle - np.where(r < NEAR[0], share * first, mixed)
    return lost


def _near_focus(r: NDArray[np.float64]) -> NDArray[np.float64]:
    """For each radius `r` px, which is blurred by a mean of two discs, the share of the larger one.

    The two are those next to `r` of three discs: a point, and the radii of NEAR.
    """
    rising = ((SOFT / NEAR[0]) * (r - SHARP) / (SOFT - SHARP)) ** 2
    first = np.where(r <= SHARP, 0.0, np.where(r < SOFT, rising, (r / NEAR[0]) ** 2))
    squares = [radius**2 for radius in NEAR]
    return np.where(r < NEAR[0], first, (r * r - squares[0]) / (squares[1] - squares[0]))

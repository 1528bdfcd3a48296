"""Elements: pictures of some objects alone, with alpha.

Where alpha is 0 there is nothing, and depth means nothing: 0, NaN, inf, whatever was there. At an
edge, where alpha is below 1, depth may be that of the background, if the middle of the pixel missed
the object, or an average with it: it has the depth of the solid pixels beside it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.arrays import Keeping, bands
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.images.color import Color
from defocus_core.picture.take import InputPair
from defocus_core.system.text import counted

# Pixels from an edge within which a pixel has the depth that it lacks; steps to the pixels around.
_REACH = 8
# Width in px of an edge that a filter of the renderer makes, and the share by which depth there may
# be beyond that of the solid pixels beside: the silhouette of a ball bends away.
_EDGE, _BEYOND = 3, 0.02
_WHOLE = 0.995  # least alpha of a solid pixel
_STEPS = tuple((y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if (y, x) != (0, 0))


def element_depth(depth: Depth, color: Color, keeping: Keeping) -> Depth:
    """The depth of an element: its edges have one, and where alpha is 0 there is nothing.

    Light without alpha, like a flame, stays where it has a depth.
    """
    alpha = color.alpha
    if alpha is None or not any((alpha[rows] < 1).any() for rows in bands(alpha.shape)):
        return depth
    filled = _fill_edges(depth, alpha)
    nothing, count, glowing = keeping.new(alpha.shape, np.bool_), 0, 0
    for rows in bands(alpha.shape):
        clear = np.asarray(alpha[rows]) == 0
        lit = np.logical_or.reduce([plane[rows] != 0 for plane in color.light])
        glow = clear & lit & depth.valid(rows)
        nothing[rows] = clear & ~glow
        count, glowing = count + int(np.count_nonzero(clear)), glowing + int(glow.sum())
        far = np.float32(0 if depth.is_radius else np.inf)
        depth.metres[rows] = np.where(clear & ~glow, far, depth.metres[rows])
    words = []
    if count > glowing:
        words.append(f"nothing where alpha is 0 in {counted(count - glowing, 'pixel')}")
    if glowing:
        words.append(f"light without alpha in {counted(glowing, 'pixel')}")
    if filled:
        words.append(f"{counted(filled, 'edge pixel')} given the depth beside them")
    note = ", ".join(filter(None, (depth.note, *words)))
    return replace(depth, note=note, empty=nothing if count > glowing else None)


def _fill_edges(depth: Depth, alpha: Any) -> int:
    """Give pixels of an edge that have no depth that of the pixels beside; how many there were."""
    count, above = 0, None
    height = alpha.shape[0]
    solid = min(1.0, max(float(np.max(alpha[rows])) for rows in bands(alpha.shape)))
    for rows in bands(alpha.shape):
        top, below = max(rows.start - _REACH, 0), min(rows.stop + _REACH, height)
        metres = np.array(depth.metres[top:below], np.float32)
        if above is not None:
            metres[: rows.start - top] = above
        fraction = np.asarray(alpha[top:below], np.float32)
        inner = slice(rows.start - top, rows.stop - top)
        above = metres[max(inner.stop - _REACH, 0) : inner.stop].copy()
        known = _has_depth(depth, metres)
        missing = (fraction > 0) & (fraction < 1) & ~known
        is_edge = (fraction > 0) & (fraction < solid)
        if solid >= _WHOLE and not depth.is_radius and is_edge.any():
            missing |= known & _is_mixed(metres, fraction, known, solid)
        if missing.any():
            filled = _from_beside(metres, fraction, missing, depth)
            given = (filled != metres) & missing
            count += int(np.count_nonzero(given[inner]))
            depth.metres[rows] = filled[inner]
    return count


def _is_mixed(
    metres: NDArray[np.float32],
    fraction: NDArray[np.float32],
    known: NDArray[np.bool_],
    solid: float,  # alpha of a pixel that shows nothing but the object
) -> NDArray[np.bool_]:
    """Where an edge is farther than every solid pixel beside it: what lies behind is mixed in."""
    farthest = np.where(known & (fraction >= solid), metres, np.float32(0))
    height, width = metres.shape
    for _ in range(_EDGE):
        padded = np.pad(farthest, 1)
        beside = [padded[1 + y : 1 + y + height, 1 + x : 1 + x + width] for y, x in _STEPS]
        farthest = np.where(fraction >= solid, farthest, np.maximum.reduce([farthest, *beside]))
    mixed: NDArray[np.bool_] = (fraction > 0) & (farthest > 0) & (metres > farthest * (1 + _BEYOND))
    return mixed & (fraction < solid)


def _has_depth(depth: Depth, metres: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Where there is a depth that is no sky."""
    finite: NDArray[np.bool_] = np.isfinite(metres)
    return finite if depth.is_radius else finite & (metres > 0)


def _from_beside(
    metres: NDArray[np.float32],
    fraction: NDArray[np.float32],
    missing: NDArray[np.bool_],
    depth: Depth,
) -> NDArray[np.float32]:
    """Depth in which missing pixels have that of the most opaque pixel around, `_REACH` times."""
    filled, known = metres.copy(), _has_depth(depth, metres) & (fraction > 0) & ~missing
    pad = ((1, 1), (1, 1))
    for _ in range(_REACH):
        weights = np.pad(np.where(known, fraction, 0), pad)
        values = np.pad(filled, pad, mode="edge")
        maximum, best = np.zeros_like(fraction), filled.copy()
        height, width = fraction.shape
        for y, x in _STEPS:
            window = (slice(1 + y, 1 + y + height), slice(1 + x, 1 + x + width))
            better = weights[window] > maximum
            maximum = np.where(better, weights[window], maximum)
            best = np.where(better, values[window], best)
        given = missing & ~known & (maximum > 0)
        filled, known = np.where(given, best, filled), known | given
    return filled


def empty_where_clear(given: InputPair) -> InputPair:
    """The pair of an element, whose depth knows where it is empty."""
    return given.with_depth(element_depth(given.depth, given.color, given.keeping))

"""Elements: pictures of some objects with alpha, which is 0 where there is nothing.

Where alpha is 0, depth may be any number. At edges, where alpha is between 0 and 1, depth may be
that of the background, if the object misses the middle of the pixel, or an average of object and
background. There, depth is replaced by that of adjacent pixels that the object covers fully.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.arrays import bands
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.images.color import Color
from defocus_core.picture.take import InputPair
from defocus_core.system.text import counted

# Distance in px within which a pixel without depth gets that of an edge, step by step.
_REACH = 8
_ALONG = 64  # the same for thin objects whose edges are known to be averages
# Width in px of an edge by the filter of a renderer, and the share by which depth there may exceed
# that of the solid pixels beside, as at the silhouette of a ball.
_EDGE, _BEYOND = 3, 0.02
_WHOLE = 0.995  # least alpha of a solid pixel
# Pairs of neighbours that show averages: least alpha and difference of alpha, least number, the
# share of pairs that must agree on a far end, and its tolerance as a share.
_LEAST, _UNLIKE, _ENOUGH, _MOST, _AGREE = 0.05, 0.1, 12, 0.7, 0.05
_PAIRS = 1 << 14  # of a band of rows
_HALF = 0.5  # least alpha at which an object covers the middle of a pixel
_IMPRECISE = 0.05  # tolerance as a share of the depth
_STEPS = tuple((y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if (y, x) != (0, 0))


def element_depth(depth: Depth, color: Color) -> Depth:
    """The depth of an element, repaired at edges, and marked as empty where alpha is 0.

    Pixels with alpha 0 that have light and a valid depth are not empty.
    """
    alpha = color.alpha
    if alpha is None or not (alpha < 1).any():
        return depth
    filled, lost = _fill_edges(depth, alpha)
    clear = alpha == 0
    glow = clear & depth.valid & np.logical_or.reduce([plane != 0 for plane in color.light])
    nothing = clear & ~glow
    depth.metres[nothing] = 0 if depth.is_radius else np.inf
    words = []
    if count := int(np.count_nonzero(nothing)):
        words.append(f"nothing where alpha is 0 in {counted(count, 'pixel')}")
    if glowing := int(np.count_nonzero(glow)):
        words.append(f"light without alpha in {counted(glowing, 'pixel')}")
    if filled:
        words.append(f"{counted(filled, 'edge pixel')} given the depth beside them")
    warnings = depth.warnings
    if lost:
        held = f"{counted(lost, 'edge pixel')} hold averages of depth with what is far away"
        warnings += (f"{depth.path.name}: {held}, and no depth of their own; render it unfiltered",)
    note = ", ".join(filter(None, (depth.note, *words)))
    return replace(depth, note=note, warnings=warnings, empty=nothing if count else None)


class _Edges(NamedTuple):
    """What depth means at edges of an element, as found from adjacent pixels of different alpha."""

    # of averages a zᵖ + (1 − a) farᵖ: p, farᵖ, and the error of numbers; p is 0 without averages
    power: int = 0
    far: float = 0.0
    noise: float = 0.0
    covered: float = 1.0  # least alpha of a pixel that holds the depth of the object

    def solved(
        self, metres: NDArray[np.float32], fraction: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """The depth of the object, computed from averages with the background.

        `fraction` is alpha. The result is NaN where alpha is too small to solve for the object.
        """
        with np.errstate(all="ignore"):
            share = fraction.astype(np.float64)
            own = (metres.astype(np.float64) ** self.power - (1 - share) * self.far) / share
            own = np.where(own * share * _IMPRECISE > self.noise, own, np.nan) ** self.power
        return np.where(fraction < 1, own, metres).astype(np.float32)


def _evidence(depth: Depth, alpha: Any) -> _Edges:
    """Find what depth means at edges: averages, a step at an alpha of 0.5, or neither."""
    pairs: list[NDArray[Any]] = []
    for rows in bands(alpha.shape):
        both = np.stack([np.asarray(each[rows], np.float32) for each in (alpha, depth.metres)])
        for one, two in ((both[:, :, 1:], both[:, :, :-1]), (both[:, 1:], both[:, :-1])):
            usable = (np.minimum(one[0], two[0]) > _LEAST) & (np.abs(one[0] - two[0]) > _UNLIKE)
            usable &= (np.minimum(one[1], two[1]) > 0) & np.isfinite(np.maximum(one[1], two[1]))
            y, x = np.nonzero(usable)
            some = slice(None, None, len(y) // _PAIRS + 1)
            pairs.append(np.concatenate([each[:, y[some], x[some]] for each in (one, two)]))
    a, z, b, w = every = np.concatenate(pairs, axis=1, dtype=np.float64)
    if len(a) < _ENOUGH:
        return _Edges()
    for power in (1, -1):
        slope = (z**power - w**power) / (a - b)
        ends = z**power - a * slope
        far = max(float(np.median(ends)), 0.0)
        agree = np.abs(ends - far) < _AGREE * np.abs(slope)
        if np.mean(agree & (slope * power < 0)) > _MOST:
            noise = float(np.median(np.abs(ends - far) * np.abs(a - b)))
            return _Edges(power, far, noise + abs(far) * float(np.finfo(np.float32).eps))
    more, less = np.where(a > b, every, every[[2, 3, 0, 1]])[[1, 3]]
    is_farther = less > more * (1 + _BEYOND)
    crosses = (np.minimum(a, b) < _HALF) & (np.maximum(a, b) >= _HALF)
    is_missed = np.count_nonzero(crosses) >= _ENOUGH and np.mean(is_farther[crosses]) > _MOST
    return _Edges(covered=_HALF if is_missed and np.mean(is_farther == crosses) > _MOST else 1.0)


def _fill_edges(depth: Depth, alpha: Any) -> tuple[int, int]:
    """Replace depth at edges of an element by that of the object, in place.

    Returns the number of edge pixels changed; and the number of those left as averages of object
    and background.
    """
    metres, fraction, lost = depth.metres, np.asarray(alpha, np.float32), 0
    solid = min(1.0, float(np.max(alpha)))
    edges = _Edges() if depth.is_radius else _evidence(depth, alpha)
    known, is_edge = _has_depth(depth, metres), (fraction > 0) & (fraction < 1)
    filled, missing, doubted = metres, is_edge & ~known, np.zeros(known.shape, bool)
    if edges.power:
        filled = np.where(is_edge & known, edges.solved(metres, fraction), metres)
        doubted = is_edge & known & ~_has_depth(depth, filled)
    elif edges.covered < 1:
        doubted = is_edge & known & (fraction < edges.covered)
    elif solid >= _WHOLE and not depth.is_radius and is_edge.any():
        doubted = known & _is_mixed(metres, fraction, known, solid)
    if (missing | doubted).any():
        reach = _REACH if edges == _Edges() else _ALONG
        filled = _from_beside(filled, fraction, missing | doubted, depth, reach)
        nearer = _has_depth(depth, filled) & (filled < metres)
        filled = np.where(doubted & ~nearer, metres, filled)
        lost = int(np.count_nonzero(doubted & ~nearer)) if edges.power else 0
    given = (filled != metres) & is_edge
    if count := int(np.count_nonzero(given)):
        depth.metres[:] = filled
    return count, lost


def _is_mixed(
    metres: NDArray[np.float32],
    fraction: NDArray[np.float32],
    known: NDArray[np.bool_],
    solid: float,  # alpha of a pixel that shows only the object
) -> NDArray[np.bool_]:
    """Edge pixels farther than all fully covered ones nearby: averages with the background.

    `fraction` is alpha, at least `solid` if fully covered; `known` marks pixels with a depth.
    """
    farthest = np.where(known & (fraction >= solid), metres, np.float32(0))
    height, width = metres.shape
    for _ in range(_EDGE):
        padded = np.pad(farthest, 1)
        beside = [padded[1 + y : 1 + y + height, 1 + x : 1 + x + width] for y, x in _STEPS]
        farthest = np.where(fraction >= solid, farthest, np.maximum.reduce([farthest, *beside]))
    mixed: NDArray[np.bool_] = (fraction > 0) & (farthest > 0) & (metres > farthest * (1 + _BEYOND))
    return mixed & (fraction < solid)


def _has_depth(depth: Depth, metres: NDArray[np.float32]) -> NDArray[np.bool_]:
    finite: NDArray[np.bool_] = np.isfinite(metres)
    return finite if depth.is_radius else finite & (metres > 0)


def _from_beside(
    metres: NDArray[np.float32],
    fraction: NDArray[np.float32],
    missing: NDArray[np.bool_],
    depth: Depth,
    reach: int,
) -> NDArray[np.float32]:
    """Fill missing pixels with the depth of the adjacent pixel of greatest alpha, `reach` times.

    `metres` are the numbers of `depth`, `fraction` is alpha.
    """
    filled, opacity = np.pad(metres, 1, mode="edge"), np.pad(fraction, 1)
    known = _has_depth(depth, metres) & (fraction > 0) & ~missing
    weights, (ys, xs) = np.pad(np.where(known, fraction, 0), 1), np.nonzero(missing)
    ys, xs = ys + 1, xs + 1
    for _ in range(reach):
        maximum, best = np.zeros(len(ys), np.float32), filled[ys, xs]
        for y, x in _STEPS:
            weight = weights[ys + y, xs + x]
            best = np.where(weight > maximum, filled[ys + y, xs + x], best)
            maximum = np.maximum(maximum, weight)
        given = maximum > 0
        if not given.any():
            break
        at = ys[given], xs[given]
        filled[at], weights[at] = best[given], opacity[at]
        ys, xs = ys[~given], xs[~given]
    return filled[1:-1, 1:-1]


def empty_where_clear(given: InputPair) -> InputPair:
    """The input pair with the depth of an element repaired; see `element_depth`."""
    return given.with_depth(element_depth(given.depth, given.color))

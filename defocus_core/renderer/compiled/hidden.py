"""What nearer surfaces hide, continued from farther ones: see `inpainting/hidden_layers.py`.

By coarse pixels of two by two px. Which surface shows behind an edge is told by cones around edges,
in integer grains (`inpainting/disocclusion.py`); its colour and radius are read from a pyramid, and
along lines that lead there (`inpainting/coherence_transport.py`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.renderer.compiled.coarse import CoarseAxis, coarse_axes
from defocus_core.renderer.compiled.jit import compiled, entry
from defocus_core.renderer.compiled.pyramid import Level, half_level, most_levels, pyramid_of
from defocus_core.renderer.inpainting.disocclusion import DECAY, EDGE, STEP, grain_of

F32 = np.float32
# Cones are integers: the radius, or px, in the upper bits, the radius of its edge in the lower.
_BITS, _LEVELS, _BETWEEN, _MAXIMUM = 16, 13, 0.013, 4096.0
_RADIUS, _NOWHERE = (1 << _BITS) - 1, -2 << _LEVELS << _BITS
_CEILING, _BORDER, _LINES, _NEXT, _ENOUGH, _LEAST = 0.497, 0.377, 20.1 * DECAY, 4.0, 0.5, 1e-30
# Levels that decide the direction of lines together, from a quarter of the resolution on.
_DIRECTIONS = 3
# Of lines: see `inpainting/coherence_transport.py`.
_STEPS = np.array((2.1, 4.1, 7.1, 11.1, 16.1, 22.1))
_FARTHEST, _ALIKE, _FLAT, _UNCLEAR = 24, 2.013, 1e-3, 0.05
_NORMAL = (1 + _UNCLEAR**2) ** 0.5 - _UNCLEAR


class _EdgeCones(NamedTuple):
    """The surfaces at edges of depth around coarse pixels."""

    farthest: NDArray[np.int32]  # [h, w] the greatest cone, and the radius of its edge
    closest: NDArray[np.int32]  # [h, w] minus the px to the closest edge, and its radius
    grain: float  # px of one grain


@entry
def mark_edges(radius, grain, down, across, edges):
    """The radii of the farther pixels at edges, as cones in coarse pixels [h, w]; says if any."""
    height, width = radius.shape
    found = False
    for y in range(height):
        for x in range(width):
            r, far = radius[y, x], False
            for i in range(4):
                v, u = y + (i == 0) - (i == 1), x + (i == 2) - (i == 3)
                if 0 <= v < height and 0 <= u < width:
                    far |= r - radius[v, u] > EDGE
            if not far:
                continue
            found = True
            level = np.int32(np.rint(min(max(r, -_MAXIMUM), _MAXIMUM) / grain + _BETWEEN))
            cone = (level << _BITS) + (level + (1 << _LEVELS))
            for a in range(2 if down.odd else 1):
                for b in range(2 if across.odd else 1):
                    i, j = (y + down.before + a) // 2, (x + across.before + b) // 2
                    edges[i, j] = max(edges[i, j], np.int32(cone))
    return found


def _dilated(edges: NDArray[np.int32], decay: int, span: float) -> NDArray[np.int32]:
    """Edges whose upper bits fall by the decay per px, by `span` at most; in place."""
    reached, stride = 0, 1
    while 2 * reached * decay < span:
        fall = np.int32((2 * decay * stride) << _BITS)
        for lines in (edges, edges.T):
            n = len(lines) - stride
            if n > 0:
                fallen = lines - fall
                np.maximum(lines[stride:], fallen[:n], out=lines[stride:])
                np.maximum(lines[:n], fallen[stride:], out=lines[:n])
        reached, stride = reached + stride, 2 * stride
    return edges


@compiled
def _least_of(radius, i, j, down, across):
    """The least radius of the pixels of a coarse pixel."""
    height, width = radius.shape
    least = F32(np.inf)
    for a in range(-down.odd, 2):
        y = 2 * i + a - down.before
        for b in range(-across.odd, 2):
            x = 2 * j + b - across.before
            if 0 <= y < height and 0 <= x < width:
                least = min(least, radius[y, x])
    return least


class _Levels(NamedTuple):
    """Levels of a pyramid, pixels one after another: see `pyramid.py`."""

    values: NDArray[np.float32]  # [n, 2, K]
    limits: NDArray[np.float32]  # [n, 2, 3]
    size: NDArray[np.int64]  # [levels, 3] where each begins, its height and its width
    place: NDArray[np.float64]  # [levels, 3] px of a coarse pixel, and where pixel 0 is


def _levels_of(
    pyramid: list[Level], first: int, down: list[CoarseAxis], across: list[CoarseAxis]
) -> _Levels:
    """Levels of which the first one has a number."""
    sizes = [values.shape[:2] for values, _ in pyramid]
    begins = np.cumsum([0, *(height * width for height, width in sizes)])
    numbers = range(first, first + len(pyramid))
    values, limits = (
        np.concatenate([x.reshape(-1, *x.shape[2:]) for x in each])
        for each in zip(*pyramid, strict=True)
    )
    places = [(begin, *size) for begin, size in zip(begins, sizes, strict=False)]
    steps = [(1 << n, down[n].origin, across[n].origin) for n in numbers]
    return _Levels(values, limits, np.array(places, np.int64), np.array(steps, np.float64))


@compiled
def read_level(levels, n, y, x, around, border, ceiling):
    """The mean of the surfaces around a place in px that lie between two radii.

    around: px on each side of the two places whose mean is asked for. Returns three colours, the
    radius, and three values of structure if there are any, all times their weight, and the weight.
    """
    values, limits = levels.values, levels.limits
    start, height, width = levels.size[n, 0], levels.size[n, 1], levels.size[n, 2]
    step, structured = levels.place[n, 0], values.shape[2] > 4
    total = c0 = c1 = c2 = r = xx = xy = yy = 0.0
    v, u, away = levels.place[n, 1] + y / step, levels.place[n, 2] + x / step, around / step
    top, left = np.int64(np.floor(v - away)), np.int64(np.floor(u - away))
    taps = 3 if around > 0 else 2
    for a in range(max(top, 0), min(top + taps, height)):
        rows = max(1 - abs(a - v - away), 0.0) + max(1 - abs(a - v + away), 0.0)
        for b in range(max(left, 0), min(left + taps, width)):
            share = max(1 - abs(b - u - away), 0.0) + max(1 - abs(b - u + away), 0.0)
            share *= rows / 4
            at = start + a * width + b
            for k in range(2):
                weight = share * limits[at, k, 0]
                if weight > 0 and border < limits[at, k, 1] < ceiling:
                    total += weight
                    c0 += weight * values[at, k, 0]
                    c1 += weight * values[at, k, 1]
                    c2 += weight * values[at, k, 2]
                    r += weight * values[at, k, 3]
                    if structured:
                        xx += weight * values[at, k, 4]
                        xy += weight * values[at, k, 5]
                        yy += weight * values[at, k, 6]
    turned = 1 / max(total, 1.0)
    return (
        *(c0 * turned, c1 * turned, c2 * turned, r * turned),
        *(xx * turned, xy * turned, yy * turned, total * turned),
    )


@compiled
def _direction(tensor, color):
    """The direction (y, x) in which a place changes least, and how clear it is."""
    xx, xy, yy = tensor
    flat = 1.2e-38 + _FLAT**2 * (color[0] ** 2 + color[1] ** 2 + color[2] ** 2)
    trace = xx + yy + flat
    cosine, sine = (xx - yy) / trace, 2 * xy / trace
    square = cosine * cosine + sine * sine
    coherence = (math.sqrt(square + _UNCLEAR**2) - _UNCLEAR) / _NORMAL
    half = cosine / (math.sqrt(square) if square > 0 else 1.0)
    y = math.sqrt(max((1 + half) / 2, 0.0))
    x = math.sqrt(max((1 - half) / 2, 0.0))
    return y, -x if sine > 0 else x, coherence


@compiled
def _first_beyond(half, i, j, y, x, border):
    """The first coarse pixel along a direction beyond a border of radius, and how far it is, px."""
    height, width = half.size[0, 1], half.size[0, 2]
    for step in _STEPS:
        dy, dx = y * step / 2, x * step / 2
        row = i + np.int64(dy + math.copysign(0.5, y))
        column = j + np.int64(dx + math.copysign(0.5, x))
        at = min(max(row, 0), height - 1) * width + min(max(column, 0), width - 1)
        if half.values[at, 0, 3] > border:
            return at, step
    return 0, np.inf


@compiled
def _transport(half, i, j, border, smooth, tensor):
    """The colours along a line that leads there, of those that are continued smoothly [4]."""
    values, (y, x, coherence) = half.values, _direction(tensor, smooth)
    a, to_first = _first_beyond(half, i, j, y, x, border)
    b, to_second = _first_beyond(half, i, j, -y, -x, border)
    first = to_first < _FARTHEST and abs(values[a, 0, 3] - smooth[3]) < _ALIKE
    second = to_second < _FARTHEST and abs(values[b, 0, 3] - smooth[3]) < _ALIKE
    part, weight = 0.0, 0.0
    if first and second:
        part, weight = to_second / (to_first + to_second), coherence
    elif first:
        part, weight = 1.0, coherence * (1 - to_first / _FARTHEST)
    elif second:
        weight = coherence * (1 - to_second / _FARTHEST)
    own, rest = weight * part, weight * (1 - part)
    return (
        smooth[0] * (1 - weight) + own * values[a, 0, 0] + rest * values[b, 0, 0],
        smooth[1] * (1 - weight) + own * values[a, 0, 1] + rest * values[b, 0, 1],
        smooth[2] * (1 - weight) + own * values[a, 0, 2] + rest * values[b, 0, 2],
    )


@compiled
def _surface_at(half, levels, y, x, border, ceiling, directions):
    """The farther surfaces around a place in px: colours and radius, structure, their weight.

    directions: the number of levels whose structure is asked for.
    """
    c0, c1, c2, r, _, _, _, found = read_level(half, np.int64(0), y, x, 0.5, border, ceiling)
    own = min(found * _NEXT, 1.0)
    weight = s0 = s1 = s2 = s3 = xx = xy = yy = 0.0
    for n in range(levels.size.shape[0]):
        if n >= directions and (weight >= _ENOUGH or own >= 1):
            break
        d0, d1, d2, d3, d4, d5, d6, more = read_level(levels, n, y, x, 0.0, border, ceiling)
        if n < directions:
            xx, xy, yy = xx + d4, xy + d5, yy + d6
        missing = 1 - weight if weight < _ENOUGH else 0.0
        s0, s1, s2, s3 = s0 + missing * d0, s1 + missing * d1, s2 + missing * d2, s3 + missing * d3
        weight += missing * more
    scale, rest = own / max(found, _LEAST), 1 - own
    weight = own + weight * rest
    scale, rest = scale / max(weight, _LEAST), rest / max(weight, _LEAST)
    surface = (
        *(c0 * scale + s0 * rest, c1 * scale + s1 * rest),
        *(c2 * scale + s2 * rest, r * scale + s3 * rest),
    )
    return surface, (xx, xy, yy), weight


@entry
def continue_hidden(radius, half, levels, edges, down, across, light, coarse_radius):
    """Continue farther surfaces behind nearer ones: light [h, 4 w], coarse_radius [h, w] px.

    half: the level of half resolution; levels: those from a quarter on. Returns whether there is
    any.
    """
    farthest, closest, grain = edges
    h, w = farthest.shape
    lost, any_hidden = math.floor(DECAY / grain), False
    for i in range(h):
        for j in range(w):
            far = (farthest[i, j] & _RADIUS) - (1 << _LEVELS)
            shown = min((farthest[i, j] >> _BITS) + lost, far) * grain
            near = _least_of(radius, i, j, down, across)
            coarse_radius[i, j] = near
            next_to = ((closest[i, j] & _RADIUS) - (1 << _LEVELS)) * grain
            reached = next_to + DECAY * (closest[i, j] >> _BITS)
            source, front, ceiling = far * grain, np.float64(near), np.inf
            if reached > near + STEP and source > next_to + STEP:
                if abs(next_to) <= abs(source):
                    shown, ceiling = reached, next_to + (source - next_to) * _CEILING
                    source = next_to
                else:
                    front = next_to
            if not shown > near + STEP:
                continue
            border = front + (source - front) * _BORDER
            y, x = (i - down.origin) * 2, (j - across.origin) * 2
            lines = source - shown <= _LINES
            directions = _DIRECTIONS if lines else 0
            surface, tensor, weight = _surface_at(half, levels, y, x, border, ceiling, directions)
            if weight <= 0 or surface[3] <= near + STEP:
                continue
            colors = surface[:3]
            if lines:
                colors = _transport(half, i, j, border, surface, tensor)
            any_hidden = True
            for c in range(3):
                light[i, 4 * j + c] = colors[c]
            light[i, 4 * j + 3] = 1
            coarse_radius[i, j] = surface[3]
    return any_hidden


def hidden_of(
    light: NDArray[np.float32],
    radius: NDArray[np.float32],
    nearer: NDArray[np.float32] | None,
    limit: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """What is hidden, by coarse pixels: light [h, 4 w] and radius [h, w] px; None if nothing is.

    light: [H, 4 W] of the surfaces that the depth names; radius: [H, W]; nearer: [H, 4 W] light of
    nearer ones in the same pixels; limit: brightness above which a pixel is a highlight.
    """
    H, W = radius.shape
    minimum, maximum = float(radius.min()), float(radius.max())
    span, grain = maximum - minimum, grain_of(minimum, maximum)
    most = most_levels(span)
    down, across = coarse_axes(H, most), coarse_axes(W, most)
    cones = np.full((down[1].length, across[1].length), _NOWHERE, np.int32)
    if not mark_edges(radius, grain, down[1], across[1], cones):
        return None
    close = np.where(cones == _NOWHERE, np.int32(_NOWHERE), cones & _RADIUS).astype(np.int32)
    edges = _EdgeCones(
        _dilated(cones, math.floor(DECAY / grain), span / grain), _dilated(close, 1, span), grain
    )
    half = half_level(light, radius, limit, nearer, down[1], across[1])
    pyramid = pyramid_of(half, span, down, across)
    first, others = (
        _levels_of(x, n, down, across) for n, x in ((1, pyramid[:1]), (2, pyramid[1:]))
    )
    result = np.zeros((cones.shape[0], 4 * cones.shape[1]), np.float32)
    coarse_radius = np.empty(cones.shape, np.float32)
    if not continue_hidden(
        *(radius, first, others, edges, down[1], across[1], result, coarse_radius)
    ):
        return None
    return result, coarse_radius

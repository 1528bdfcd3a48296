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

from defocus_core.renderer.compiled.coarse import coarse_axes
from defocus_core.renderer.compiled.jit import compiled, entry
from defocus_core.renderer.compiled.pyramid import half_level, most_levels, pyramid_of
from defocus_core.renderer.inpainting.disocclusion import DECAY, EDGE, STEP, grain_of

F32 = np.float32
# Cones are integers: the radius, or px, in the upper bits, the radius of its edge in the lower.
_BITS, _LEVELS, _BETWEEN, _MAXIMUM = 16, 13, 0.013, 4096.0
_RADIUS, _NOWHERE = (1 << _BITS) - 1, -2 << _LEVELS << _BITS
_CEILING, _BORDER, _LINES, _NEXT, _ENOUGH, _LEAST = 0.497, 0.377, 20.1 * DECAY, 4.0, 0.5, 1e-30
# Levels that decide the direction of lines together, from a quarter of the resolution on.
_DIRECTIONS = 3
_MOST_LEVELS = 16
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


@compiled
def read_level(level, y, x, around, border, ceiling, found):
    """The mean of the surfaces around a place in px that lie between two radii: found [K + 1].

    level: values, limits, px of a coarse pixel, and where pixel 0 is; around: px on each side of
    the two places whose mean is asked for. Values are times their weight, which is the last.
    """
    values, limits, step, origin_y, origin_x = level
    height, width, count = values.shape[0], values.shape[1], values.shape[3]
    found[:] = 0
    total = 0.0
    v, u, away = origin_y + y / step, origin_x + x / step, around / step
    top, left = np.int64(np.floor(v - away)), np.int64(np.floor(u - away))
    taps = 3 if around > 0 else 2
    for a in range(max(top, 0), min(top + taps, height)):
        p, q = max(1 - abs(a - v - away), 0.0), max(1 - abs(a - v + away), 0.0)
        for b in range(max(left, 0), min(left + taps, width)):
            share = max(1 - abs(b - u - away), 0.0) + max(1 - abs(b - u + away), 0.0)
            share *= (p + q) / 4
            if share <= 0:
                continue
            for k in range(2):
                least = limits[a, b, k, 1]
                weight = share * limits[a, b, k, 0]
                if weight > 0 and border < least < ceiling:
                    total += weight
                    for c in range(count):
                        found[c] += weight * values[a, b, k, c]
    most = max(total, 1.0)
    for c in range(count):
        found[c] /= most
    found[-1] = total / most


@compiled
def _direction(tensor, color):
    """The direction (y, x) in which a place changes least, and how clear it is."""
    xx, xy, yy = tensor[0], tensor[1], tensor[2]
    flat = 1.2e-38
    for c in range(3):
        flat += _FLAT**2 * color[c] * color[c]
    trace = xx + yy + flat
    cosine, sine = (xx - yy) / trace, 2 * xy / trace
    square = cosine * cosine + sine * sine
    coherence = (math.sqrt(square + _UNCLEAR**2) - _UNCLEAR) / _NORMAL
    half = cosine / (math.sqrt(square) if square > 0 else 1.0)
    y = math.sqrt(max((1 + half) / 2, 0.0))
    x = math.sqrt(max((1 - half) / 2, 0.0))
    return y, -x if sine > 0 else x, coherence


@compiled
def _first_beyond(values, i, j, y, x, border):
    """The first coarse pixel along a direction beyond a border of radius, and how far it is, px."""
    height, width = values.shape[:2]
    for step in _STEPS:
        dy, dx = y * step / 2, x * step / 2
        row = i + np.int64(dy + math.copysign(0.5, y))
        column = j + np.int64(dx + math.copysign(0.5, x))
        row, column = min(max(row, 0), height - 1), min(max(column, 0), width - 1)
        if values[row, column, 0, 3] > border:
            return row, column, step
    return 0, 0, np.inf


@compiled
def _transport(values, i, j, border, smooth, tensor):
    """Change the colours that are continued smoothly [4] to those along a line that leads there."""
    y, x, coherence = _direction(tensor, smooth)
    a, b, to_first = _first_beyond(values, i, j, y, x, border)
    c, d, to_second = _first_beyond(values, i, j, -y, -x, border)
    first = to_first < _FARTHEST and abs(values[a, b, 0, 3] - smooth[3]) < _ALIKE
    second = to_second < _FARTHEST and abs(values[c, d, 0, 3] - smooth[3]) < _ALIKE
    if first and second:
        part, weight = to_second / (to_first + to_second), coherence
    elif first:
        part, weight = 1.0, coherence * (1 - to_first / _FARTHEST)
    elif second:
        part, weight = 0.0, coherence * (1 - to_second / _FARTHEST)
    else:
        return
    for k in range(3):
        between = part * values[a, b, 0, k] + (1 - part) * values[c, d, 0, k]
        smooth[k] += weight * (between - smooth[k])


@compiled
def _surface_at(levels, count, y, x, border, ceiling, found, surface, tensor):
    """The farther surfaces around a place in px: surface [4], tensor [3]; returns their weight."""
    weight = 0.0
    surface[:], tensor[:] = 0, 0
    for n in range(1, count):
        if n > _DIRECTIONS and weight >= _ENOUGH:
            break
        read_level(levels[n], y, x, 0.0, border, ceiling, found)
        if n <= _DIRECTIONS:
            for c in range(3):
                tensor[c] += found[4 + c]
        missing = 1 - weight if weight < _ENOUGH else 0.0
        for c in range(4):
            surface[c] += missing * found[c]
        weight += missing * found[7]
    read_level(levels[0], y, x, 0.5, border, ceiling, found)
    own = min(found[7] * _NEXT, 1.0)
    scale = own / max(found[7], _LEAST)
    weight = own + weight * (1 - own)
    for c in range(4):
        surface[c] = (found[c] * scale + surface[c] * (1 - own)) / max(weight, _LEAST)
    return weight


@entry
def continue_hidden(radius, levels, count, edges, down, across, light, coarse_radius):
    """Continue farther surfaces behind nearer ones: light [h, 4 w], coarse_radius [h, w] px.

    levels: from half resolution on, as of `read_level`, of which `count` are there. Returns
    whether there is any.
    """
    farthest, closest, grain = edges
    h, w = farthest.shape
    found, surface, tensor = np.empty(8), np.empty(4), np.empty(3)
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
            weight = _surface_at(levels, count, y, x, border, ceiling, found, surface, tensor)
            if weight <= 0 or surface[3] <= near + STEP:
                continue
            if source - shown <= _LINES:
                _transport(levels[0][0], i, j, border, surface, tensor)
            any_hidden = True
            for c in range(3):
                light[i, 4 * j + c] = surface[c]
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
    steps = [(float(2 << n), down[n + 1].origin, across[n + 1].origin) for n in range(len(pyramid))]
    levels = [(*level, *step) for level, step in zip(pyramid, steps, strict=True)]
    levels += levels[-1:] * (_MOST_LEVELS - len(levels))  # one type of tuple is compiled once
    result = np.zeros((cones.shape[0], 4 * cones.shape[1]), np.float32)
    coarse_radius = np.empty(cones.shape, np.float32)
    if not continue_hidden(
        *(radius, tuple(levels), len(pyramid), edges, down[1], across[1], result, coarse_radius)
    ):
        return None
    return result, coarse_radius

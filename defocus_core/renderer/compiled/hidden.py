"""Hidden parts of farther surfaces, invented as in `inpainting/hidden_layers.py`.

Coarse pixels are 2 x 2 px. Cones around depth edges, in integer units called grains, decide which
surface continues behind an edge (`inpainting/disocclusion.py`); its colour and radius are averaged
from a pyramid, and colour is carried along lines (`inpainting/coherence_transport.py`).
"""

from __future__ import annotations

import math

import numpy as np

from defocus_core.renderer.compiled.back import HiddenSamples, Samples
from defocus_core.renderer.compiled.coarse import coarse_pixels
from defocus_core.renderer.compiled.jit import compiled, entry
from defocus_core.renderer.compiled.pyramid import fill_levels, levels_for
from defocus_core.renderer.engine import limits
from defocus_core.renderer.inpainting.disocclusion import (
    BETWEEN,
    BITS,
    CEILING,
    DECAY,
    EDGE,
    FARTHEST,
    LEVELS,
    MAXIMUM,
    NOWHERE,
    RADIUS,
    STEP,
    grain_of,
)

F32 = np.float32
_STEPS, _NORMAL = np.array(limits.LINE_STEPS), (1 + limits.UNCLEAR**2) ** 0.5 - limits.UNCLEAR


@entry
def cones_at_edges(radius, grain, coarse):
    """The cones of the farther surfaces at depth edges, on coarse pixels.

    Returns two arrays [h, w], each packing two integers per coarse pixel, and whether there are
    edges. The lower bits hold the radius at an edge, in grains. The upper bits hold the height of
    the highest cone, in grains, in the first array, and minus the distance in px to the closest
    edge in the second.

    grain: px of one grain; coarse: `Coarse`.
    """
    (height, width), found, odd, before = radius.shape, False, coarse.odd, coarse.before
    farthest = np.full((coarse.length[1, 0], coarse.length[1, 1]), np.int32(NOWHERE), np.int32)
    closest = farthest.copy()
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
            level = np.int32(np.rint(min(max(r, -MAXIMUM), MAXIMUM) / grain + BETWEEN))
            cone = (level << BITS) + (level + (1 << LEVELS))
            for a in range(1 + odd[0]):
                for b in range(1 + odd[1]):
                    i, j = (y + before[1, 0] + a) // 2, (x + before[1, 1] + b) // 2
                    farthest[i, j] = max(farthest[i, j], np.int32(cone))
                    closest[i, j] = farthest[i, j] & RADIUS
    if found:
        _dilate(farthest, np.int32((2 * math.floor(DECAY / grain)) << BITS))
        _dilate(closest, np.int32(2 << BITS))
    return farthest, closest, found


@compiled
def _dilate(cones, fall):
    """Spread cones to all pixels, in place; their upper bits decrease by `fall` per pixel."""
    h, w = cones.shape
    lowest = np.int32(NOWHERE)
    for k in range(2 * h):
        i, before = (k, k - 1) if k < h else (2 * h - 1 - k, 2 * h - k)
        if 0 <= before < h:
            for j in range(w):
                cones[i, j] = max(cones[i, j], max(cones[before, j] - fall, lowest))
    for i in range(h):
        for j in range(1, w):
            cones[i, j] = max(cones[i, j], max(cones[i, j - 1] - fall, lowest))
        for j in range(w - 2, -1, -1):
            cones[i, j] = max(cones[i, j], max(cones[i, j + 1] - fall, lowest))


@compiled
def _least_of(radius, i, j, odd, before):
    """The least radius among the pixels of coarse pixel (i, j); odd, before: as in `Coarse`."""
    height, width = radius.shape
    top, left = 2 * i - before[1, 0], 2 * j - before[1, 1]
    least = F32(np.inf)
    for y in range(max(top - odd[0], 0), min(top + 2, height)):
        for x in range(max(left - odd[1], 0), min(left + 2, width)):
            least = min(least, radius[y, x])
    return least


@compiled
def read_level(levels, n, y, x, around, border, ceiling):
    """The mean, around (y, x) in px, of surfaces on level `n` with radii from border to ceiling.

    around: px in rows and in columns from (y, x) to the four points that are averaged, or 0.
    Returns three colours, the radius, three values of the structure tensor (0 if unknown), all
    times the weight, and the weight.
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
    """The direction (y, x) in which colours change least, and its coherence from 0 to 1.

    tensor: structure tensor xx, xy, yy; color: the mean colour.
    """
    xx, xy, yy = tensor
    flat = 1.2e-38 + limits.NO_SLOPE**2 * (color[0] ** 2 + color[1] ** 2 + color[2] ** 2)
    trace = xx + yy + flat
    cosine, sine = (xx - yy) / trace, 2 * xy / trace
    square = cosine * cosine + sine * sine
    coherence = (math.sqrt(square + limits.UNCLEAR**2) - limits.UNCLEAR) / _NORMAL
    half = cosine / (math.sqrt(square) if square > 0 else 1.0)
    y = math.sqrt(max((1 + half) / 2, 0.0))
    x = math.sqrt(max((1 - half) / 2, 0.0))
    return y, -x if sine > 0 else x, coherence


@compiled
def _first_beyond(half, i, j, y, x, border):
    """The first coarse pixel from (i, j) in direction (y, x) with a radius above `border`.

    half: `Levels` of half resolution. Returns the flat index of the pixel and its distance in px,
    which is infinite if there is none.
    """
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
    """The three colours of coarse pixel (i, j), carried along the direction of least change.

    half: `Levels` of half resolution; border: only surfaces of a greater radius are read; smooth:
    colours and radius of the smooth continuation, used where there is no clear direction; tensor:
    structure tensor xx, xy, yy.
    """
    values, (y, x, coherence) = half.values, _direction(tensor, smooth)
    a, to_first = _first_beyond(half, i, j, y, x, border)
    b, to_second = _first_beyond(half, i, j, -y, -x, border)
    first = to_first < FARTHEST and abs(values[a, 0, 3] - smooth[3]) < limits.TRANSPORTED
    second = to_second < FARTHEST and abs(values[b, 0, 3] - smooth[3]) < limits.TRANSPORTED
    part, weight = 0.0, 0.0
    if first and second:
        part, weight = to_second / (to_first + to_second), coherence
    elif first:
        part, weight = 1.0, coherence * (1 - to_first / FARTHEST)
    elif second:
        weight = coherence * (1 - to_second / FARTHEST)
    own, rest = weight * part, weight * (1 - part)
    return (
        smooth[0] * (1 - weight) + own * values[a, 0, 0] + rest * values[b, 0, 0],
        smooth[1] * (1 - weight) + own * values[a, 0, 1] + rest * values[b, 0, 1],
        smooth[2] * (1 - weight) + own * values[a, 0, 2] + rest * values[b, 0, 2],
    )


@compiled
def _surface_at(half, levels, y, x, border, ceiling, directions):
    """The mean of the surfaces around (y, x) in px with radii from `border` to `ceiling`.

    half, levels: `Levels` of half resolution and coarser; directions: number of levels on which the
    structure tensor is summed. Returns three colours and the radius, the structure tensor, and the
    weight.
    """
    c0, c1, c2, r, _, _, _, found = read_level(half, np.int64(0), y, x, 0.5, border, ceiling)
    own = min(found * limits.NEXT, 1.0)
    weight = s0 = s1 = s2 = s3 = xx = xy = yy = 0.0
    for n in range(levels.size.shape[0]):
        if n >= directions and (weight >= limits.ENOUGH or own >= 1):
            break
        d0, d1, d2, d3, d4, d5, d6, more = read_level(levels, n, y, x, 0.0, border, ceiling)
        if n < directions:
            xx, xy, yy = xx + d4, xy + d5, yy + d6
        missing = 1 - weight if weight < limits.ENOUGH else 0.0
        s0, s1, s2, s3 = s0 + missing * d0, s1 + missing * d1, s2 + missing * d2, s3 + missing * d3
        weight += missing * more
    scale, rest = own / max(found, limits.LEAST_WEIGHT), 1 - own
    weight = own + weight * rest
    scale, rest = scale / max(weight, limits.LEAST_WEIGHT), rest / max(weight, limits.LEAST_WEIGHT)
    surface = (
        *(c0 * scale + s0 * rest, c1 * scale + s1 * rest),
        *(c2 * scale + s2 * rest, r * scale + s3 * rest),
    )
    return surface, (xx, xy, yy), weight


@entry
def continue_hidden(picture, cones, grain, coarse, half, levels, light, coarse_radius):
    """Continue farther surfaces behind nearer ones: write `light` and `coarse_radius`.

    picture: light, radius and limit as for `fill_levels`; cones: from `cones_at_edges`; grain: px
    of one grain; coarse: `Coarse`; half, levels: from `levels_for`, filled here; light:
    [1, h, 4 w]; coarse_radius: [1, h, w] px. Returns the least and the greatest radius of the
    hidden surfaces; if nothing is hidden, the least exceeds the greatest.
    """
    (given, radius, limit), (farthest, closest) = picture, cones
    fill_levels(given, radius, limit, coarse, half, levels)
    lost, least, most = math.floor(DECAY / grain), F32(np.inf), F32(-np.inf)
    odd, before, origin = coarse.odd, coarse.before, coarse.origin
    for i in range(farthest.shape[0]):
        for j in range(farthest.shape[1]):
            far = (farthest[i, j] & RADIUS) - (1 << LEVELS)
            shown = min((farthest[i, j] >> BITS) + lost, far) * grain
            near = _least_of(radius, i, j, odd, before)
            coarse_radius[0, i, j] = near
            next_to = ((closest[i, j] & RADIUS) - (1 << LEVELS)) * grain
            reached = next_to + DECAY * (closest[i, j] >> BITS)
            source, front, ceiling = far * grain, np.float64(near), np.inf
            if reached > near + STEP and source > next_to + STEP:
                if abs(next_to) <= abs(source):
                    shown, ceiling = reached, next_to + (source - next_to) * CEILING
                    source = next_to
                else:
                    front = next_to
            if not shown > near + STEP:
                continue
            border = front + (source - front) * limits.BORDER
            y, x = (i - origin[1, 0]) * 2, (j - origin[1, 1]) * 2
            lines = source - shown <= limits.LINES * DECAY
            directions = limits.DIRECTIONS if lines else 0
            surface, tensor, weight = _surface_at(half, levels, y, x, border, ceiling, directions)
            if weight <= 0 or surface[3] <= near + STEP:
                continue
            colors = surface[:3]
            if lines:
                colors = _transport(half, i, j, border, surface, tensor)
            for c in range(3):
                light[0, i, 4 * j + c] = colors[c]
            light[0, i, 4 * j + 3] = 1
            r = F32(surface[3])
            coarse_radius[0, i, j], least, most = r, min(least, r), max(most, r)
    return least, most


def hidden_of(samples: Samples, limit: float) -> HiddenSamples | None:
    """The hidden surfaces of a picture; None if there are none.

    limit: brightness above which a pixel is a highlight.
    """
    radius, (minimum, maximum) = samples.radius[0], samples.range
    span, grain = maximum - minimum, grain_of(minimum, maximum)
    coarse = coarse_pixels(radius.shape, max(2, math.ceil(math.log2(max(2 * span, 1))) + 1))
    *cones, found = cones_at_edges(radius, grain, coarse)
    if not found:
        return None
    h, w = cones[0].shape
    light, coarse_radius = np.zeros((1, h, 4 * w), np.float32), np.empty((1, h, w), np.float32)
    picture = samples.light, radius, np.float32(limit)
    levels = levels_for(coarse, span)
    least, most = continue_hidden(
        picture, tuple(cones), grain, coarse, *levels, light, coarse_radius
    )
    if least > most:
        return None
    coarse_radius *= np.float32(0.5)
    return HiddenSamples(light, coarse_radius, (least, most))

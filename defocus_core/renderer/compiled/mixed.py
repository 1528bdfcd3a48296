"""Mixed pixels, split into the two surfaces of a depth edge as in `depth/matting.py`."""

from __future__ import annotations

import math

import numpy as np

from defocus_core.depth import matting
from defocus_core.depth.matting import AROUND, EDGE
from defocus_core.renderer.compiled.jit import compiled, entry
from defocus_core.tensors.neighbourhoods import HALFWAY

F32 = np.float32
_SIDE = 2 * AROUND + 1
_SQUARED = [(y * y + x * x) for y in range(-AROUND, AROUND + 1) for x in range(-AROUND, AROUND + 1)]
_BESIDE = np.exp(np.array(_SQUARED) / (-2 * matting.NEARBY**2))
_WITHIN_PIXEL = np.exp(np.array(_SQUARED) / (-2 * matting.PIXEL**2))
_WITHIN_PIXEL /= _WITHIN_PIXEL.sum()
_MIDDLE = len(_SQUARED) // 2
_TINY, _SMALLEST = math.sqrt(float(np.finfo(np.float32).tiny)), float(np.finfo(np.float32).tiny)


@compiled
def _range_around(radius, y, x):
    """The least and the greatest radius in the 3 x 3 px around pixel (y, x)."""
    least, most = radius[y, x], radius[y, x]
    for v in range(max(y - 1, 0), min(y + 2, radius.shape[0])):
        for u in range(max(x - 1, 0), min(x + 2, radius.shape[1])):
            least, most = min(least, radius[v, u]), max(most, radius[v, u])
    return least, most


@entry
def set_light(image, scale, light):
    """Write the colours of a picture [3, H, W], times `scale`, and coverage 1 to light [H, 4 W]."""
    for y in range(image.shape[1]):
        for x in range(image.shape[2]):
            for c in range(3):
                light[y, 4 * x + c] = image[c, y, x] * scale
            light[y, 4 * x + 3] = 1


@compiled
def _side_of(colors, radii, weight, side):
    """Write mean colour, variance of colour and mean radius of pixels to side [7].

    weight: [n] of the pixels. Returns their total weight; if that is 0, nothing is written.
    """
    total = 0.0
    for k in range(weight.shape[0]):
        total += weight[k]
    if total <= 0:
        return total
    brightest = 0.0
    for c in range(3):
        mean = 0.0
        for k in range(weight.shape[0]):
            mean += weight[k] * colors[k, c]
        side[c] = mean / total
        brightest = max(brightest, max(side[c], colors[_MIDDLE, c]))
    for c in range(3):
        spread, mean = 0.0, side[c]
        for k in range(weight.shape[0]):
            off = colors[k, c] - mean
            spread += weight[k] * off * off
        least = max(matting.MIN_DEVIATION * mean, matting.ROUNDING * brightest)
        side[3 + c] = spread / total + least * least + _TINY
    r = 0.0
    for k in range(weight.shape[0]):
        r += weight[k] * radii[k]
    side[6] = r / total
    return total


@compiled
def _thin_side(square, s, sides, room):
    """Write side `s` (0 is the nearer one) of an edge that has only mixed pixels on this side.

    Its colour is that of the pixels which differ most from the other side. square: from
    `_read_square`; sides: [2, 7]; room: [n] scratch. Returns the total weight of the pixels.
    """
    colors, radii, near, weight, _ = square
    side, other, most = sides[s], sides[1 - s], _SMALLEST
    for k in range(weight.shape[0]):
        room[k] = 0.0
        if weight[k] > 0 and near[k] == (s == 0):
            for c in range(3):
                off = colors[k, c] - other[c]
                room[k] += off * off
            most = max(most, room[k])
    for k in range(weight.shape[0]):
        pure = room[k] / most
        room[k] = weight[k] * pure * pure * pure * pure
    total = _side_of(colors, radii, room, side)
    for c in range(3, 6):
        side[c] = other[c]
    return total


@compiled
def _coverage(color, own, other, expected):
    """The most probable coverage of a pixel by its own surface, given its colour.

    own, other: sides [7] as `_side_of` writes them; expected: coverage expected from the depth
    around the pixel.
    """
    evidence = observed = 0.0
    for c in range(3):
        apart, variance = own[c] - other[c], (own[3 + c] + other[3 + c]) / 2
        evidence += apart * apart / variance
        observed += apart * (color[c] - other[c]) / variance
    best = min(max(observed / (evidence if evidence > 0 else 1.0), 0.0), 1.0)
    misfit = 0.0
    for c in range(3):
        off = color[c] - other[c] - best * (own[c] - other[c])
        misfit += off * off / (best * own[3 + c] + (1 - best) * other[3 + c])
    doubt = (1 + misfit) / matting.UNCERTAIN**2
    expected = 1 - (1 - expected) / (1 + misfit / matting.FOREIGN)
    return min(max((observed + expected * doubt) / (evidence + doubt), 0.0), 1.0)


@compiled
def _as_whole(alpha, is_near, own, other):
    """The coverage of a pixel by its own surface, raised to 1 where the pixel is hardly mixed.

    alpha: the coverage; is_near: whether its own surface is the nearer one; own, other: sides [7]
    as `_side_of` writes them.
    """
    evidence = 0.0
    for c in range(3):
        apart = own[c] - other[c]
        evidence += apart * apart / own[3 + c]
    limit = matting.WITHIN / math.sqrt(max(evidence, (matting.WITHIN / matting.WHOLE) ** 2))
    if is_near and abs(own[6]) <= matting.SHARP:
        limit = 1.0
    short = 1 - alpha
    return 1 - short + limit * limit / short if short > limit else 1.0


@compiled
def _clipped(mean, variance, other, color):
    """A value of `color` clipped to two standard deviations around a surface's mean.

    The range is extended to `other`. The result is not negative, unless `other` is.
    """
    reach = 2 * math.sqrt(variance)
    color = max(color, min(mean - reach, other))
    color = min(color, max(mean + reach, other))
    return max(color, min(other, 0.0))


@compiled
def _colors(color, own, other, alpha, c):
    """The values of channel `c` of a mixed pixel's own surface and of the other surface.

    color: value of the pixel; own, other: sides [7] as `_side_of` writes them; alpha: coverage by
    its own surface.
    """
    m, v, n, w = own[c], own[3 + c], other[c], other[3 + c]
    first, second, rest = alpha * v, (1 - alpha) * w, 1 - alpha
    residual = (color - alpha * m - rest * n) / (alpha * first + rest * second)
    own_color, free = m + residual * first, n + residual * second
    clipped = free - _clipped(n, w, n, free)
    own_color += rest / (alpha if alpha > 0 else 1.0) * clipped
    own_color = _clipped(m, v, color, own_color)
    left = (color - alpha * own_color) / (rest if alpha < 1 else 1.0)
    return own_color, _clipped(n, w, color, left)


@compiled
def _has_step(radius, y, x):
    """Whether neighbouring radii within 1 px of a pixel differ as much as separate surfaces do."""
    height, width = radius.shape
    left, right = max(x - 1, 0), min(x + 1, width - 1)
    up, down = max(y - 1, 0), min(y + 1, height - 1)
    steepest = F32(0)
    for i in (up, y, down):
        steepest = max(steepest, abs(radius[i, x] - radius[i, left]))
        steepest = max(steepest, abs(radius[i, right] - radius[i, x]))
    for j in (left, x, right):
        steepest = max(steepest, abs(radius[y, j] - radius[up, j]))
        steepest = max(steepest, abs(radius[down, j] - radius[y, j]))
    return steepest > F32(matting.STEP)


@compiled
def _read_square(picture, border, y, x, square):
    """Write the pixels of the square around (y, x) to `square`.

    picture: as for `split_mixed`; border: radius that separates the nearer from the farther
    surface; square: arrays of colours, radii, whether pixels are nearer, weights, and whether they
    are on an edge.
    """
    image, scale, limit, radius = picture
    colors, radii, near, weight, on_edge = square
    height, width = radius.shape
    r0, own = radius[y, x], radius[y, x] < border
    for k in range(_SIDE * _SIDE):
        row = min(max(y + k // _SIDE - AROUND, 0), height - 1)
        column = min(max(x + k % _SIDE - AROUND, 0), width - 1)
        r = radius[row, column]
        least, most = _range_around(radius, row, column)
        radii[k], near[k], on_edge[k] = r, r < border, most - least > EDGE
        brightest = 0.0
        for c in range(3):
            colors[k, c] = image[c, row, column] * scale
            brightest = max(brightest, colors[k, c])
        weight[k] = _BESIDE[k] if abs(r - r0) <= EDGE or near[k] != own else 0.0
        if brightest > limit:
            weight[k] *= matting.LIGHT


@compiled
def _find_sides(square, sides, room):
    """Write both surfaces of a square, nearer first, to sides [2, 7]; return whether both exist.

    square: from `_read_square`; room: [n] scratch.
    """
    colors, radii, near, weight, on_edge = square
    first = second = False
    for s in range(2):
        for k in range(room.shape[0]):
            room[k] = weight[k] if near[k] == (s == 0) and not on_edge[k] else 0.0
        first, second = second, _side_of(colors, radii, room, sides[s]) > 0
    if first == second:
        return first
    return _thin_side(square, np.int64(first), sides, room) > 0


@entry
def split_mixed(picture, light, radii):
    """Split mixed pixels into the surface at the depth of each pixel and a nearer surface.

    picture: colours [3, H, W], their scale, the brightness that a highlight exceeds, and radii
    [H, W]; light: [2, H, 4 W], the light of the picture and 0, overwritten by the light of both
    surfaces; radii: [2, H, W] of both surfaces, overwritten. Returns whether any pixel holds a part
    of a nearer surface.
    """
    radius, count = picture[3], _SIDE * _SIDE
    square = (
        *(np.empty((count, 3)), np.empty(count), np.empty(count, np.bool_)),
        *(np.empty(count), np.empty(count, np.bool_)),
    )
    colors, near = square[0], square[2]
    sides, room, found = np.empty((2, 7)), np.empty(count), False
    for y in range(radius.shape[0]):
        for x in range(radius.shape[1]):
            least, most = _range_around(radius, y, x)
            if most - least <= EDGE or not _has_step(radius, y, x):
                continue
            border = F32(least + (most - least) * HALFWAY)
            _read_square(picture, border, y, x, square)
            if not _find_sides(square, sides, room):
                continue
            is_near = near[_MIDDLE]
            own, other = (sides[0], sides[1]) if is_near else (sides[1], sides[0])
            expected = 0.0
            for k in range(count):
                expected += _WITHIN_PIXEL[k] if near[k] == is_near else 0.0
            color = colors[_MIDDLE]
            alpha = _as_whole(_coverage(color, own, other, expected), is_near, own, other)
            covered, rest = (alpha, 0.0) if is_near else (1.0, 1 - alpha)
            for c in range(3):
                a, b = _colors(color[c], own, other, alpha, c)
                light[0, y, 4 * x + c], light[1, y, 4 * x + c] = a * covered, b * rest
            light[0, y, 4 * x + 3], light[1, y, 4 * x + 3] = covered, rest
            radii[1, y, x] = other[6]
            found |= rest > 0
    return found

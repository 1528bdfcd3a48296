"""The farthest slot that the lens sees at each pixel: the farthest within the pixel's blur disc.

Hidden surfaces are seen only where the disc of the front surface reaches over an edge; see
`compositing/sight.py`.
"""

from __future__ import annotations

import numpy as np

from defocus_core.renderer.compiled.jit import compiled, entry
from defocus_core.renderer.compiled.spread import step_of
from defocus_core.renderer.engine import limits

F32 = np.float32


@entry
def farthest_seen(light, radius, table):
    """The farthest slot [H, W] within the blur disc of each pixel.

    light: [H, 4 W]; radius: [H, W] px; table: slots by radius, as for `surfaces_of`. Surfaces count
    as farther than they are by about half the distance between slices of the torch back.
    """
    height, width = radius.shape
    seen, sizes = np.zeros((height, width), np.uint8), np.empty((height, width), np.int32)
    most = 1
    for y in range(height):
        for x in range(width):
            r = radius[y, x]
            size = np.int32(np.rint((abs(r) + F32(limits.SEEN_AROUND)) * F32(limits.APOTHEM)))
            sizes[y, x] = max(size, 1)
            most = max(most, sizes[y, x])
            r += max(abs(r) * F32(0.06), F32(0.37))
            q = min(step_of(r), table.shape[1] - 1)
            if light[y, 4 * x + 3] > 0:
                seen[y, x] = table[np.int64(r > 0), q]
    result, rows, both = seen.copy(), np.empty_like(seen), np.empty_like(seen)
    before, size, number = 0, 1, 0
    while True:
        after = max(size + 1, int(np.rint(limits.SEEN_RATIO * size)))
        _dilate(seen, size - before, limits.SQUARES[number % len(limits.SQUARES)], rows, both)
        seen, both = both, seen
        for y in range(height):
            for x in range(width):
                px = sizes[y, x]  # of the size that is closest to it
                if px - before > size - px and (px - size <= after - px or size >= most):
                    result[y, x] = seen[y, x]
        if size >= most:
            return result
        before, size, number = size, after, number + 1


@compiled
def _dilate(values, by, square, rows, out):
    """Write to `out` [H, W] the maximum of each value and the values `by` px away from it.

    square: whether these are eight, also on diagonals, or four; rows: scratch.
    """
    height, width = values.shape
    given = rows if square else values
    for y in range(height):
        above, below = max(y - by, 0), min(y + by, height - 1)
        for x in range(width):
            greatest = values[y, x]
            if y >= by:
                greatest = max(greatest, values[above, x])
            if y + by < height:
                greatest = max(greatest, values[below, x])
            rows[y, x] = out[y, x] = greatest
        for x in range(by, width):
            out[y, x] = max(out[y, x], given[y, x - by])
        for x in range(width - by):
            out[y, x] = max(out[y, x], given[y, x + by])


@compiled
def _area_below(areas, y, x):
    """The share of an opening's area above and to the left of lens point (y, x).

    areas: the table that `areas_below` returns.
    """
    most = areas.shape[0] - 1
    v, u = (y + 1) * most / 2, (x + 1) * most / 2
    v, u = min(max(v, 0.0), most - 1e-6), min(max(u, 0.0), most - 1e-6)
    i, j = np.int64(v), np.int64(u)
    f, g = v - i, u - j
    above = areas[i, j] * (1 - g) + areas[i, j + 1] * g
    return above * (1 - f) + (areas[i + 1, j] * (1 - g) + areas[i + 1, j + 1] * g) * f


@entry
def keep_in_frame(radius, areas, trust):
    """Multiply trust [H, W] by the share of the aperture that sees the surface in the frame.

    Lens point u images the surface at pixel q to q + r u: pixel x sees the surface at x - r u.

    radius: [H, W] px; areas: the table that `areas_below` returns.
    """
    height, width = radius.shape
    for y in range(height):
        near = min(y, height - 1 - y) + 0.5
        for x in range(width):
            r = np.float64(radius[y, x])
            if abs(r) <= min(near, min(x, width - 1 - x) + 0.5):
                continue
            top, bottom = (y + 0.5) / r, (y + 0.5 - height) / r
            left, right = (x + 0.5) / r, (x + 0.5 - width) / r
            share = _area_below(areas, top, left) - _area_below(areas, top, right)
            share += _area_below(areas, bottom, right) - _area_below(areas, bottom, left)
            trust[y, x] *= np.float32(max(abs(share), limits.IN_FRAME))

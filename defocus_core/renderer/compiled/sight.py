"""How far the lens sees at each pixel: the farthest slot within the disc of its own radius.

See `compositing/sight.py`: behind a surface nothing is seen but where its own disc passes an edge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from defocus_core.renderer.compiled.jit import compiled, entry
from defocus_core.renderer.compiled.slots import Slots

# Px around the disc of a pixel that it may see; ratio of the sizes of discs that are told apart;
# squares and crosses, in turn, whose sum is nearly a disc; its apothem as a share of the radius.
_AROUND, _RATIO, _APOTHEM = 0.7, 1.1, 0.97
_SQUARES = (True, False, False, True, False)


def farthest_seen(slot: NDArray[np.int16], radius: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The farthest slot within the disc of each pixel: [H, W]."""
    size = np.abs(radius)
    size += _AROUND
    size *= _APOTHEM
    px = np.rint(size, out=size).clip(1, None, out=size).astype(np.int32)
    del size  # a large array
    sizes, most = [1], int(px.max())
    while sizes[-1] < most:
        sizes.append(max(sizes[-1] + 1, round(_RATIO * sizes[-1])))
    nearest = np.abs(np.array(sizes)[:, None] - np.arange(sizes[-1] + 1)).argmin(0)
    which = nearest.astype(np.uint8)[px]
    del px
    seen = slot.clip(0, None).astype(np.uint8)
    result = seen.copy()
    for number, (size_px, before) in enumerate(zip(sizes, [0, *sizes], strict=False)):
        seen = _dilated(seen, size_px - before, square=_SQUARES[number % len(_SQUARES)])
        np.copyto(result, seen, where=which == number)
    return result


def _dilated(values: NDArray[np.uint8], by: int, *, square: bool) -> NDArray[np.uint8]:
    """The greatest of values [H, W] and those `by` px beside, above and below; of corners, too."""
    greatest = values.copy()
    for axis in (0, 1):
        given, n = (greatest.copy() if square else values), values.shape[axis] - by
        if n > 0:
            for target, source in ((by, 0), (0, by)):
                at, of = [slice(None)] * 2, [slice(None)] * 2
                at[axis], of[axis] = slice(target, target + n), slice(source, source + n)
                part = greatest[tuple(at)]
                np.maximum(part, given[tuple(of)], out=part)
    return greatest


def needed(slots: Slots) -> NDArray[np.uint8]:
    """For each slot the least that must be seen for it to show: itself; of octaves their first."""
    first = [slots.first_of(octave) for octave in slots.octaves]
    return np.array([*range(slots.visible), *first], np.uint8)


# As in `compositing/sight.py`: the least share.
_MIN_FRACTION = 0.01


@compiled
def _area_below(areas, y, x):
    """The share of an opening above and left of a lens point, see `areas_below`."""
    most = areas.shape[0] - 1
    v, u = (y + 1) * most / 2, (x + 1) * most / 2
    v, u = min(max(v, 0.0), most - 1e-6), min(max(u, 0.0), most - 1e-6)
    i, j = np.int64(v), np.int64(u)
    f, g = v - i, u - j
    above = areas[i, j] * (1 - g) + areas[i, j + 1] * g
    return above * (1 - f) + (areas[i + 1, j] * (1 - g) + areas[i + 1, j + 1] * g) * f


@entry
def keep_in_frame(radius, areas, trust):
    """Multiply trust [H, W] by the share of the opening that sees a pixel's surface in the frame.

    Lens point u images the surface at pixel q to q + r u: pixel x sees the surface at x - r u.
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
            trust[y, x] *= np.float32(max(abs(share), _MIN_FRACTION))

"""Whether the depth of a picture needs no repair, and the range of its radii, by compiled loops.

The tests are those of `engine/survey.py`, `depth/diagnosis.py` and `depth/smoothing.py`, with the
same constants. Where a test is not certain, those modules decide.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from defocus_core.depth import diagnosis, ramps, smoothing
from defocus_core.renderer.compiled.jit import compiled, entry
from defocus_core.renderer.engine import limits

F32 = np.float32
# Light below this one counts as black.
_BLACK = 9.2e-41


class DepthLook(NamedTuple):
    """Statistics of signed radii, and whether the depth needs no repair."""

    range: tuple[float, float]  # least and greatest, px
    step: float  # px, greatest difference between neighbours
    usable: bool  # whether all radii may be rendered
    clean: bool  # whether the depth needs no repair, except perhaps of displaced edges
    hard: float  # px, the least step of an edge that may be displaced


@entry
def look_at_depth(radius, by):
    """The fields of `DepthLook`, in order, for radii [H, W] px.

    by: factor by which a large picture is reduced in the search for ramps, see
    `depth.ramps.reduction`.
    """
    height, width = radius.shape
    least, most, step, usable = F32(np.inf), F32(-np.inf), F32(0), True
    for y in range(height):
        for x in range(width):
            r = radius[y, x]
            least, most = min(least, r), max(most, r)
            usable &= abs(r) <= F32(limits.GREATEST_PX)
            if x:
                step = max(step, abs(r - radius[y, x - 1]))
            if y:
                step = max(step, abs(r - radius[y - 1, x]))
    within = min(ramps.WITHIN, ramps.WITHIN_FRACTION * min(height, width))
    small = min(ramps.WITHIN, ramps.WITHIN_FRACTION * min(height // by, width // by))
    steep = min(ramps.STEEP, max(ramps.MINIMUM, (most - least) / within))
    of_small = min(ramps.STEEP, max(ramps.MINIMUM, (most - least) / by / small))
    clean = usable and not _is_noisy(radius) and not _is_quantised(radius)
    clean = clean and (step <= ramps.MINIMUM or _has_no_ramps(radius, min(steep, of_small)))
    clean = clean and (step <= diagnosis.MATTERS / 6 or _are_no_averages(radius))
    return (least, most), step, usable, clean, ramps.HARD_STEP * steep


@entry
def look_at_light(image):
    """The least and greatest value [3, 2] of each channel of a picture, and whether it is plain.

    A plain picture is finite, has no highlights, and needs no more precision than float32.
    """
    channels, finite = np.empty((3, 2)), True
    for c in range(3):
        least, most = F32(np.inf), F32(-np.inf)
        for y in range(image.shape[1]):
            for x in range(image.shape[2]):
                v = image[c, y, x]
                least, most = min(least, v), max(most, v)
                finite &= abs(v) <= F32(limits.BRIGHTEST)
        channels[c, 0], channels[c, 1] = least, most
    return channels, finite and _is_plain(image, channels)


@compiled
def _is_plain(image, channels):
    """Whether a finite picture has no highlights and needs no more precision than float32.

    channels: [3, 2], least and greatest value of each channel.
    """
    brightest = max(channels[0, 1], max(channels[1, 1], channels[2, 1]))
    darkest = min(channels[0, 0], min(channels[1, 0], channels[2, 0]))
    size, limit = max(brightest, -darkest), max(brightest, 0.0)
    pixels = image.shape[1] * image.shape[2]
    if size > limits.SQUARED or 0 < size < 1 / limits.SQUARED:
        return False
    ordinary = black = dark = 0
    for y in range(image.shape[1]):
        for x in range(image.shape[2]):
            v = np.float64(max(max(image[0, y, x], image[1, y, x]), max(image[2, y, x], F32(0))))
            ordinary += v < limit / limits.BRIGHTER
            black += v < _BLACK
            dark += limits.RANGE * v < brightest
    if ordinary >= max(1, int(limits.ORDINARY * pixels)):
        return False
    return black == pixels or dark < black + (pixels - black + 1) // 2


@compiled
def _is_noisy(radius):
    """Whether radii [H, W] are noisy: neighbouring steps often have opposite signs."""
    height, width = radius.shape
    together = apart = noisy = 0
    for y in range(1, height - 1):
        for x in range(1, width - 1):
            for axis in range(2):
                dy, dx = (1, 0) if axis else (0, 1)
                before = radius[y, x] - radius[y - dy, x - dx]
                after = radius[y + dy, x + dx] - radius[y, x]
                if max(abs(before), abs(after)) > F32(smoothing.STEP):
                    apart += 1
                    continue
                together += 1
                noisy += before * after < 0 and abs(after - before) / 2 >= F32(smoothing.SCATTER)
    return (
        together > smoothing.TOGETHER * (apart + together) and noisy > smoothing.FRACTION * together
    )


@compiled
def _is_quantised(radius):
    """Whether radii may be quantised: most steps are 0 or small, and there are over 32 levels."""
    height, width = radius.shape
    for axis in range(2):
        dy, dx = (1, 0) if axis else (0, 1)
        same = minimum = small = 0
        count = (height - dy) * (width - dx)
        for y in range(height - dy):
            for x in range(width - dx):
                step = abs(radius[y + dy, x + dx] - radius[y, x])
                same += step <= 0
                minimum += step <= F32(smoothing.LEAST)
                small += step <= F32(smoothing.MOST)
        rest = count - same
        if same <= smoothing.ALIKE * count or small - same <= smoothing.SMALL * rest:
            return False
        if small - minimum <= smoothing.MATTERS * rest:
            return False
    levels, number = np.empty(smoothing.FEW + 1, np.float32), 0
    for y in range(height - 1):
        for x in range(width - 1):
            r = radius[y, x]
            if r != radius[y, x + 1] or r != radius[y + 1, x]:
                continue
            k = 0
            while k < number and levels[k] != r:
                k += 1
            if k == number:
                if number == smoothing.FEW:
                    return True
                levels[number] = r
                number += 1
    return False


@compiled
def _steepness(radius, y, x):
    """The slope of a ramp at pixel (y, x), see `depth/ramps.py`.

    Along an axis it is the smaller of two successive steps of the same sign, or 0 if their signs
    differ. The greater slope of both axes counts.
    """
    height, width = radius.shape
    slope = F32(0)
    if 0 < x < width - 1:
        a, b = radius[y, x] - radius[y, x - 1], radius[y, x + 1] - radius[y, x]
        slope = max(slope, max(min(a, b), -max(a, b)))
    if 0 < y < height - 1:
        a, b = radius[y, x] - radius[y - 1, x], radius[y + 1, x] - radius[y, x]
        slope = max(slope, max(min(a, b), -max(a, b)))
    return slope


@compiled
def _has_no_ramps(radius, steep):
    """Whether no ramp is several px wide and long, and steep pixels are far fewer than hard edges.

    steep: slope in px per px above which pixels belong to a ramp.
    """
    height, width = radius.shape
    few = hard = 0
    for y in range(height):
        for x in range(width):
            hard += _is_hard(radius[y, x : x + 4]) + _is_hard(radius[y : y + 4, x])
            slope = _steepness(radius, y, x)
            few += slope > ramps.STEEP
            if slope <= steep:
                continue
            for v in range(max(y - 1, 0), min(y + 2, height)):
                for u in range(max(x - 1, 0), min(x + 2, width)):
                    slope = min(slope, _steepness(radius, v, u))
            if slope > steep:
                return False
    return few == 0 or hard > diagnosis.RARE * few


@compiled
def _is_hard(values):
    """Whether the middle step of four values is a hard edge: large, with small steps beside it."""
    if len(values) < 4:
        return False
    step = abs(values[2] - values[1])
    beside = max(abs(values[1] - values[0]), abs(values[3] - values[2]))
    return step > F32(ramps.HARD_STEP * ramps.STEEP) and beside < F32(ramps.LEVEL) * step


@compiled
def _are_no_averages(radius):
    """Whether few pixels at depth edges have a radius between both surfaces, as if averaged."""
    height, width = radius.shape
    count, hard, values = 0, 0, np.empty(7, np.float32)
    for y in range(height):
        for x in range(width):
            for axis in range(2):
                dy, dx = (1, 0) if axis else (0, 1)
                y0, x0 = y - 3 * dy, x - 3 * dx
                if y0 < 0 or x0 < 0 or y0 + 6 * dy >= height or x0 + 6 * dx >= width:
                    continue
                if abs(radius[y0 + 6 * dy, x0 + 6 * dx] - radius[y0, x0]) <= F32(diagnosis.MATTERS):
                    continue
                for k in range(7):
                    values[k] = radius[y0 + k * dy, x0 + k * dx]
                count += _is_average(values)
                step = abs(values[4] - values[3])
                if step > F32(diagnosis.MATTERS):
                    beside = max(abs(values[3] - values[2]), abs(values[5] - values[4]))
                    hard += beside < F32(diagnosis.FLAT) * step
    return count <= max(diagnosis.FEWEST, diagnosis.EACH * hard)


@compiled
def _is_average(values):
    """Whether the middle one of seven values lies on a narrow edge, between its two surfaces."""
    near, far = values[3], values[3]
    within = size = whole = least = F32(0)
    for k in range(1, 4):
        near = min(near, min(values[3 - k], values[3 + k]))
        far = max(far, max(values[3 - k], values[3 + k]))
        whole = far - near
        if k == 1:
            within = whole
        if k == 2:
            size, least = whole, near
    level = F32(diagnosis.FLAT) * whole
    rising = falling = True
    for k in range(1, 5):
        rising &= values[k + 1] - values[k] >= -level
        falling &= values[k + 1] - values[k] <= level
    place = (values[3] - least) / (size if size > 0 else F32(1))
    ends = min(abs(values[1] - values[0]), abs(values[6] - values[5]))
    on_edge = (
        (rising or falling) and ends < level and diagnosis.AVERAGE < place < 1 - diagnosis.AVERAGE
    )
    return on_edge and within > F32(diagnosis.ABRUPT) * whole

"""FLIP: what a person sees who flips between two pictures (Andersson et al. 2020 and 2021).

A picture of light beyond 1 is looked at through exposures, tone-mapped as by ACES; the greatest
error of a pixel counts. All filters are separable: a tile goes through one as a product of
matrices, and tiles that are equal, as most are where both are white, are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.metrics import LUMINANCE
from defocus_core.compare.pixels import Pixels
from defocus_core.io.images.color_space import srgb_to_linear

_PIXELS_A_DEGREE = 67.0206  # a screen of 3840 px that is 0.7 m wide, at 0.7 m
_COLOR, _FEATURE = 0.7, 0.5  # exponents of differences of color and of features
_KNEE = (0.4, 0.95)  # of differences of color: share of the greatest one, and what it becomes
_FEATURE_WIDTH = 0.082  # degrees
# Contrast sensitivity of achromatic, red-green and blue-yellow: weights and widths of gaussians.
_SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))
_ACES = (0.9036, 0.018, 0.8748, 0.354, 0.14)  # (a x² + b x) / (c x² + d x + e)
_WHITE = 0.85  # of the curve of ACES: the first exposure shows the brightest light so, the last
# the median
_BLACK = 1e-6  # a luminance that is as good as 0
_TILE = 64  # px
_LARGEST = 1e30  # light that is looked at
_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], LUMINANCE, [0.0193339, 0.1191920, 0.9503041]], np.float64
)
_TO_XYZ = (_XYZ / _XYZ.sum(axis=1, keepdims=True)).astype(np.float32)  # white is 1, 1, 1
_TO_RGB = np.linalg.inv(_TO_XYZ.astype(np.float64)).astype(np.float32)
_EDGE = 6 / 29  # of CIE L*a*b*
_Planes = NDArray[np.float32]


def measure_flip(pixels: Pixels) -> dict[str, float]:
    """Mean and maximum of FLIP over the compared, finite pixels; none without colour."""
    means, greatest = [], []
    for layer in pixels.color:
        errors = flip(*(_light(pixels, side, layer) for side in ("a", "b")))
        errors = errors if pixels.finite is None else errors[pixels.finite]
        if not errors.size:
            return {}
        means.append(float(errors.mean(dtype=np.float64)))
        greatest.append(float(errors.max()))
    return {"flip": max(means), "flip-max": max(greatest)} if means else {}


def _light(pixels: Pixels, side: str, layer: Sequence[str]) -> NDArray[np.float32]:
    """Linear light [3, H, W], 0 where a pixel is not finite or negative."""
    values = np.stack([pixels.plane(side, name) for name in layer]).astype(np.float32)
    values = values.repeat(3 // len(values), axis=0).clip(0.0, _LARGEST)
    if pixels.finite is not None:
        values[:, ~pixels.finite] = 0.0
    if pixels.gamma is None:
        values = srgb_to_linear(values).astype(np.float32)
    return values if pixels.gamma in (None, 1.0) else values ** np.float32(pixels.gamma)


def flip(a: _Planes, b: _Planes) -> _Planes:
    """The error, 0…1, of each pixel [H, W] of linear light [3, H, W] that is not negative.

    Light of up to 1 is what a screen shows; exposures of brighter light follow the luminance of A.
    """
    gains: list[float | None] = [None]
    if max(float(a.max()), float(b.max())) > 1.0:
        luminance = np.tensordot(np.array(LUMINANCE, np.float32), a, 1)
        lit = luminance[luminance > _BLACK]
        high = max(float(luminance.max()), _BLACK)
        x2, x1, y2, y1, y0 = _ACES
        square, slope, rest = x2 - _WHITE * y2, x1 - _WHITE * y1, -_WHITE * y0
        white = (math.sqrt(slope * slope - 4 * square * rest) - slope) / (2 * square)
        # The median of what is not black: exposures are chosen for what can be seen.
        ends = white / high, white / (float(np.median(lit)) if lit.size else high)
        gains = [*np.geomspace(*ends, max(2, math.ceil(math.log2(ends[1] / ends[0]))))]
    reach = _filters()[0].size // 2
    size = (a.shape[1], a.shape[2])
    errors = np.zeros(size, np.float32)
    for top, left in product(*(range(0, length, _TILE) for length in size)):
        here = (slice(top, top + _TILE), slice(left, left + _TILE))
        rows, columns = (
            np.arange(cut.start - reach, min(cut.stop, length) + reach).clip(0, length - 1)
            for cut, length in zip(here, size, strict=True)
        )
        sides = np.stack([side[:, rows[:, None], columns] for side in (a, b)])
        for gain in gains if (sides[0] != sides[1]).any() else ():
            shown = sides if gain is None else _tone_mapped(sides * np.float32(gain))
            if gain is None or (shown[0] != shown[1]).any():
                np.maximum(errors[here], _of_tile(shown), out=errors[here])
    return errors


def _tone_mapped(light: NDArray[np.float32]) -> NDArray[np.float32]:
    x2, x1, y2, y1, y0 = map(np.float32, _ACES)
    light = np.minimum(light, np.float32(1e6))  # which is white
    shown = light * (x2 * light + x1) / (light * (y2 * light + y1) + y0)
    return np.minimum(shown, np.float32(1))


def _of_tile(sides: NDArray[np.float32]) -> _Planes:
    """The error [h, w] of what a screen shows of A and B, linear, [2, 3, h, w] with margins."""
    size = sides.shape[2:]
    x, y, z = np.moveaxis((_TO_XYZ @ sides.reshape(2, 3, -1)).reshape(sides.shape), 1, 0)
    # Luminance, red-green and blue-yellow.
    (light, *features), (red,), (blue, second) = (
        _filtered(plane, names, size)
        for plane, names in ((y, _LUMINANCE), (x - y, _RED), (y - z, _BLUE))
    )
    seen = np.stack([light + red, light, light - blue - second], axis=1)
    colors = (_TO_RGB @ seen.reshape(2, 3, -1)).clip(0, 1)
    lab = _lab(_TO_XYZ @ colors).reshape(seen.shape)
    error = _distance(lab[0] - lab[1])
    low = np.float32(_KNEE[0] * _greatest())
    slopes = _KNEE[1] / low, (1 - _KNEE[1]) / (np.float32(_greatest()) - low)
    error = np.where(error < low, error * slopes[0], _KNEE[1] + (error - low) * slopes[1])
    edges, points = (_length(*features[k : k + 2]) for k in (0, 2))
    unlike = np.maximum(*(np.abs(each[0] - each[1]) for each in (edges, points)))
    result: _Planes = error ** (1 - np.sqrt(unlike * np.float32(math.sqrt(0.5))))
    return result


# Pairs of filters, across and down, by their places in `_filters`.
_LUMINANCE, _RED, _BLUE = ((0, 0), (5, 4), (4, 5), (6, 4), (4, 6)), ((1, 1),), ((2, 2), (3, 3))


def _filtered(
    plane: NDArray[np.float32], pairs: tuple[tuple[int, int], ...], size: tuple[int, ...]
) -> list[NDArray[np.float32]]:
    """A plane [2, h, w] through pairs of filters, without its margins."""
    (_, down), (across, _) = (_matrices(n) for n in size)
    known = {k: plane @ across[k] for k in dict.fromkeys(k for k, _ in pairs)}
    return [down[j] @ known[k] for k, j in pairs]


@cache
def _filters() -> tuple[NDArray[np.float64], ...]:
    """Weights along a line: of sensitivity (4), and a gaussian and both its derivatives."""
    widest = max(wide for gaussians in _SENSITIVITY for _, wide in gaussians)
    reach = math.ceil(3 * math.sqrt(widest / 2) / math.pi * _PIXELS_A_DEGREE)
    far = np.arange(-reach, reach + 1)
    weights = []
    for gaussians in _SENSITIVITY:
        each = [
            math.sqrt(a * math.sqrt(math.pi / b))
            * np.exp(-((math.pi * far / _PIXELS_A_DEGREE) ** 2) / b)
            for a, b in gaussians
        ]
        total = math.sqrt(sum(g.sum() ** 2 for g in each))
        weights += [g / total for g in each]
    sigma = 0.5 * _FEATURE_WIDTH * _PIXELS_A_DEGREE
    gaussian = np.exp(-(far**2) / (2 * sigma**2)) * (np.abs(far) <= math.ceil(3 * sigma))
    for shape in (1.0 + 0 * far, -1.0 * far, far**2 / sigma**2 - 1):
        each = shape * gaussian
        sums = [each[each > 0].sum(), -each[each < 0].sum() or 1.0]
        weights.append(np.where(each > 0, each / sums[0], each / sums[1]))
    return tuple(weights)


@cache
def _matrices(size: int) -> tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]]:
    """The filters as matrices from a line with its margins to the line, for rows and columns."""
    made = []
    for weights in _filters():
        matrix = np.zeros((size - len(weights) + 1, size), np.float32)
        for k, weight in enumerate(weights):
            matrix[np.arange(len(matrix)), np.arange(len(matrix)) + k] = weight
        made.append(matrix)
    return [np.ascontiguousarray(matrix.T) for matrix in made], made


def _lab(xyz: NDArray[Any]) -> NDArray[Any]:
    """CIE L*a*b* of light [..., 3, N] whose white is 1, saturated as Hunt (1952) found."""
    low = xyz * (1 / (3 * _EDGE**2)) + 4 / 29
    x, y, z = np.moveaxis(np.where(xyz > _EDGE**3, np.cbrt(xyz), low), -2, 0)
    lightness = 116 * y - 16
    hunt = lightness * 0.01
    return np.stack([lightness, 500 * (x - y) * hunt, 200 * (y - z) * hunt], axis=-2)


def _distance(apart: NDArray[Any]) -> NDArray[Any]:
    """The difference of colors [3, ...] of `_lab`, by Abasi et al. (2020), to a power."""
    return np.asarray((np.abs(apart[0]) + _length(apart[1], apart[2])) ** _COLOR)


def _length(x: NDArray[Any], y: NDArray[Any]) -> NDArray[Any]:
    return np.asarray(np.sqrt(x * x + y * y))  # many times as fast as numpy.hypot


@cache
def _greatest() -> float:
    """The greatest difference of colors: of green and blue."""
    green, blue = (_lab(_TO_XYZ[:, k : k + 1]) for k in (1, 2))
    return float(_distance(green - blue)[0])

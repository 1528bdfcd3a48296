"""The picture in false colour, near, sharp and far, with the histogram of its radii."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.arrays import LazyArray, bands
from defocus_core.io.images.color_space import linear_to_srgb, srgb_to_linear
from defocus_core.picture.preview import diverging, largest

_SHARP_PX = 1.0  # radius up to which a pixel counts as sharp
_SHARP = (0.25, 0.80, 0.35)  # sRGB
_DARKEST = 0.35  # brightness of a black pixel, so that its colour shows
_BINS = 48
_DIVISORS = (5, 3)  # of the height and the width of the picture, for those of the histogram
_MINIMUM = (40, 96)  # px of its height and width, less in pictures that have no room
_BEHIND = 0.12  # brightness behind it


def focus_planes(light: Sequence[Any], radius: Any) -> tuple[Any, ...]:
    """The red, green and blue planes [H, W], linear light, computed a few rows at a time.

    `light`: of each colour [H, W], linear; `radius`: signed CoC radius in px, [H, W].
    """
    maximum = max(largest(radius[rows]) for rows in bands(radius.shape))
    inset = _histogram(radius, maximum)
    height, width = inset.shape[:2]
    top = radius.shape[0] - height

    def read(channel: int, rows: slice) -> NDArray[Any]:
        colors = [plane[rows].astype("float32") for plane in light]
        grey = np.mean(colors, axis=0, dtype="float32")
        brightness = linear_to_srgb(np.clip(grey, 0, 1))
        hue = _hues(radius[rows], maximum)[..., channel]
        shown = hue * (_DARKEST + (1 - _DARKEST) * brightness)
        first, last, _ = rows.indices(radius.shape[0])
        if last > top:
            begin = max(first, top)
            shown[begin - first :, :width] = inset[begin - top : last - top, :, channel]
        linear: NDArray[Any] = srgb_to_linear(shown).astype("float32")
        return linear

    dtype = np.dtype(np.float32)
    return tuple(LazyArray(radius.shape, dtype, partial(read, channel)) for channel in range(3))


def _hues(radius: NDArray[Any], maximum: float) -> NDArray[Any]:
    """Colours [..., 3], sRGB, of signed radii [h, w]."""
    sharp = np.abs(radius) <= _SHARP_PX
    hues: NDArray[Any] = diverging(radius, maximum / 2)
    hues[sharp] = _SHARP
    return hues


def _histogram(radius: Any, maximum: float) -> NDArray[Any]:
    """Bars of how many pixels have a radius, from the least to the greatest, sRGB [h, w, 3]."""
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    strips = [radius[rows] for rows in bands(radius.shape)]
    limits = min(float(s.min()) for s in strips), max(float(s.max()) for s in strips)
    minimum = 2 * _BINS * float(np.spacing(np.float32(max(map(abs, limits)))))  # two numbers a bin
    width_px = max(limits[1] - limits[0], 1e-6, minimum)
    of_strips = [np.histogram(s, _BINS, (limits[0], limits[0] + width_px))[0] for s in strips]
    counts = np.sum(of_strips, axis=0)
    height, width = (
        min(max(length // divisor, minimum), length)
        for length, divisor, minimum in zip(radius.shape, _DIVISORS, _MINIMUM, strict=True)
    )
    letters = max(8, height // 7)
    room = max(height - letters - 6, 1)
    bars = np.sqrt(counts / max(counts.max(), 1))  # few pixels show, too
    column = np.arange(width) * _BINS // width
    middles = (limits[0] + (np.arange(_BINS) + 0.5) * width_px / _BINS).astype("float32")
    colors = _hues(middles[None], maximum)[0][column]
    high = np.arange(height)[:, None] >= room - np.rint(bars[column] * (room - 2))
    inside = high & (np.arange(height)[:, None] < room)
    inset = np.where(inside[..., None], colors, np.float32(_BEHIND)).astype("float32")
    buffer = oiio.ImageBuf(np.ascontiguousarray(inset))
    words = f"{limits[0]:.1f} to {limits[1]:.1f} px"
    oiio.ImageBufAlgo.render_text(buffer, 4, height - 4, words, letters, "", (0.9, 0.9, 0.9))
    return np.asarray(buffer.get_pixels(oiio.FLOAT))

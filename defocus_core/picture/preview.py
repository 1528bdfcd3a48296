"""Previews: 8-bit PNG files to look at, and the picture in false colour; not for measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.arrays import computed
from defocus_core.io.images.color_space import linear_to_srgb, quantised, srgb_to_linear
from defocus_core.io.images.encode import display_encoded, srgb_matrix, write_samples
from defocus_core.io.images.raster import PLAIN_CHANNELS

# sRGB; orange and blue differ for all common kinds of colour vision.
NEAR = (0.85, 0.37, 0.01)
IN_FOCUS = (1.0, 1.0, 1.0)
FAR = (0.10, 0.35, 0.70)


def write_preview(path: Path, pixels: Any, attributes: Mapping[str, object] | None = None) -> None:
    """Write a picture over black as 8-bit sRGB PNG; `attributes` may name its primaries.

    `pixels` [H, W, C] is linear, premultiplied Y, YA, RGB or RGBA.
    """
    channels = PLAIN_CHANNELS[pixels.shape[2]]
    to_srgb = srgb_matrix(path, channels, attributes or {})
    encode = partial(display_encoded, channels=channels, bits=8, keep_alpha=False, to_srgb=to_srgb)
    write_samples(path, computed(lambda rows: encode(rows)[0], pixels), "png", {})


def write_depth_preview(path: Path, metres: Any) -> None:
    """Write depth [H, W] in metres as grey disparity: infinity black, the nearest pixel white."""
    nearest = float(np.min(metres))
    nearest = nearest if np.isfinite(nearest) else 1.0
    write_preview(path, (nearest / metres)[:, :, None])


def write_signed_preview(path: Path, radius: Any) -> None:
    """Write a signed map [H, W] in colour: negative orange, 0 white, positive blue.

    The colours are saturated at the largest magnitude.
    """
    maximum = largest(radius)
    encoded = computed(lambda rows: quantised(diverging(rows, maximum), 8), radius)
    write_samples(path, encoded, "png", {})


def largest(values: NDArray[Any]) -> float:
    """The largest magnitude of the finite values; 0 if there are none."""
    size = np.abs(values)
    return float(np.max(size, where=np.isfinite(size), initial=0.0))


def diverging(radius: NDArray[np.float32], full: float) -> NDArray[np.float32]:
    """Map signed radii [H, W] to sRGB colours [H, W, 3], 0 to 1: near orange, 0 white, far blue.

    Colours are saturated from the magnitude `full` on.
    """
    amount: NDArray[np.float32] = np.minimum(np.abs(radius) / np.float32(full or 1.0), 1.0)
    amount = amount[:, :, None]
    white, near, far = (np.array(c, np.float32) for c in (IN_FOCUS, NEAR, FAR))
    hue: NDArray[np.float32] = np.where((radius < 0)[:, :, None], near, far)
    return white + amount * (hue - white)


_SHARP_PX = 1.0  # radius up to which a pixel counts as sharp
_SHARP = (0.25, 0.80, 0.35)  # sRGB
_DARKEST = 0.35  # brightness of a black pixel, so that its colour shows


def focus_planes(light: Sequence[Any], radius: Any) -> tuple[Any, ...]:
    """The picture in false colour, as linear red, green and blue planes [H, W].

    Pixels are green if sharp, orange if nearer and blue if farther, by signed `radius` [H, W] px;
    their brightness is the mean of the linear planes `light`.
    """
    maximum = largest(radius)

    def shown(px: NDArray[Any], *colors: NDArray[Any]) -> NDArray[Any]:
        grey = np.mean([c.astype("float32") for c in colors], axis=0, dtype="float32")
        brightness = linear_to_srgb(np.clip(grey, 0, 1))
        hues = diverging(px, maximum / 2)
        hues[np.abs(px) <= _SHARP_PX] = _SHARP
        shades = hues * (_DARKEST + (1 - _DARKEST) * brightness)[:, :, None]
        linear: NDArray[Any] = srgb_to_linear(shades).astype("float32")
        return linear

    return tuple(np.moveaxis(computed(shown, radius, *light), 2, 0))

"""Thumbnails: small 8-bit pictures of light, maps and differences, encoded in memory."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.images.color_space import linear_to_srgb, quantised, srgb_to_linear
from defocus_core.io.images.encode import encode
from defocus_core.picture.preview import FAR, IN_FOCUS, NEAR, largest
from defocus_core.reports.html.item import LIGHT, SHARE, SIGNED

SIDE = 320  # px of the longer side
_QUALITY = 75  # of a JPEG
# Colours of a difference from 0 to full, in sRGB, in even steps of lightness.
HEATS = (
    *((0.00, 0.00, 0.02), (0.26, 0.04, 0.41), (0.58, 0.15, 0.40), (0.87, 0.32, 0.23)),
    *((0.99, 0.65, 0.04), (0.99, 1.00, 0.64)),
)
NONFINITE = (1.0, 0.0, 1.0)  # magenta
SIGNED_COLORS = (NEAR, IN_FOCUS, FAR)


def of_light(planes: Sequence[NDArray[Any]], gamma: float | None) -> bytes:
    """A JPEG of one or three channels [H, W] in sRGB; NaN and Inf are magenta.

    `gamma`: the encoding of the values: 1 for linear light, None for sRGB, else a power.
    """
    small = [_reduced(_light(plane, gamma)[:, :, None]) for plane in planes]
    values = np.concatenate(small * (3 // len(small)), axis=2)
    bad = ~np.isfinite(values).all(axis=2)
    shown = linear_to_srgb(values)
    shown[bad] = NONFINITE
    return _jpeg(quantised(shown, 8))


def _light(plane: NDArray[Any], gamma: float | None) -> NDArray[np.float32]:
    """Linear light of a channel."""
    with np.errstate(over="ignore"):
        values = np.asarray(plane, np.float32)
    if gamma == 1.0:
        return values
    decoded = srgb_to_linear(values) if gamma is None else np.maximum(values, 0) ** gamma
    return decoded.astype(np.float32)


def of_map(plane: NDArray[Any], value_range: tuple[float, float]) -> bytes:
    """A PNG of a map [H, W], grey from its least to its greatest value."""
    low, high = value_range
    with np.errstate(all="ignore"):  # NaN, infinity, numbers beyond single precision
        share = (np.asarray(plane, np.float64) - low) / ((high - low) or 1.0)
        values = _reduced(share.astype(np.float32)[:, :, None])
    return encoded(quantised(values, 8), "png")


def of_difference(greatest: NDArray[Any], full: float) -> bytes:
    """A JPEG of the worst difference in each block, in heat colours; NaN and Inf are magenta.

    `full`: the difference drawn in the hottest colour.
    """
    with np.errstate(all="ignore"):
        share = (np.asarray(greatest, np.float64) / full).astype(np.float32)
    worst, block = share, _block(share.shape)
    for axis in (0, 1):
        worst = np.maximum.reduceat(worst, range(0, share.shape[axis], block), axis=axis)
    amount = np.clip(np.nan_to_num(worst, nan=0.0, posinf=0.0), 0.0, 1.0)
    places = np.linspace(0, 1, len(HEATS))
    columns = [np.interp(amount, places, [color[k] for color in HEATS]) for k in range(3)]
    shown = np.stack(columns, axis=2).astype(np.float32)
    shown[~np.isfinite(worst)] = NONFINITE
    return _jpeg(quantised(shown, 8))


def ends_of(plane: NDArray[Any], kind: str) -> tuple[float, float]:
    """The values shown as black and as white in the thumbnail of a map."""
    if kind in (LIGHT, SHARE):
        return 0.0, 1.0
    if kind == SIGNED:
        maximum = largest(np.asarray(plane, np.float32)) or 1.0
        return -maximum, maximum
    finite = plane[np.isfinite(plane)]
    if not finite.size:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    return (low, high) if high > low else (low, low + 1.0)


def _block(shape: tuple[int, ...]) -> int:
    """The side in px of blocks that become a pixel, so that a thumbnail is at most `SIDE` wide."""
    return -(-max(shape[:2]) // SIDE)


def _reduced(values: NDArray[Any]) -> NDArray[np.float32]:
    """Means [h, w, C] of blocks of values [H, W, C]."""
    height, width = (-(-n // _block(values.shape)) for n in values.shape[:2])
    return resized(values, (height, width))


def resized(pixels: NDArray[Any], size: tuple[int, int]) -> NDArray[np.float32]:
    """Pixels [H, W, C] resized to (height, width) by mean light."""
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    buffer = oiio.ImageBuf(np.ascontiguousarray(pixels, np.float32))
    roi = oiio.ROI(0, size[1], 0, size[0], 0, 1, 0, pixels.shape[2])
    found = oiio.ImageBufAlgo.resize(buffer, roi=roi, filtername="box").get_pixels(oiio.FLOAT)
    return np.asarray(found, np.float32).reshape(*size, pixels.shape[2])


def _jpeg(samples: NDArray[np.uint8]) -> bytes:
    return encoded(samples, "jpeg", {"Compression": f"jpeg:{_QUALITY}"})


def encoded(samples: NDArray[Any], codec: str, settings: dict[str, Any] | None = None) -> bytes:
    """The bytes of an image file with samples [H, W, C]."""
    with tempfile.TemporaryFile() as file:
        encode(Path(f"thumbnail.{codec}"), file, samples, codec, settings or {})
        return file.read()

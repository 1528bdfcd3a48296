"""FLIP of a pair (Andersson et al. 2020 and 2021), computed by OpenImageIO.

FLIP predicts what a person sees who flips between A and B. The range of exposures of HDR-FLIP comes
from the luminance of A: with OpenImageIO's own range, an error in light beyond 2 is not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.pixels import Pixels
from defocus_core.errors import UsageProblem
from defocus_core.io.images.color_space import srgb_to_linear
from defocus_core.io.safe_files import quiet

_LUMINANCE = (0.2126, 0.7152, 0.0722)
_BLACK = 1e-6  # a luminance that is as good as 0


def measure_flip(pixels: Pixels) -> dict[str, float]:
    """Mean and maximum of FLIP over the compared, finite pixels; none without colour."""
    means, greatest = [], []
    for layer in pixels.color:
        a, b = (_light(pixels, side, layer) for side in ("a", "b"))
        errors = _flip(a, b)
        if pixels.finite is not None:
            errors = errors[pixels.finite]
        if not errors.size:
            return {}
        if not np.isfinite(errors).all():
            raise UsageProblem(
                "not-numbers", "is not a number for these pixels", "leave it out", field="flip"
            )
        means.append(float(errors.mean(dtype=np.float64)))
        greatest.append(float(errors.max()))
    return {"flip": max(means), "flip-max": max(greatest)} if means else {}


def _light(pixels: Pixels, side: str, layer: Sequence[str]) -> NDArray[np.float32]:
    """Linear light [H, W, 3], 0 where a pixel is not finite or negative."""
    values = np.stack([pixels.plane(side, name) for name in layer], axis=2).astype(np.float32)
    values = values.repeat(3 // values.shape[2], axis=2)
    if pixels.finite is not None:
        values[~pixels.finite] = 0.0
    values = np.maximum(values, 0.0)
    if pixels.gamma is None:
        values = srgb_to_linear(values).astype(np.float32)
    return values if pixels.gamma in (None, 1.0) else values ** np.float32(pixels.gamma)


def _flip(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    if not hasattr(oiio.ImageBufAlgo, "FLIP_diff"):
        raise UsageProblem(
            "needs-extra", "needs OpenImageIO 3.2", "leave it out, or install that", field="flip"
        )
    luminance = (a * np.asarray(_LUMINANCE, np.float32)).sum(axis=2)
    hdr = int(max(float(a.max()), float(b.max())) > 1.0)
    maximum = max(float(luminance.max()), _BLACK)
    # The median of what is not black: exposures are chosen for what can be seen.
    lit = luminance[luminance > _BLACK]
    middle = float(np.median(lit)) if lit.size else maximum
    with quiet():
        errors = oiio.ImageBufAlgo.FLIP_diff(_buffer(a), _buffer(b), hdr, maximum, middle)
        if errors.has_error:
            raise UsageProblem(
                "not-numbers", f"failed: {errors.geterror()}", "leave it out", field="flip"
            )
        values: Any = errors.get_pixels(oiio.FLOAT)
    flip: NDArray[np.float32] = values[:, :, 0]
    return flip


def _buffer(pixels: NDArray[np.float32]) -> Any:
    import OpenImageIO as oiio  # noqa: N813

    height, width, channels = pixels.shape
    buffer = oiio.ImageBuf(oiio.ImageSpec(width, height, channels, oiio.FLOAT))
    buffer.set_pixels(oiio.ROI(), np.ascontiguousarray(pixels))
    return buffer

"""Luminance and chroma of OpenEXR files, of which chroma may have fewer samples than pixels.

RY = (R - Y) / Y and BY = (B - Y) / Y at every other pixel; Y = wr R + wg G + wb B with the weights
of the primaries (OpenEXR, "Technical Introduction", Luminance/Chroma Images). Between samples,
chroma is interpolated by cubics (Catmull, Rom 1974).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.exr.header import Header
from defocus_core.io.exr.windows import Overscan
from defocus_core.io.images.primaries import declared_primaries, xyz_of_primaries
from defocus_core.system.interrupts import delayed_signals

if TYPE_CHECKING:
    Wanted = Callable[[Header, str], bool]

CHROMA = ("RY", "BY")


def is_chroma(name: str) -> bool:
    """Whether a channel is chroma by its name."""
    return name.rpartition(".")[2] in CHROMA


def planes_of(
    path: Path, headers: Sequence[Header], wanted: Wanted, overscan: Overscan
) -> list[dict[str, NDArray[Any]]]:
    """The channels of each part in the frame; of those of fewer samples, chroma is interpolated."""
    with delayed_signals():
        import OpenEXR

    decoded = OpenEXR.File(str(path), separate_channels=True).parts
    if len(decoded) != len(headers):
        raise ValueError("a part is missing")
    every = []
    for header, part in zip(headers, decoded, strict=True):
        samples = part.channels
        every.append(
            {
                channel.name: _in_frame(
                    _interpolate(samples[channel.name].pixels, channel.sampling, header),
                    header,
                    overscan,
                )
                for channel in header.channels
                if wanted(header, channel.name)
                and not header.deep
                and (not channel.subsampled or is_chroma(channel.name))
            }
        )
    return every


def rgb_of(
    luminance: NDArray[Any], chroma: Sequence[NDArray[Any]], weights: Sequence[float]
) -> list[NDArray[np.float32]]:
    """R, G and B of Y and of RY and BY, all [H, W]."""
    y = np.asarray(luminance, np.float32)
    red_weight, green_weight, blue_weight = (np.float32(weight) for weight in weights)
    with np.errstate(over="ignore", invalid="ignore"):  # who uses the pixels refuses such numbers
        red, blue = (y * (1 + np.asarray(each, np.float32)) for each in chroma)
        green = (y - red_weight * red - blue_weight * blue) / green_weight
    return [red, green.astype(np.float32), blue]


def weights_of(header: Header, path: Path) -> tuple[float, ...]:
    """How much R, G and B are in the luminance of a part, by its primaries; they add up to 1."""
    try:
        weights = xyz_of_primaries(declared_primaries(header.attributes))[1]
    except ValueError as error:
        problem = f"has primaries that span no colours: {error}"
        remedy = "write its chromaticities anew"
        raise InputError("damaged", problem, remedy, path=path) from error
    if not abs(weights[1]) > 1e-6:
        problem, remedy = "has a green primary without brightness", "write it as R, G and B"
        raise InputError("unsupported", problem, remedy, path=path)
    return tuple(weights.tolist())


def _interpolate(samples: NDArray[Any], sampling: tuple[int, int], header: Header) -> NDArray[Any]:
    """Samples [h, w] of a data window, one for each of its pixels."""
    if sampling == (1, 1):
        return samples
    across, down = sampling
    values = np.asarray(samples, np.float32)
    values = _along(values, 0, np.arange(header.data.height) / down)
    return _along(values, 1, np.arange(header.data.width) / across)


def _along(values: NDArray[np.float32], axis: int, at: NDArray[np.float64]) -> NDArray[np.float32]:
    """Values at positions along an axis, cubic between samples; at the ends they are continued."""
    first = np.floor(at).astype(int)
    t = at - first
    weights = (
        ((2 - t) * t - 1) * t / 2,
        ((3 * t - 5) * t * t + 2) / 2,
        ((4 - 3 * t) * t + 1) * t / 2,
        (t - 1) * t * t / 2,
    )
    total = np.float32(0)
    shape = (-1, 1) if axis == 0 else (1, -1)
    for offset, weight in zip((-1, 0, 1, 2), weights, strict=True):
        index = np.clip(first + offset, 0, values.shape[axis] - 1)
        with np.errstate(over="ignore", invalid="ignore"):
            total = total + weight.reshape(shape).astype(np.float32) * values.take(index, axis)
    return np.asarray(total, np.float32)


def _in_frame(values: NDArray[Any], header: Header, overscan: Overscan) -> NDArray[Any]:
    """Values of the data window where they lie in the frame; 0 elsewhere."""
    window = header.display.grown(overscan)
    whole = np.zeros((window.height, window.width), values.dtype)
    whole[window.cut(header.data)] = values[header.data.cut(window)]
    return whole

"""Metrics of a pair, in the stored values or in linear light, and as a screen shows it.

PSNR and SSIM look at sRGB-encoded values, clipped to 0…1, of the colour channels. The other metrics
look at all channels, in the values of the file: linear light in an EXR, 0…1 in a file of integers.
Pixels that are NaN or infinite in A or B are left out here, since they are judged apart.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.pixels import Pixels
from defocus_core.evaluation.similarity import REACH, similarity
from defocus_core.io.images.color_space import linear_to_srgb


@dataclass(frozen=True)
class Metric:
    """A number of a pair.

    Attributes:
        name: as ``--fail`` has it.
        help: what it is, for help and reports.
        unit: of the number; empty for a number without one.
        better: ``low`` or ``high``.
        color: whether only pictures with colour have it.
    """

    name: str
    help: str
    unit: str = ""
    better: str = "low"
    color: bool = False


_ROWS = (
    Metric("max", "greatest difference of a channel"),
    Metric("mean", "mean absolute difference"),
    Metric("rmse", "root of the mean squared difference"),
    Metric("rel-rmse", "RMSE over the mean absolute value of A"),
    Metric("psnr", "of sRGB-encoded colour, 99 if equal", "dB", "high", color=True),
    Metric(
        "ssim", "structural similarity of sRGB-encoded luma, 1 if equal", "", "high", color=True
    ),
    Metric("p99.9", "99.9th percentile of the greatest differences of the pixels"),
    Metric("share", "share of pixels with a difference of more than ‹over›"),
    Metric("flip", "mean of FLIP, with ‹flip›", "", color=True),
    Metric("flip-max", "greatest FLIP of a pixel, with ‹flip›", "", color=True),
    *(
        Metric(f"{place}-{name}", f"{name} {words} depth edges, with ‹coc›", unit, better)
        for place, words in (("edges", "near"), ("elsewhere", "away from"))
        for name, unit, better in (
            *(("max", "", "low"), ("mean", "", "low"), ("rmse", "", "low")),
            ("psnr", "dB", "high"),
        )
    ),
)
METRICS = {metric.name: metric for metric in _ROWS}
# PSNR in dB of equal pictures, as of `defocus_core`: a mean squared error below 1e-10.
EQUAL = 99.0
_LUMA = {"R": 0.2126, "G": 0.7152, "B": 0.0722, "Y": 1.0}
_STRIP = 64  # rows of SSIM that are computed at once, so that they stay in the cache


def encoded(plane: NDArray[Any], gamma: float | None) -> NDArray[np.float32]:
    """Values as a screen shows them: sRGB-encoded, clipped to 0…1; NaN is 0."""
    if plane.dtype == np.float16 and gamma == 1.0:  # a hundred times as fast for 16 bits
        codes = np.ascontiguousarray(plane).view(np.uint16)
        every = np.arange(2**16, dtype=np.uint16).view(np.float16).astype(np.float32)
        return encoded(every, gamma)[codes]
    values = np.clip(np.nan_to_num(np.asarray(plane, np.float32), nan=0.0), 0.0, 1.0)
    if gamma is None:
        return values
    return linear_to_srgb(values if gamma == 1.0 else values ** np.float32(gamma))


def measure(pixels: Pixels, *, over: float, ssim: bool = True) -> dict[str, float]:
    """The metrics of a pair by name, FLIP aside; those that it has not are left out.

    Args:
        pixels: the pair.
        over: the difference that the metric ``share`` counts pixels beyond.
        ssim: whether SSIM is wanted.
    """
    count = np.count_nonzero(pixels.finite) if pixels.finite is not None else pixels.a[0].size
    if not count:
        return {}
    total, channels = int(count), len(pixels.names)
    squares = sum(float(np.square(each).sum()) for each in pixels.differences)
    rmse = math.sqrt(squares / (total * channels))
    level = sum(_sum_of_magnitudes(plane, pixels.finite) for plane in pixels.a) / (total * channels)
    greatest = pixels.greatest
    metrics = {
        "max": float(greatest.max()),
        "mean": sum(float(np.abs(d).sum()) for d in pixels.differences) / (total * channels),
        "rmse": rmse,
    }
    if level > 0:
        metrics["rel-rmse"] = rmse / level
    shown = [_shown(pixels, layer) for layer in pixels.color]
    if shown:
        metrics["psnr"] = min(_decibels(a, b, pixels.finite, total) for a, b in shown)
    if shown and ssim and min(pixels.shape) > 2 * REACH:
        values = [
            _ssim(_luma(a, layer), _luma(b, layer), pixels.finite)
            for (a, b), layer in zip(shown, pixels.color, strict=True)
        ]
        if None not in values:
            metrics["ssim"] = min(value for value in values if value is not None)
    metrics["p99.9"] = _percentile(greatest, pixels.finite, total)
    metrics["share"] = int(np.count_nonzero(greatest > over)) / total
    return metrics


def measure_edges(pixels: Pixels, near: NDArray[np.bool_]) -> dict[str, float]:
    """The metrics near depth edges and elsewhere."""
    metrics = {}
    for place, selected in (("edges", near), ("elsewhere", ~near)):
        for name, value in measure(pixels.within(selected), over=0.0, ssim=False).items():
            if f"{place}-{name}" in METRICS:
                metrics[f"{place}-{name}"] = value
    return metrics


def _sum_of_magnitudes(plane: NDArray[Any], finite: NDArray[np.bool_] | None) -> float:
    magnitudes = np.abs(plane) if finite is None else np.abs(plane[finite])
    return float(magnitudes.sum(dtype=np.float64))


def _shown(
    pixels: Pixels, layer: Sequence[str]
) -> tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]]:
    """The encoded channels of a colour layer, of A and of B."""
    a, b = (
        [encoded(pixels.plane(side, name), pixels.gamma) for name in layer] for side in ("a", "b")
    )
    return a, b


def _decibels(
    a: Sequence[NDArray[np.float32]],
    b: Sequence[NDArray[np.float32]],
    finite: NDArray[np.bool_] | None,
    total: int,
) -> float:
    """PSNR of encoded channels for a peak of 1."""
    squares = 0.0
    for old, new in zip(a, b, strict=True):
        difference = np.subtract(new, old)
        if finite is not None:
            difference[~finite] = 0.0
        squares += float(np.einsum("yx,yx->y", difference, difference).sum(dtype=np.float64))
    mean = squares / (total * len(a))
    return EQUAL if mean < 1e-10 else -10 * math.log10(mean)


def _luma(channels: Sequence[NDArray[np.float32]], layer: Sequence[str]) -> NDArray[np.float32]:
    weights = [np.float32(_LUMA[name[-1]]) for name in layer]
    luma = channels[0] * weights[0]
    for channel, weight in zip(channels[1:], weights[1:], strict=True):
        luma += channel * weight
    return luma


def _ssim(
    a: NDArray[np.float32], b: NDArray[np.float32], finite: NDArray[np.bool_] | None
) -> float | None:
    """Structural similarity of lumas [H, W], whose windows' middles are compared; None of none."""
    total, count = 0.0, 0
    inner = slice(REACH, -REACH)
    for top in range(0, a.shape[0] - 2 * REACH, _STRIP):
        rows = slice(top, top + _STRIP + 2 * REACH)
        values = similarity(*(side[rows].astype(np.float64) for side in (a, b)))
        if finite is not None:
            values = values[finite[rows][inner, inner]]
        total, count = total + float(values.sum()), count + values.size
    return total / count if count else None


def _percentile(
    greatest: NDArray[np.float64], finite: NDArray[np.bool_] | None, total: int
) -> float:
    """The 99.9th percentile, linear between the two nearest."""
    values = greatest.ravel() if finite is None else greatest[finite]
    place = 0.999 * (total - 1)
    lower = math.floor(place)
    upper = min(lower + 1, total - 1)
    ordered = np.partition(values, (lower, upper))
    low, high = float(ordered[lower]), float(ordered[upper])
    return low + (place - lower) * (high - low)


def equal_metrics(pixels: Pixels) -> Mapping[str, float]:
    """The metrics of a pair whose values are all equal."""
    metrics = dict.fromkeys(("max", "mean", "rmse", "rel-rmse", "p99.9", "share"), 0.0)
    if pixels.color:
        metrics |= {"psnr": EQUAL, "ssim": 1.0}
    return metrics

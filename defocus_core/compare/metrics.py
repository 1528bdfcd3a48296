"""Metrics of a pair: of stored values, of sRGB values, and of values with highlights.

PSNR and SSIM use sRGB-encoded values of the colour channels, clipped to 0…1. The hdr metrics
include light beyond 1: sRGB up to 1 and logarithmic beyond. The other metrics use all channels in
the values of the file: linear light in an EXR, 0…1 in a file of integers. Pixels that are NaN or
infinite in A or B are left out, as they are judged separately.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.pixels import Pixels, halves
from defocus_core.evaluation.similarity import EQUAL, REACH, psnr, similarity
from defocus_core.io.images.color_space import linear_to_srgb

LUMINANCE = (0.2126, 0.7152, 0.0722)


@dataclass(frozen=True)
class Metric:
    """A metric of a pair."""

    name: str  # as in ``--fail``
    help: str
    unit: str = ""
    better: str = "low"  # or ``high``
    color: bool = False  # whether only pictures with colour have it


_ROWS = (
    Metric("max", "greatest difference of a value in any channel"),
    Metric("mean", "mean absolute difference of all channels"),
    Metric("rmse", "root mean squared difference of all channels"),
    Metric("rel-rmse", "RMSE divided by the mean absolute value of A"),
    Metric("psnr", "PSNR in dB of sRGB-encoded colour, 99 if equal", "dB", "high", color=True),
    Metric(
        "ssim", "structural similarity of sRGB-encoded luma, 1 if equal", "", "high", color=True
    ),
    Metric("p99.9", "99.9 % of the pixels differ by no more than this in any channel"),
    Metric("share", "share of the pixels, 0 to 1, that differ by more than ‹over›"),
    Metric("pixels", "number of pixels that differ by more than ‹over›"),
    Metric("block", "difference of blocks of 32 x 32 px that no lossy codec makes"),
    *(
        Metric(
            f"hdr-{name}",
            f"{words} with colour sRGB-encoded up to 1, logarithmic beyond",
            unit,
            better,
        )
        for name, words, unit, better in (
            ("max", "max", "", "low"),
            ("p99.9", "p99.9", "", "low"),
            ("psnr", "PSNR in dB", "dB", "high"),
        )
    ),
    Metric("flip", "mean of the visible difference FLIP, 0 to 1; needs ‹flip›", "", color=True),
    Metric("flip-max", "FLIP of the worst pixel; needs ‹flip›", "", color=True),
)
METRICS = {metric.name: metric for metric in _ROWS}
# A window of SSIM: 11 x 11 px, gaussian of sigma 1.5 px (Wang et al. 2004).
_LUMA = {**dict(zip("RGB", LUMINANCE, strict=True)), "Y": 1.0}
COSTLY = 2**21  # pixels above which sRGB and hdr metrics are measured only if rules need them
_STRIP = 64  # rows of SSIM that are computed at once, so that they stay in the cache
_BLOCK, _DETAIL = 32, 0.01  # px on a side of blocks; least standard deviation of detail


def unclipped(light: NDArray[Any]) -> NDArray[np.float32]:
    """Linear light on an unbounded scale: sRGB up to 1, logarithmic with the same slope beyond.

    A negative value is the mirror image of a positive one.
    """
    if light.dtype == np.float16:  # a hundred times as fast for 16 bits
        return _of_halves().take(light.view(np.uint16))
    magnitude = np.abs(np.asarray(light, np.float32))
    with np.errstate(invalid="ignore"):  # NaN stays NaN
        shown = linear_to_srgb(np.minimum(magnitude, np.float32(1.0)))
        beyond = np.log(np.maximum(magnitude, np.float32(1.0))) * np.float32(1.055 / 2.4)
        return np.asarray(np.copysign(shown + beyond, light).astype(np.float32))


@cache
def _of_halves() -> NDArray[np.float32]:
    return unclipped(halves())


def _shown(pixels: Pixels, side: str, name: str, *cut: slice) -> NDArray[np.float32]:
    """A channel of colour, sRGB-encoded up to 1 and logarithmic beyond."""
    plane = pixels.plane(side, name)[cut]
    return unclipped(plane) if pixels.gamma == 1.0 else np.asarray(plane, np.float32)


def measure(
    pixels: Pixels, *, over: float, asked: Collection[str] | None = None
) -> dict[str, float]:
    """The metrics of a pair by name, except FLIP and metrics that the pair lacks.

    Args:
        pixels: the pair.
        over: the difference above which the metric ``share`` counts a pixel.
        asked: the metrics to measure even if slow; None for all, with SSIM only of small pictures.
    """
    count = np.count_nonzero(pixels.finite) if pixels.finite is not None else pixels.a[0].size
    if not count:
        return {}
    total, channels = int(count), len(pixels.names)
    differences = pixels.differences
    rmse = math.sqrt(sum(differences.squares.values()) / (total * channels))
    metrics = {
        "max": max(differences.largest.values()),
        "mean": differences.magnitude / (total * channels),
        "rmse": rmse,
    }
    if differences.level > 0:
        metrics["rel-rmse"] = rmse / (differences.level / (total * channels))
    small = pixels.a[0].size <= COSTLY
    shown = asked is None or small or "psnr" in asked
    if shown or any(name.startswith("hdr-") for name in asked or ()):
        metrics |= _on_scales(pixels, total, shown=shown)
    if small if asked is None else "ssim" in asked:
        metrics |= _similarity(pixels)
    metrics["p99.9"] = _percentile(differences.greatest, pixels.finite)
    metrics["pixels"] = int(np.count_nonzero(differences.greatest > over))
    metrics["share"] = metrics["pixels"] / total
    if "block" in (asked or ()):
        metrics["block"] = max((_of_blocks(pixels, layer) for layer in pixels.color), default=0.0)
    return metrics


def _of_blocks(pixels: Pixels, layer: Sequence[str]) -> float:
    """The difference of luma that a codec cannot cause; 0 if a codec can cause all of it.

    A codec keeps the mean of a block and changes the detail of all blocks. So the result is the RMS
    difference of the means of blocks if that is a large part of the difference; else, if most
    blocks are equal, the RMS difference in the worst block.
    """
    height, width = (length // _BLOCK for length in pixels.shape)
    cut = tuple(slice(number * _BLOCK) for number in (height, width))
    a, b = np.zeros((2, height, _BLOCK, width, _BLOCK), np.float32)
    for name in layer:
        for side, total in (("a", a), ("b", b)):
            plane = np.nan_to_num(_shown(pixels, side, name, *cut)).reshape(a.shape)
            total += plane * np.float32(_LUMA[name[-1]])
    b -= a
    if pixels.finite is not None:
        b *= pixels.finite[cut].reshape(b.shape)
    detailed = a.std(axis=(1, 3)) > _DETAIL
    means, squares = (v.mean(axis=(1, 3))[detailed] for v in (b, np.square(b)))
    if not squares.size or np.square(means).sum() > squares.sum() / 4:
        return math.sqrt(float(np.square(means).mean())) if means.size else 0.0
    return 0.0 if np.median(squares) else math.sqrt(float(squares.max()))


def _similarity(pixels: Pixels) -> dict[str, float]:
    """SSIM of the worst layer, over windows whose middle is compared; empty without colour."""
    values, inner = [], slice(REACH, -REACH)
    for layer in pixels.color if min(pixels.shape) > 2 * REACH else ():
        total, count = 0.0, 0
        for top in range(0, pixels.shape[0] - 2 * REACH, _STRIP):
            rows = slice(top, top + _STRIP + 2 * REACH)
            each = similarity(*(_luma_of(pixels, side, layer, rows) for side in "ab"))
            each = each if pixels.finite is None else each[pixels.finite[rows][inner, inner]]
            total, count = total + float(each.sum()), count + each.size
        values += [total / count] if count else []
    return {"ssim": min(values)} if values else {}


def _on_scales(pixels: Pixels, total: int, *, shown: bool) -> dict[str, float]:
    """The hdr metrics and, if ``shown``, the PSNR of the same values clipped to 0…1.

    `total`: number of compared pixels.
    """
    colors = {name for layer in pixels.color for name in layer}
    differences = pixels.differences
    greatest, squares, of_screen = differences.greatest, differences.squares, differences.squares
    if pixels.gamma == 1.0 and colors:  # else values are those of a screen
        greatest = np.zeros(pixels.shape, np.float32)
        squares, of_screen = (dict.fromkeys(pixels.names, 0.0) for _ in "12")
    for rows in pixels.strips() if squares is not of_screen else ():
        out = None if pixels.finite is None else ~pixels.finite[rows]
        for name in pixels.names:
            a, b = (
                _shown(pixels, side, name, rows)
                if name in colors
                else np.asarray(pixels.plane(side, name)[rows], np.float32)
                for side in "ab"
            )
            difference = _difference(a, b, out)
            squares[name] += float(np.square(difference).sum(dtype=np.float64))
            np.maximum(greatest[rows], np.abs(difference, out=difference), out=greatest[rows])
            if shown and name in colors:
                difference = _difference(np.clip(a, 0, 1), np.clip(b, 0, 1), out)
                of_screen[name] += float(np.square(difference).sum(dtype=np.float64))
    metrics = {
        "hdr-max": float(greatest.max()),
        "hdr-p99.9": _percentile(greatest, pixels.finite),
        "hdr-psnr": psnr(sum(squares.values()) / (total * len(pixels.names))),
    }
    if shown and colors:
        means = [sum(of_screen[n] for n in layer) / (total * len(layer)) for layer in pixels.color]
        metrics["psnr"] = psnr(max(means))
    return metrics


def _difference(a: NDArray[Any], b: NDArray[Any], out: NDArray[np.bool_] | None) -> NDArray[Any]:
    """B − A, 0 in pixels that are left out."""
    difference: NDArray[Any] = b - a
    if out is not None:
        difference[out] = 0.0
    return difference


def _luma_of(pixels: Pixels, side: str, layer: Sequence[str], rows: slice) -> NDArray[np.float64]:
    planes = (np.nan_to_num(_shown(pixels, side, name, rows)).clip(0, 1) for name in layer)
    shares = (np.float32(_LUMA[name[-1]]) for name in layer)
    return np.asarray(sum(map(np.multiply, planes, shares)), np.float64)


def _percentile(greatest: NDArray[Any], finite: NDArray[np.bool_] | None) -> float:
    return float(np.percentile(greatest if finite is None else greatest[finite], 99.9))


def equal_metrics(pixels: Pixels) -> Mapping[str, float]:
    """The metrics of a pair whose values are all equal."""
    best = {"psnr": EQUAL, "hdr-psnr": EQUAL, "ssim": 1.0}
    rows = (
        row for row in _ROWS if not row.name.startswith("flip") and row.color <= bool(pixels.color)
    )
    return {row.name: best.get(row.name, 0.0) for row in rows}

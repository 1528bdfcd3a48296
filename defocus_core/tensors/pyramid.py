"""Pictures at half resolution, symmetric about the middle of the frame, and their interpolation.

A mirrored picture halves to its mirror image, and a part of a frame as the whole. Along an even
length two pixels make a coarse one; along an odd length every second pixel does, with half of its
neighbours. Interpolation is cubic where the picture is smooth, else linear.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.later import Tensor, torch


class Axis(NamedTuple):
    """The middle of the frame along an axis."""

    middle: int  # the first index at or after the middle
    odd: bool  # whether the middle is a pixel; else it lies between two


def position_of(pixel: float, fine: Axis, coarse: Axis, level: int) -> float:
    """The position of a pixel along one axis, as a fractional index of coarse pixels."""
    offset = 0.0 if fine.odd else 0.5
    return coarse.middle - offset + (pixel + offset - fine.middle) / (1 << level)


def axes(size: tuple[int, int], top: int = 0, left: int = 0) -> tuple[Axis, Axis]:
    """The middle (down, across) of a frame (height, width), counted from pixel (top, left)."""
    down, across = (
        Axis(n // 2 - start, n % 2 == 1) for n, start in zip(size, (top, left), strict=True)
    )
    return down, across


class AxisHalving(NamedTuple):
    """The halving of one axis: the pixels to pad for whole coarse pixels, and the result."""

    before: int  # pixels missing at the beginning
    after: int  # pixels missing at the end
    length: int  # number of coarse pixels
    axis: Axis  # the middle of the frame among coarse pixels


def halves(length: int, axis: Axis) -> AxisHalving:
    """The halving of an axis of `length` pixels."""
    before = axis.middle % 2
    after = (length + before + axis.odd) % 2
    middle = Axis((axis.middle + before) // 2, axis.odd)
    return AxisHalving(before, after, (length + before + after + axis.odd) // 2, middle)


def extended(values: Tensor, down: AxisHalving, across: AxisHalving, value: float) -> Tensor:
    """Values [..., H, W] padded with `value` to whole coarse pixels."""
    missing = (across.before, across.after, down.before, down.after)
    return torch.nn.functional.pad(values, missing, value=value) if any(missing) else values


def spread_out(values: Tensor, odd: tuple[bool, bool]) -> Tensor:
    """The greatest value [..., H, W] of the coarse pixels [..., h, w] that hold each pixel."""
    for dim in (-2, -1):
        twice = values.repeat_interleave(2, dim)
        if odd[dim]:
            n = 2 * values.shape[dim] - 1
            values = torch.maximum(twice.narrow(dim, 0, n), twice.narrow(dim, 1, n))
        else:
            values = twice
    return values


def halved(values: Tensor, odd: tuple[bool, bool]) -> Tensor:
    """Sums [..., h, w] of the pixels [..., H, W] of each coarse pixel of half resolution."""
    for dim in (-2, -1):  # rows first, which are contiguous
        values = _halved(values, dim, odd[dim])
    return values


def _halved(values: Tensor, dim: int, odd: bool) -> Tensor:
    """Sums of the pixels of each coarse pixel along one axis."""
    even = values[..., 0::2] if dim == -1 else values[..., 0::2, :]
    other = values[..., 1::2] if dim == -1 else values[..., 1::2, :]
    if not odd:
        return even + other
    half = other / 2
    before = (1, 0) if dim == -1 else (0, 0, 1, 0)
    after = (0, 1) if dim == -1 else (0, 0, 0, 1)
    return even + torch.nn.functional.pad(half, before) + torch.nn.functional.pad(half, after)


def averaged(
    values: Tensor, level: int, middle: tuple[Axis, Axis]
) -> tuple[Tensor, tuple[Axis, Axis]]:
    """Means [N, K, h, w] of pictures [N, K, H, W] in coarse px, and the middle among coarse px.

    Pixels beyond the frame count as 0.
    """
    middles = []
    for dim, axis in zip((-2, -1), middle, strict=True):  # rows first, which are contiguous
        for _ in range(level):
            half = halves(values.shape[dim], axis)
            if half.before or half.after:
                missing = (half.before, half.after)
                values = torch.nn.functional.pad(values, missing if dim == -1 else (0, 0, *missing))
            values, axis = _halved(values, dim, axis.odd), half.axis
        middles.append(axis)
    return values * 0.25**level, (middles[0], middles[1])


class AxisWeights(NamedTuple):
    """The coarse pixels next to each of P pixels along an axis, and their weights in the pixel."""

    taps: Tensor  # [T, P] indices of coarse pixels
    share: Tensor  # [T, P]; 0 of coarse pixels that are missing


def cubic_weights(first: float, pixels: int, step: float, length: int, like: Tensor) -> AxisWeights:
    """The weights of cubic interpolation (Keys 1981, a = -1/2) of `length` coarse pixels.

    `first`: position of the first of `pixels` pixels among coarse pixels; `step`: coarse pixels
    from one pixel to the next.
    """
    away, index = _taps(first, pixels, step, 2)
    near = (1.5 * away - 2.5) * away * away + 1
    far = ((2.5 - 0.5 * away) * away - 4) * away + 2
    return _weights(
        torch.where(away < 1, near, torch.where(away < 2, far, 0.0)), index, length, like
    )


def linear_weights(
    first: float, pixels: int, step: float, length: int, like: Tensor
) -> AxisWeights:
    """The weights of linear interpolation, without overshoot; arguments as for `cubic_weights`."""
    away, index = _taps(first, pixels, step, 1)
    return _weights((1 - away).clamp(min=0), index, length, like)


def _taps(first: float, pixels: int, step: float, reach: int) -> tuple[Tensor, Tensor]:
    """Distances [T, P] from pixels to the coarse pixels in reach, and indices of coarse pixels."""
    position = torch.arange(pixels, dtype=torch.float64) * step + first
    index = position.floor() + torch.arange(1 - reach, reach + 1)[:, None]
    return (position - index).abs(), index.long()


def _weights(share: Tensor, index: Tensor, length: int, like: Tensor) -> AxisWeights:
    inside = index.clamp(0, length - 1)
    whole = like.new_empty(0, dtype=torch.long)
    return AxisWeights(sent(inside, whole), sent(share * (inside == index), like))


def resampled(values: Tensor, rows: AxisWeights, columns: AxisWeights) -> Tensor:
    """Coarse pixels [..., h, w] interpolated at pixels [..., H, W]."""
    for dim, (index, share) in ((-1, columns), (-2, rows)):
        taps = [values.index_select(dim, each) for each in index]
        shares = share if dim == -1 else share[..., None]
        values = taps[0] * shares[0]
        for tap, weight in zip(taps[1:], shares[1:], strict=True):
            values.addcmul_(tap, weight)
    return values


def linear(
    coarse: Tensor, rows: tuple[int, int], columns: tuple[int, int], size: tuple[int, ...]
) -> Tensor:
    """Coarse pixels [h, w] interpolated linearly at rows and columns of a picture of `size`."""
    values = coarse
    for dim, (first, end) in enumerate((rows, columns)):
        before, after, fraction = coarse_neighbours(coarse, dim, first, end, size[dim])
        low, high = values.index_select(dim, before), values.index_select(dim, after)
        values = low + fraction.unsqueeze(1 - dim) * (high - low)
    return values


def coarse_neighbours(
    coarse: Tensor, dim: int, first: int, end: int, length: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Indices of the coarse pixels before and after each pixel, and the weight of the one after."""
    count = coarse.shape[dim]
    position = torch.arange(first, end, dtype=coarse.dtype, device=coarse.device) + 0.5
    position = (position * count / length - 0.5).clamp(0, count - 1)
    before = position.long().clamp(max=max(count - 2, 0))
    return before, (before + 1).clamp(max=count - 1), position - before


def coarse_read(box: Box, fine: tuple[Axis, Axis], coarse: tuple[Axis, Axis], level: int) -> Box:
    """The box of the coarse pixels that the interpolation in a rectangle reads."""
    first, end = [], []
    for d, axes in enumerate(zip(fine, coarse, strict=True)):
        first.append(math.floor(position_of(box[d], *axes, level)))
        end.append(math.floor(position_of(box[d] + box[d + 2] - 1, *axes, level)) + 2)
    return Box(first[0], first[1], end[0] - first[0], end[1] - first[1])

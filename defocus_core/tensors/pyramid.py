"""Pictures at half resolution, symmetric about the middle of the frame, and their interpolation.

Halving a mirrored picture gives the mirrored halved picture, and halving a rectangle of a frame
gives the same pixels as halving the frame. Along an axis of even length, a coarse pixel is made of
two pixels; along an axis of odd length, of every second pixel and half of each of its neighbours.
Interpolation is cubic where the picture is smooth, and linear elsewhere.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.later import Tensor, torch


class Axis(NamedTuple):
    """Where the middle of the frame lies along an axis."""

    middle: int  # the first index at or after the middle
    odd: bool  # whether the middle is a pixel; else it lies between two


def position_of(pixel: float, fine: Axis, coarse: Axis, level: int) -> float:
    """The position of a pixel along one axis, as a fractional index of coarse pixels.

    `fine`, `coarse`: the middle of the frame, in pixels and in coarse pixels; `level`: number of
    halvings.
    """
    offset = 0.0 if fine.odd else 0.5
    return coarse.middle - offset + (pixel + offset - fine.middle) / (1 << level)


def axes(size: tuple[int, int], top: int = 0, left: int = 0) -> tuple[Axis, Axis]:
    """Where the middle of a frame lies along both axes (down, across).

    `size`: (height, width) of the frame; `top`, `left`: the pixel from which indices are counted.
    """
    down, across = (
        Axis(n // 2 - start, n % 2 == 1) for n, start in zip(size, (top, left), strict=True)
    )
    return down, across


class AxisHalving(NamedTuple):
    """The halving of one axis: padding to whole coarse pixels, and the resulting axis."""

    before: int  # pixels missing at the beginning
    after: int  # pixels missing at the end
    length: int  # number of coarse pixels
    axis: Axis  # the middle of the frame among coarse pixels


def halves(length: int, axis: Axis) -> AxisHalving:
    """The halving of an axis of `length` pixels; `axis`: where the middle of the frame lies."""
    before = axis.middle % 2
    after = (length + before + axis.odd) % 2
    middle = Axis((axis.middle + before) // 2, axis.odd)
    return AxisHalving(before, after, (length + before + after + axis.odd) // 2, middle)


def spread_out(values: Tensor, odd: tuple[bool, bool]) -> Tensor:
    """The greatest value of the coarse pixels [..., h, w] that include each pixel [..., H, W].

    `odd`: whether the height and the width of the frame are odd.
    """
    for dim in (-2, -1):
        twice = values.repeat_interleave(2, dim)
        if odd[dim]:
            n = 2 * values.shape[dim] - 1
            values = torch.maximum(twice.narrow(dim, 0, n), twice.narrow(dim, 1, n))
        else:
            values = twice
    return values


def _halved(values: Tensor, dim: int, odd: bool) -> Tensor:
    """The sum of the pixels in each coarse pixel along axis `dim`, which is -2 or -1."""
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
    """Pictures [N, K, H, W] averaged to [N, K, h, w], and the middle of the frame in the result.

    Resolution is halved `level` times; `middle` is the middle of the frame in the given pictures.
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


def upsampled(
    coarse: Tensor,  # [..., h, w]
    read: Box,
    box: Box,
    axes: tuple[tuple[Axis, Axis], tuple[Axis, Axis]],
    level: int,
    *,
    cubic: bool = False,
) -> Tensor:
    """The pixels [..., H, W] of a box, interpolated between coarse pixels.

    `read`: where the coarse pixels lie; `axes`: the middle of the frame, in pixels and in coarse
    pixels; `level`: number of halvings; `cubic`: by cubics (Keys 1981, a = -1/2), else linearly.
    """
    indices, reach = coarse.new_empty(0, dtype=torch.long), 2 if cubic else 1
    for dim in (1, 0):
        first = position_of(box[dim], axes[0][dim], axes[1][dim], level) - read[dim]
        position = torch.arange(box[dim + 2], dtype=torch.float64) * 0.5**level + first
        index = position.floor() + torch.arange(1 - reach, reach + 1)[:, None]
        share = (_cubic if cubic else _linear)((position - index).abs())
        inside = index.clamp(0, coarse.shape[dim - 2] - 1)  # missing ones have no share
        shares = sent(share * (inside == index), coarse)
        shares = shares if dim else shares[..., None]
        taps = [coarse.index_select(dim - 2, each) for each in sent(inside, indices)]
        coarse = taps[0] * shares[0]
        for tap, weight in zip(taps[1:], shares[1:], strict=True):
            coarse.addcmul_(tap, weight)
    return coarse


def _linear(away: Tensor) -> Tensor:
    return (1 - away).clamp(min=0)


def _cubic(away: Tensor) -> Tensor:
    near = (1.5 * away - 2.5) * away * away + 1
    far = ((2.5 - 0.5 * away) * away - 4) * away + 2
    return torch.where(away < 1, near, torch.where(away < 2, far, 0.0))


def linear(
    coarse: Tensor, rows: tuple[int, int], columns: tuple[int, int], size: tuple[int, ...]
) -> Tensor:
    """Coarse pixels [h, w], interpolated linearly at rows and columns of a picture of `size`.

    `rows`, `columns`: (first, end); only this window of the picture is computed.
    """
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
    """The box of the coarse pixels that are read to interpolate the pixels in `box`.

    `fine`, `coarse`: the middle of the frame, in pixels and in coarse pixels; `level`: number of
    halvings.
    """
    first, end = [], []
    for d, axes in enumerate(zip(fine, coarse, strict=True)):
        first.append(math.floor(position_of(box[d], *axes, level)))
        end.append(math.floor(position_of(box[d] + box[d + 2] - 1, *axes, level)) + 2)
    return Box(first[0], first[1], end[0] - first[0], end[1] - first[1])

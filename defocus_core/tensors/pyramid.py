"""Pyramids: pictures at half resolution, symmetric about the middle of the frame.

A mirrored picture halves to its mirror image, and a part of a frame as the whole. Of an even length
two pixels make one of the next level. Of an odd length every second pixel does, with half of its
neighbours.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad


class Axis(NamedTuple):
    """The middle of the frame along an axis."""

    middle: int  # the first index at or after the middle
    odd: bool  # whether the middle is a pixel; else it lies between two


def position_of(pixel: float, fine: Axis, coarse: Axis, level: int) -> float:
    """The place of a pixel among coarse pixels, along one axis."""
    offset = 0.0 if fine.odd else 0.5
    return coarse.middle - offset + (pixel + offset - fine.middle) / (1 << level)


def axes(size: tuple[int, int], top: int = 0, left: int = 0) -> tuple[Axis, Axis]:
    """The middle of a frame of (height, width), counted from a pixel of it."""
    down, across = (
        Axis(n // 2 - start, n % 2 == 1) for n, start in zip(size, (top, left), strict=True)
    )
    return down, across


class AxisHalving(NamedTuple):
    """The halving of one axis: pixels missing for whole coarse px, and the coarse px."""

    before: int  # pixels missing at the beginning
    after: int  # pixels missing at the end
    length: int  # pixels of half resolution
    axis: Axis  # where the middle is among them


def halves(length: int, axis: Axis) -> AxisHalving:
    """The halving of an axis of `length` pixels."""
    before = axis.middle % 2
    after = (length + before + axis.odd) % 2
    middle = Axis((axis.middle + before) // 2, axis.odd)
    return AxisHalving(before, after, (length + before + after + axis.odd) // 2, middle)


def extended(values: Tensor, down: AxisHalving, across: AxisHalving, value: float) -> Tensor:
    """Values [..., H, W] with the missing pixels filled by a value."""
    missing = (across.before, across.after, down.before, down.after)
    return pad(values, missing, value=value) if any(missing) else values


def spread_out(values: Tensor, odd: tuple[bool, bool]) -> Tensor:
    """The greatest value [..., H, W] of the coarse pixels [..., h, w] that a pixel is part of."""
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
    for dim in (-2, -1):  # rows first: they lie together
        values = _halved(values, dim, odd[dim])
    return values


def _halved(values: Tensor, dim: int, odd: bool) -> Tensor:
    """The same along one axis."""
    even = values[..., 0::2] if dim == -1 else values[..., 0::2, :]
    other = values[..., 1::2] if dim == -1 else values[..., 1::2, :]
    if not odd:
        return even + other
    half = other / 2
    before = (1, 0) if dim == -1 else (0, 0, 1, 0)
    after = (0, 1) if dim == -1 else (0, 0, 0, 1)
    return even + pad(half, before) + pad(half, after)


def pulled(values: Tensor, odd: tuple[bool, bool]) -> Tensor:
    """Sums [..., h, w] of pixels [..., H, W] in coarse pixels that overlap (Burt 1981).

    As `halved`, but of an even length a pixel counts by 3/4 in its own coarse pixel and by 1/4 in
    the one next to it. What lies outside counts as 0.
    """
    for dim in (-2, -1):
        if odd[dim]:
            values = _halved(values, dim, odd[dim])
            continue
        even = values[..., 0::2] if dim == -1 else values[..., 0::2, :]
        other = values[..., 1::2] if dim == -1 else values[..., 1::2, :]
        n = even.shape[dim] - 1
        values = (even + other).mul_(0.75)
        values.narrow(dim, 1, n).add_(other.narrow(dim, 0, n), alpha=0.25)
        values.narrow(dim, 0, n).add_(even.narrow(dim, 1, n), alpha=0.25)
    return values


def averaged(
    values: Tensor, level: int, middle: tuple[Axis, Axis]
) -> tuple[Tensor, tuple[Axis, Axis]]:
    """Means [N, K, h, w] of pictures [N, K, H, W] in coarse px, and the middle among coarse px.

    Pixels beyond the frame count as 0.
    """
    middles = []
    for dim, axis in zip((-2, -1), middle, strict=True):  # rows first: they lie together
        for _ in range(level):
            half = halves(values.shape[dim], axis)
            if half.before or half.after:
                missing = (half.before, half.after)
                values = pad(values, missing if dim == -1 else (0, 0, *missing))
            values, axis = _halved(values, dim, axis.odd), half.axis
        middles.append(axis)
    return values * 0.25**level, (middles[0], middles[1])

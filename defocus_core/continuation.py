"""A smooth continuation of a picture to pixels that have no value: push and pull.

Values are averaged to half resolution again and again, by the weight they have; then each level
fills from the next coarser one what it lacks (Gortler et al. 1996). Two pixels make one of the next
level. Of an odd length every second pixel does, with half of its neighbours: seen from both ends
the levels are the same, so that a mirrored picture continues as its mirror image.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import interpolate, pad


def quartered(values: Tensor) -> list[Tensor]:
    """Values [K, H, W] as pictures [K, h, w] of half the size, whose sum is the next level."""
    return [q.contiguous() for half in _halved(values, -1) for q in _halved(half, -2)]


def _halved(values: Tensor, dim: int) -> list[Tensor]:
    even, odd = (
        (values[..., 0::2], values[..., 1::2])
        if dim == -1
        else (values[..., 0::2, :], values[..., 1::2, :])
    )
    if values.shape[dim] % 2 == 0:
        return [even, odd]
    before = (1, 0) if dim == -1 else (0, 0, 1, 0)
    after = (0, 1) if dim == -1 else (0, 0, 0, 1)
    return [even, pad(odd / 2, before), pad(odd / 2, after)]


def pooled(quarters: Sequence[Tensor], chosen: Sequence[Tensor]) -> Tensor:
    """The sum of those pixels of quarters [K, h, w] that are chosen [h, w]."""
    total = torch.zeros_like(quarters[0])
    for quarter, some in zip(quarters, chosen, strict=True):
        total = total.addcmul(quarter, some.to(total.dtype))
    return total


def next_level(values: Tensor) -> Tensor:
    """Sums [K, h, w] of the pixels [K, H, W] that make one of half resolution."""
    for dim in (-1, -2):
        first, *others = _halved(values, dim)
        values = first + others[0] if len(others) == 1 else first + others[0] + others[1]
    return values


def continued(half: Tensor, at: Tensor, size: Sequence[int]) -> Tensor:
    """Values continued to pixels that have none.

    Args:
        half: [K + 1, h, w], sums of `quartered` values times weight; the last channel is weight,
            which was 0 or 1.
        at: [n, 2] rows and columns, at full resolution, of pixels of weight 0.
        size: (H, W) of full resolution.

    Returns:
        [n, K].
    """
    levels = [half / half[-1:].clamp(min=1)]
    while max(levels[-1].shape[-2:]) > 1:
        sums = next_level(levels[-1])
        levels.append(sums / sums[-1:].clamp(min=1))
    weight = levels[-1][-1:]
    found = levels.pop()[:-1] / torch.where(weight > 0, weight, 1.0)
    for level in reversed(levels):
        found = interpolate(found[None], size=level.shape[-2:], mode="bilinear")[0]
        found = level[:-1] + (1 - level[-1:]) * found
    return _bilinear(found, at, size)


def _bilinear(coarse: Tensor, at: Tensor, size: Sequence[int]) -> Tensor:
    """Coarse values [K, h, w] at pixels [n, 2] of a frame of the given size: [n, K]."""
    (y0, y1, fy), (x0, x1, fx) = (
        _neighbours(at[:, d], coarse.shape[d + 1], size[d], coarse.dtype) for d in (0, 1)
    )
    above = coarse[:, y0, x0] * (1 - fx) + coarse[:, y0, x1] * fx
    below = coarse[:, y1, x0] * (1 - fx) + coarse[:, y1, x1] * fx
    return (above * (1 - fy) + below * fy).T


def _neighbours(
    index: Tensor, length: int, full: int, dtype: torch.dtype
) -> tuple[Tensor, Tensor, Tensor]:
    """The two coarse samples beside a pixel, and the share of the second."""
    place = (index.to(dtype) + 0.5) * (length / full) - 0.5
    first = place.floor().clamp(0, length - 1)
    share = (place - first).clamp(0, 1)
    return first.long(), (first.long() + 1).clamp(max=length - 1), share

"""Front to back: what covers what, and what fills the rest.

Coverage is the share of an aperture part that sees a slice. Slices of one continuous surface have
complementary coverage and must add up; separate surfaces must occlude. The saturating sum does
both: each slice adds its coverage until the whole part is covered.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Composite(NamedTuple):
    """What a part of the aperture has seen so far.

    Attributes:
        color: [M, C, h, w], premultiplied by coverage.
        coverage: [M, h, w] in [0, 1].
    """

    color: Tensor
    coverage: Tensor


def nothing(parts: int, channels: int, size: tuple[int, int], like: Tensor) -> Composite:
    """The composite before the first slice."""
    return Composite(
        torch.zeros(parts, channels, *size, dtype=like.dtype, device=like.device),
        torch.zeros(parts, *size, dtype=like.dtype, device=like.device),
    )


def add_behind(front: Composite, slices: Tensor) -> Composite:
    """Add slices [K, M, C + 1, h, w], nearest first, the last channel being coverage.

    Slice k adds min(1, (1 - A) / a_k) of itself, with A what is covered and a_k its coverage:
    A grows by min(a_k, 1 - A).
    """
    coverage = slices[:, :, -1].clamp(min=0)  # transforms leave ±1e-8
    covered = torch.cat([front.coverage[None], coverage]).cumsum(0).clamp(max=1)
    share = _share(covered.diff(dim=0), coverage)
    color = (slices[:, :, :-1] * share[:, :, None]).sum(0)
    return Composite(front.color + color, covered[-1])


def _share(seen: Tensor, coverage: Tensor) -> Tensor:
    """Seen / coverage in [0, 1], 0 where there is no coverage."""
    some = coverage > 0
    return torch.where(some, seen / torch.where(some, coverage, 1.0), 0.0).clamp(max=1)


def picture(composite: Composite) -> Tensor:
    """The left and the right image [2, C, h, w], each divided by the share that saw something.

    A pixel sees at least its own surface through each half of the aperture: the share is positive.
    """
    halves = len(composite.coverage) // 2
    color = torch.stack(composite.color.split(halves)).sum(1)
    coverage = torch.stack(composite.coverage.split(halves)).sum(1)
    return color / coverage[:, None]

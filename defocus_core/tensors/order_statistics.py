"""Order statistics of values that are read in parts, exact to the last bit.

The bits of numbers that are not negative order like the numbers. So the first 16 bits of all are
counted, then the next 16 bits of the numbers with the right first bits: each pass reads all numbers
once and keeps none (radix selection). Negative numbers count as 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import torch
from torch import Tensor

from defocus_core.tensors.sparse_masks import tally

_BITS = 16


def counted(values: Tensor, prefix: int = 0, level: int = 0, *, each: bool = False) -> Tensor:
    """The count of numbers for each value of their next 16 bits, given their first bits.

    `each`: whether values are [B, ...], and those of each of B are counted apart, at level 0.
    Returns [2^16], or [2^15] at level 0, where one bit is the sign; [B, 2^15] for each.
    """
    whole = values.dtype.itemsize * 8
    positive = values.clamp(min=0).abs_()  # not even -0
    bits = positive.view(torch.int64 if whole == 64 else torch.int32).flatten(int(each))
    if level:
        bits = bits[bits >> (whole - _BITS * level) == prefix]
    digits = bits >> (whole - _BITS * (level + 1))
    if level:
        digits &= (1 << _BITS) - 1
    return tally(digits, 1 << (_BITS if level else _BITS - 1))


@dataclass(frozen=True)
class Ranks:
    """Numbers by rank."""

    counts: Tensor  # [2^15] counts of their first 16 bits, from `counted`, on the CPU
    again: Callable[[], Iterable[Tensor]]  # reads all numbers once more, part by part
    dtype: torch.dtype  # type of the numbers, of 32 or 64 bits

    @property
    def total(self) -> int:
        """The number of numbers."""
        return int(self.counts.sum())

    def about(self, rank: int) -> tuple[float, float]:
        """Two numbers between which the number of a rank lies; ranks count from 1 upwards."""
        digit, _ = _located(self.counts, rank)
        shift = self.dtype.itemsize * 8 - _BITS
        return self._number(digit << shift), self._number(((digit + 1) << shift) - 1)

    def exactly(self, rank: int) -> float:
        """The number of a rank; ranks count from 1 upwards."""
        prefix, rest = _located(self.counts, rank)
        for level in range(1, self.dtype.itemsize * 8 // _BITS):
            counts = sum(counted(values, prefix, level) for values in self.again())
            assert isinstance(counts, Tensor)
            counts = counts.cpu()
            digit, rest = _located(counts, rest)
            prefix = prefix << _BITS | digit
        return self._number(prefix)

    def _number(self, bits: int) -> float:
        kind = torch.int64 if self.dtype.itemsize == 8 else torch.int32
        return float(torch.tensor(bits, dtype=kind).view(self.dtype))


def depth_percentile(
    parts: Callable[[], Iterable[Tensor]], percent: float, dtype: torch.dtype
) -> float | None:
    """The distance that a share of the pixels does not exceed, without sky and holes.

    It is the distance of a pixel: between two surfaces there is nothing to focus on.

    `percent`: from 0 to 100. Returns the distance, None if no pixel has one.
    """

    def solid() -> Iterable[Tensor]:
        return (part[torch.isfinite(part) & (part > 0)] for part in parts())

    counts = sum((counted(part) for part in solid()), torch.zeros((), dtype=torch.long))
    ranks = Ranks(counts, solid, dtype)
    if not ranks.total:
        return None
    return ranks.exactly(percentile_rank(percent, ranks.total))


def percentile_rank(percent: float, total: int) -> int:
    """The rank, from 1, of the least of `total` numbers that a share of them does not exceed."""
    return min(max(math.ceil(total * (percent / 100)), 1), total)


def _located(counts: Tensor, rank: int) -> tuple[int, int]:
    """The bin that holds a rank, and the rank within the bin."""
    summed = counts.cumsum(0)
    digit = int(torch.searchsorted(summed, rank))
    return digit, rank - int(summed[digit] - counts[digit])

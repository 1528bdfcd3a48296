"""Sparse masks: the few pixels at edges, listed faster than by torch.nonzero on a CPU.

torch compares, and looks for values that are not 0, one by one; it converts and adds many at once.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.tensors.device_plan import launches_cost

# Number of pixels of a mask that are read as one word, and of those of a mask that is worth it.
_WORD, _MANY = 8, 1 << 13


def exceeding(values: Tensor, bound: float | Tensor) -> Tensor:
    """Where values [...] exceed a bound: bool. No value is NaN, nor infinite if the bound is."""
    if launches_cost(values.device):
        return values.detach() > bound
    return (values.detach() - bound).clamp_(min=0).bool()


def flat_nonzero(mask: Tensor) -> Tensor:
    """The numbers [n], ascending, of the pixels in a mask [...] bool; fast if these are few."""
    flat = mask.flatten()
    end = flat.numel() // _WORD * _WORD
    if end < _MANY or flat.storage_offset() % _WORD or launches_cost(flat.device):
        return torch.nonzero(flat)[:, 0]
    words = torch.nonzero(flat[:end].view(torch.int64))[:, 0]
    word, pixel = torch.nonzero(flat[:end].view(-1, _WORD).index_select(0, words)).unbind(1)
    numbers = words.index_select(0, word).mul_(_WORD).add_(pixel)
    if end == flat.numel():
        return numbers
    return torch.cat([numbers, torch.nonzero(flat[end:])[:, 0] + end])


def taken(values: Tensor, mask: Tensor) -> Tensor:
    """The values [n] of the pixels in a mask.

    Of a batch, and elsewhere than on a CPU, where the host would wait for their number, those of
    all pixels [..., n], 0 for the others.
    """
    if values.dim() > 2 or launches_cost(values.device):
        return torch.where(mask, values, 0)
    return values.flatten()[flat_nonzero(mask)]


def tally(numbers: Tensor, kinds: int) -> Tensor:
    """How often [..., kinds] each number from 0 occurs in [..., n]; waits for nothing."""
    if not launches_cost(numbers.device) and numbers.dim() == 1:
        return torch.bincount(numbers, minlength=kinds)
    counts = torch.zeros(*numbers.shape[:-1], kinds, dtype=torch.long, device=numbers.device)
    return counts.scatter_add_(-1, numbers.long(), counts.new_ones(()).expand_as(numbers))


def tally_of(mask: Tensor) -> Tensor:
    """The number [...] of pixels in the mask of each picture of a batch [..., H, W]."""
    return torch.count_nonzero(mask) if mask.dim() == 2 else mask.sum((-2, -1))


def sums_of_each(values: Tensor, of: Tensor, count: int) -> Tensor:
    """Sums [count, K] in double precision of values [n, K], by the picture [n] that they are of."""
    if count == 1:
        return values.sum(0, dtype=torch.float64)[None]
    sums = torch.zeros(count, values.shape[1], dtype=torch.float64, device=values.device)
    return sums.index_add_(0, of, values.double())


def positions_of(mask: Tensor) -> Tensor:
    """The rows and columns [n, 2] of the pixels in a mask [..., H, W] bool.

    Rows are counted on from one picture of a batch to the next, as if it lay below.
    """
    number = flat_nonzero(mask)
    row = number.div(mask.shape[-1], rounding_mode="floor")
    return torch.stack([row, number - row * mask.shape[-1]], 1)

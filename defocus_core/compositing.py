"""Front to back: what covers what, and what fills the rest.

Coverage is the share of an aperture part that sees a slice. Slices of one continuous surface have
complementary coverage and must add up; separate surfaces must occlude. The saturating sum does
both: each slice adds its coverage until the whole part is covered.
"""

from __future__ import annotations

import torch
from torch import Tensor

# Guards 0 / 0 where nothing is left to cover; shares below it are of no consequence.
_LEAST_SHARE = 1e-12


def add_behind(seen: Tensor, layer: Tensor) -> Tensor:
    """Add a layer behind what the parts of the aperture have seen so far.

    The layer adds min(1, (1 - A) / a) of itself, where A is what is covered and a its coverage:
    A grows by min(a, 1 - A).

    Args:
        seen: [M, C + 1, h, w], colour premultiplied by coverage, then coverage in [0, 1]. Not
            changed where a gradient is wanted, else overwritten by the result.
        layer: The same of the layer.
    """
    left = (1 - seen[:, -1:]).clamp(min=0)
    share = left / torch.maximum(layer[:, -1:], left).clamp(min=_LEAST_SHARE)
    if torch.is_grad_enabled():
        return seen.addcmul(layer, share)
    return seen.addcmul_(layer, share)


def picture(seen: Tensor) -> Tensor:
    """The left and the right image [2, C, h, w], each divided by the share that saw something.

    A pixel sees at least its own surface through each half of the aperture: the share is positive.
    """
    left, right = seen.tensor_split(2)
    halves = torch.stack([left.sum(0), right.sum(0)])
    return halves[:, :-1] / halves[:, -1:]

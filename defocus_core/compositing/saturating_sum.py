"""The saturating sum: layers composited front to back by coverage.

Coverage is the share of an aperture part that sees a slice. Slices of one continuous surface have
complementary coverage and must add up; separate surfaces must occlude. The saturating sum does
both: each slice adds its coverage until the whole part is covered.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.images.box import Box

# Guards 0 / 0 where nothing is left to cover; shares below it are of no consequence.
_LEAST_SHARE = 1e-12
# Coverage below the inverse of this counts less than it is, and from 0 downwards nothing.
_SOME = 1e9
# Shares below this many roundings are noise of the transforms; slopes of their quotients, which
# every further layer would multiply, count as none.
_CERTAIN = 100
# Roundings by which transforms miss what is covered at most.
_FULL = 8
# Shares of the aperture that differ by less are equal.
_EQUAL = 1e-6


def share_behind(seen: Tensor, layer: Tensor, full: Tensor | float = 1.0) -> Tensor:
    """The share of a layer that shows behind what the parts of the aperture have seen so far.

    The layer adds min(1, (1 - A) / a) of itself, where A is what is covered and a its coverage:
    A grows by min(a, 1 - A). Where a is negative, by rounding or by overshoot, nothing is there.

    Args:
        seen: [M, C + 1, h, w], colour premultiplied by coverage, then coverage in [0, 1].
        layer: The same of the layer.
        full: What is covered at most, if not the whole part.

    Returns:
        [M, 1, h, w].
    """
    left, coverage = full - seen[:, -1:], layer[:, -1:]
    some = torch.minimum(left, coverage * _SOME).clamp_(min=0)
    share = some / torch.maximum(coverage, left).clamp_(min=_LEAST_SHARE)
    if torch.is_grad_enabled():
        certain = torch.minimum(coverage, left) > _CERTAIN * torch.finfo(left.dtype).eps
        share = torch.where(certain, share, share.detach())
    return share


def add_behind(seen: Tensor, layer: Tensor, full: Tensor | float = 1.0) -> Tensor:
    """Add a layer behind what the parts of the aperture have seen so far.

    Args:
        seen: As above. Not changed where a gradient is wanted, else overwritten by the result.
        layer: As above.
        full: As above.
    """
    share = share_behind(seen, layer, full)
    return seen.addcmul(layer, share) if torch.is_grad_enabled() else seen.addcmul_(layer, share)


def filled_up_to(seen: Tensor, full: Tensor | float, doubt: float) -> Tensor:
    """What is covered at most, [M, 1, h, w], if gaps may be errors of what is seen.

    Of a gap less than the doubt only its share of that is filled: a tenth of it by a tenth.

    Args:
        seen: [M, C + 1, h, w], as above.
        full: What is covered at most if there is no doubt.
        doubt: Share of the part that gaps may be in error.
    """
    covered = seen[:, -1:]
    left = (full - covered).clamp(min=0)
    return covered + left * (left / doubt).clamp(max=1)


def add_within(total: Tensor, box: Box, some: Tensor, share: Tensor | None = None) -> Tensor:
    """Add to [M, C, H, W] what is but within a rectangle, [M, C, h, w], or a share of that.

    The total is not changed where a gradient is wanted, else overwritten by the result.
    """
    if not torch.is_grad_enabled():
        here = box.of(total)
        here.add_(some) if share is None else here.addcmul_(some, share)
        return total
    H, W = total.shape[-2:]
    ends = W - box.left - box.width, H - box.top - box.height
    around = (box.left, ends[0], box.top, ends[1])
    if share is None:
        return total + pad(some, around)
    return total.addcmul(pad(some, around), pad(share, around))


def add_light(seen: Tensor, light: Tensor) -> Tensor:
    """Add light [M, C, h, w] that covers nothing to [M, C + 1, h, w].

    What was seen is not changed where a gradient is wanted, else overwritten by the result.
    """
    if torch.is_grad_enabled():
        return torch.cat([seen[:, :-1] + light, seen[:, -1:]], 1)
    seen[:, :-1].add_(light)
    return seen


def is_full(seen: Tensor, full: Tensor | float = 1.0) -> bool:
    """Whether nothing is left to cover, as far as it is worth asking.

    Never where a gradient is wanted, for what is left has one; nor off the CPU, where the answer
    would be waited for: adding nothing costs less there.

    Args:
        seen: [M, C + 1, h, w], as above.
        full: As above.
    """
    if seen.requires_grad or not seen.is_cpu:
        return False
    return float((full - seen[:, -1:]).amax()) <= _FULL * torch.finfo(seen.dtype).eps


def summed(layers: Iterable[tuple[Box, Tensor]], size: tuple[int, int]) -> Tensor | None:
    """The sum of layers that do not occlude each other.

    Args:
        layers: Each [M, C + 1, h, w] within a rectangle.
        size: (height, width) of the sum.

    Returns:
        [M, C + 1, height, width]; None if there is no layer.
    """
    total: Tensor | None = None
    for box, layer in layers:
        if total is None:
            total = layer.new_zeros(*layer.shape[:2], *size)
        total = add_within(total, box, layer)
    return total


def picture(seen: Tensor, weights: Sequence[float] | None = None, *, signed: bool = True) -> Tensor:
    """The image [C, h, w] of some parts together, divided by the share that saw something.

    Args:
        seen: [M, C + 1, h, w].
        weights: M shares of the parts in the aperture; None if they are equal.
        signed: Whether it may be negative; else what rounding and overshoot leave is cut off.

    A pixel sees its own surface at least through the whole or a half of the aperture: the share is
    positive.
    """
    if weights is not None and max(weights) - min(weights) > _EQUAL:
        seen = seen * seen.new_tensor(weights)[:, None, None, None]
    total = seen.sum(0) if len(seen) > 1 else seen[0]
    image = total[:-1] / total[-1:]
    return image if signed else image.clamp_(min=0)


def pair_of(centre: Tensor, left: Tensor, right: Tensor, *, signed: bool) -> Tensor:
    """Left and right images [2, C, h, w] whose mean is the centre, from halves composited alone.

    Occlusion within a half differs from that within the whole, so their mean is near the centre
    but not equal. Where light is positive their ratio is kept, else their difference.

    Args:
        centre: [C, h, w].
        left: As composited, [C, h, w].
        right: The same.
        signed: Whether pixels of the picture are negative (colours outside the gamut).
    """
    if signed:
        difference = (left - right) / 2
        return torch.stack([centre + difference, centre - difference])
    left, right = left.clamp(min=0), right.clamp(min=0)  # transforms leave ±1e-8
    total = left + right
    some = total > 0
    share = torch.where(some, left / torch.where(some, total, 1.0), 0.5)
    return 2 * centre * torch.stack([share, 1 - share])

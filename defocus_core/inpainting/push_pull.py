"""Push-pull: a smooth continuation of surfaces to hidden pixels.

A pixel takes what lies around it at a fine resolution, as far as there is anything, and the rest
from the next coarser one, until it has enough (Gortler et al. 1996). Resolutions are made once, of
surfaces instead of borders (`sheets.py`); only the pixels that ask are looked up.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.images.pyramid import Axis, places
from defocus_core.inpainting.two_layer_pyramid import Level, Sheet

# Pixels that have as much of a value as this look no farther.
_ENOUGH = 0.5
# Pixels looked up at once: few enough to stay in a cache.
_PIXELS = 1 << 15


class Asked(NamedTuple):
    """Pixels that something is continued to, and which surfaces.

    Attributes:
        at: [n, 2] rows and columns, in between pixels too.
        border: [n] px of radius, beyond which a surface is continued.
        ceiling: [n] px, from which on it is not.
    """

    at: Tensor
    border: Tensor
    ceiling: Tensor

    def some(self, index: Tensor) -> Asked:
        """Some of them."""
        return Asked(*(values.index_select(0, index) for values in self))


def continued(
    finest: tuple[Tensor, Tensor],
    levels: Sequence[Level],
    asked: Asked,
    fine: tuple[Axis, Axis],
) -> tuple[Tensor, Tensor]:
    """Values of some pixels, each from the surfaces that are continued to it.

    Args:
        finest: What is around them at the finest resolution, as below.
        levels: The next ones, from fine to coarse, K channels.
        asked: The pixels, at full resolution.
        fine: Where the middle of the frame is at full resolution.

    Returns:
        [K, n] values times their weight, and [n] these weights, in [0, 1].
    """
    values, weight = finest
    for level in levels:
        some = torch.nonzero(weight < _ENOUGH)[:, 0]
        if not len(some):
            break
        found, share = nearby(level, asked.some(some), fine)
        left = 1 - weight.index_select(0, some)
        values = values.index_add(1, some, found * left)
        weight = weight.index_add(0, some, share * left)
    return values, weight


def nearby(level: Level, asked: Asked, fine: tuple[Axis, Axis]) -> tuple[Tensor, Tensor]:
    """What is around some pixels at one resolution; arguments and result as above."""
    if len(asked.at) <= _PIXELS:
        return _nearby(level, asked, fine)
    pieces = zip(*(torch.split(values, _PIXELS) for values in asked), strict=True)
    parts = [_nearby(level, Asked(*some), fine) for some in pieces]
    values, weights = zip(*parts, strict=True)
    return torch.cat(values, 1), torch.cat(weights)


def _nearby(level: Level, asked: Asked, fine: tuple[Axis, Axis]) -> tuple[Tensor, Tensor]:
    """The four cells around each pixel, by their distance."""
    n, ends = len(asked.at), (asked.border.detach().repeat(4), asked.ceiling.detach().repeat(4))
    place = torch.stack(places(asked.at, fine, level.middle, level.halvings))
    (row, column), (down, across) = _neighbours(place.to(asked.border.dtype), level.size)
    cell = (row[:, None] * level.size[1] + column).flatten()
    share = (down[:, None] * across).flatten()
    values, weight = _weighed(level.first, cell, ends, share)
    if level.second is not None and level.number is not None:
        number = level.number.index_select(0, cell)
        share = share * (number + 1).clamp_(max=1)  # 0 where there is none
        found, light = _weighed(level.second, number.clamp_(min=0), ends, share)
        values, weight = values + found, weight + light
    values, weight = values.reshape(-1, 4, n).sum(1), weight.reshape(4, n).sum(0)
    most = weight.clamp(min=1)
    return values / most, weight / most


def _weighed(
    sheet: Sheet, cell: Tensor, ends: tuple[Tensor, Tensor], share: Tensor
) -> tuple[Tensor, Tensor]:
    """Values [K, n] of a cell each times their weights, and these [n]; 0 but between two ends."""
    least = sheet.least.index_select(0, cell)
    between = torch.minimum(least - ends[0], ends[1] - least).gt_(0)
    weight = share * sheet.weight.index_select(0, cell) * between
    return sheet.values.index_select(1, cell) * weight, weight


def _neighbours(place: Tensor, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """The two cells beside each place [2, n] along both axes, and their shares; 0 if none is.

    Returns:
        Both [2, 2, n], of rows and of columns.
    """
    below = place.floor()
    last = below.new_tensor(size)[:, None] - 1
    share = place - below
    exists = torch.stack([below + 1, last - below], 1).clamp_(0, 1)
    number = torch.stack([below, below + 1], 1).clamp_(min=0)
    return torch.minimum(number, last[:, None]).long(), torch.stack([1 - share, share], 1) * exists

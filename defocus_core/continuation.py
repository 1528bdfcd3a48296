"""A smooth continuation of surfaces to pixels where they are hidden: push and pull.

A pixel takes what lies around it at a fine resolution, as far as there is anything, and the rest
from the next coarser one, until it has enough (Gortler et al. 1996). Resolutions are made once, of
surfaces instead of borders (`sheets.py`); only the pixels that ask are looked up.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from defocus_core.halving import Axis, places
from defocus_core.sheets import Level, Sheet

# Pixels that have as much of a value as this look no farther.
_ENOUGH = 0.5
# Pixels looked up at once: few enough to stay in a cache.
_PIXELS = 1 << 14


def continued(
    levels: Sequence[Level], at: Tensor, border: Tensor, fine: tuple[Axis, Axis]
) -> tuple[Tensor, Tensor]:
    """Values of some pixels, of each from the surfaces that lie beyond its border.

    Args:
        levels: From fine to coarse, K channels.
        at: [n, 2] rows and columns of the pixels at full resolution, in between them too.
        border: [n] px of radius.
        fine: Where the middle of the frame is at full resolution.

    Returns:
        [K, n] values times their weight, and [n] these weights, in [0, 1].
    """
    values, weight = nearby(levels[0], at, border, fine)
    for level in levels[1:]:
        some = torch.nonzero(weight < _ENOUGH)[:, 0]
        if not len(some):
            break
        found, share = nearby(level, at.index_select(0, some), border.index_select(0, some), fine)
        left = 1 - weight.index_select(0, some)
        values = values.index_add(1, some, found * left)
        weight = weight.index_add(0, some, share * left)
    return values, weight


def nearby(
    level: Level, at: Tensor, border: Tensor, fine: tuple[Axis, Axis]
) -> tuple[Tensor, Tensor]:
    """What is around some pixels at one resolution; arguments and result as above."""
    if len(at) <= _PIXELS:
        return _nearby(level, at, border, fine)
    parts = [
        _nearby(level, *some, fine)
        for some in zip(torch.split(at, _PIXELS), torch.split(border, _PIXELS), strict=True)
    ]
    values, weights = zip(*parts, strict=True)
    return torch.cat(values, 1), torch.cat(weights)


def _nearby(
    level: Level, at: Tensor, border: Tensor, fine: tuple[Axis, Axis]
) -> tuple[Tensor, Tensor]:
    """The four cells around each pixel, by their distance."""
    down, across = (
        _neighbours(place, length, border.dtype)
        for place, length in zip(
            places(at, fine, level.middle, level.halvings), level.size, strict=True
        )
    )
    values, weight = level.first.values.new_zeros(len(level.first.values), len(at)), 0 * border
    for row, share_down in down:
        for column, share_across in across:
            cell, share = row * level.size[1] + column, share_down * share_across
            values, weight = _added(values, weight, level.first, cell, border, share)
            if level.second is None or level.number is None:
                continue
            number = level.number.index_select(0, cell)
            some = torch.nonzero(number >= 0)[:, 0]
            if len(some):
                number, limit, part = (x.index_select(0, some) for x in (number, border, share))
                more = values.new_zeros(len(values), len(some)), 0 * limit
                found, light = _added(*more, level.second, number, limit, part)
                values = values.index_add(1, some, found)
                weight = weight.index_add(0, some, light)
    most = weight.clamp(min=1)
    return values / most, weight / most


def _added(
    values: Tensor, weight: Tensor, sheet: Sheet, cell: Tensor, border: Tensor, share: Tensor
) -> tuple[Tensor, Tensor]:
    """Values [K, n] and weights [n] with those of a cell each, if it lies beyond the border."""
    share = share * sheet.weight.index_select(0, cell)
    share = share * (sheet.least.index_select(0, cell) > border)
    return torch.addcmul(values, sheet.values.index_select(1, cell), share), weight + share


def _neighbours(place: Tensor, length: int, dtype: torch.dtype) -> list[tuple[Tensor, Tensor]]:
    """The two cells beside each place [n] along an axis, and their shares; 0 if there is none."""
    place = place.to(dtype)
    below = place.floor()
    share, first = place - below, below.long()
    return [
        (number.clamp(0, length - 1), part * ((number >= 0) & (number < length)))
        for number, part in ((first, 1 - share), (first + 1, share))
    ]

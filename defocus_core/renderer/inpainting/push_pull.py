"""Push-pull: a smooth continuation of surfaces to hidden pixels.

A pixel takes the mean of the surfaces around it at a fine level, by the weight that they have
there, and the rest from the next coarser level, until its weight is enough (Gortler et al. 1996).
The levels are computed once (`two_layer_pyramid.py`), and read for the hidden pixels alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.inpainting.two_layer_pyramid import CellSurface, PyramidLevel
from defocus_core.tensors.device_plan import pieces
from defocus_core.tensors.pyramid import Axis, places

# Weight from which on a pixel takes nothing from coarser levels.
_ENOUGH = 0.5
# Pixels looked up at once on a CPU, few enough to stay in a cache, and bytes that each takes
# elsewhere.
_PIXELS, _BYTES_EACH = 1 << 15, 1 << 10


class HiddenQueries(NamedTuple):
    """Hidden pixels, and the range of radii of the surfaces that are continued to each.

    Attributes:
        at: [n, 2] rows and columns, also between pixels.
        border: [n] px, the radius that a surface must exceed.
        ceiling: [n] px, the radius that a surface must not reach.
    """

    at: Tensor
    border: Tensor
    ceiling: Tensor

    def select(self, index: Tensor) -> HiddenQueries:
        """The pixels of these indices."""
        return HiddenQueries(*(values.index_select(0, index) for values in self))


def continued(
    finest: tuple[Tensor, Tensor],
    levels: Sequence[PyramidLevel],
    asked: HiddenQueries,
    fine: tuple[Axis, Axis],
) -> tuple[Tensor, Tensor]:
    """Values of hidden pixels, each from the surfaces that are continued to it.

    Args:
        finest: Values and weights from the finest level, in the form of the result.
        levels: The coarser levels, from fine to coarse, K channels.
        asked: The hidden pixels, at full resolution.
        fine: Where the middle of the frame is at full resolution.

    Returns:
        [K, n] values times weights, and [n] weights in [0, 1].
    """
    values, weight = finest
    for level in levels:
        lacking = torch.nonzero(weight < _ENOUGH)[:, 0]
        if not len(lacking):
            break
        more, share = nearby(level, asked.select(lacking), fine)
        missing = 1 - weight.index_select(0, lacking)
        values = values.index_add(1, lacking, more * missing)
        weight = weight.index_add(0, lacking, share * missing)
    return values, weight


def nearby(
    level: PyramidLevel, asked: HiddenQueries, fine: tuple[Axis, Axis]
) -> tuple[Tensor, Tensor]:
    """The mean of the four cells of one level around each pixel, weighted by distance.

    Arguments and result are those of `continued`.
    """
    count = pieces(asked.at.device, _PIXELS, _BYTES_EACH)
    chunks = zip(*(torch.split(values, count) for values in asked), strict=True)
    parts = [_nearby(level, HiddenQueries(*chunk), fine) for chunk in chunks]
    values, weights = zip(*parts, strict=True)
    return torch.cat(values, 1), torch.cat(weights)


def _nearby(
    level: PyramidLevel, asked: HiddenQueries, fine: tuple[Axis, Axis]
) -> tuple[Tensor, Tensor]:
    """The same for few pixels at once."""
    n, ends = len(asked.at), (asked.border.detach().repeat(4), asked.ceiling.detach().repeat(4))
    place = torch.stack(places(asked.at, fine, level.middle, level.halvings))
    (row, column), (down, across) = _neighbours(place.to(asked.border.dtype), level.size)
    cell = (row[:, None] * level.size[1] + column).flatten()
    share = (down[:, None] * across).flatten()
    values, weight = _weighed(level.first, cell, ends, share)
    if level.second is not None and level.number is not None:
        number = level.number.index_select(0, cell)
        share = share * (number + 1).clamp_(max=1)  # 0 where a cell has no second sheet
        second_values, second_weight = _weighed(level.second, number.clamp_(min=0), ends, share)
        values, weight = values + second_values, weight + second_weight
    values, weight = values.reshape(-1, 4, n).sum(1), weight.reshape(4, n).sum(0)
    most = weight.clamp(min=1)
    return values / most, weight / most


def _weighed(
    sheet: CellSurface, cell: Tensor, ends: tuple[Tensor, Tensor], share: Tensor
) -> tuple[Tensor, Tensor]:
    """Values [K, n] of cells times weights, and weights [n]; 0 unless radii lie between `ends`."""
    values, weight, least, _ = sheet.select(cell).parts
    between = torch.minimum(least - ends[0], ends[1] - least).gt_(0)
    weight = share * weight * between
    return values * weight, weight


def _neighbours(place: Tensor, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """The two cells beside each place [2, n] along both axes, and their shares; 0 outside.

    Returns:
        Numbers and shares, each [2, 2, n]: rows first, then columns.
    """
    below = place.floor()
    last = below.new_tensor(size)[:, None] - 1
    share = place - below
    exists = torch.stack([below + 1, last - below], 1).clamp_(0, 1)
    number = torch.stack([below, below + 1], 1).clamp_(min=0)
    return torch.minimum(number, last[:, None]).long(), torch.stack([1 - share, share], 1) * exists

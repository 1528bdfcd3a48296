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
from defocus_core.tensors.device_plan import pieces, sent
from defocus_core.tensors.pyramid import Axis, positions

# Weight from which on a pixel takes nothing from coarser levels.
_ENOUGH = 0.5
# Pixels looked up at once on a CPU, few enough to stay in a cache, and bytes that each takes
# elsewhere.
_PIXELS, _BYTES_EACH = 1 << 15, 1 << 10


class HiddenQueries(NamedTuple):
    """Hidden pixels, and the range of radii of the surfaces that are continued to each."""

    at: Tensor  # [n, 2] rows and columns, also between pixels
    border: Tensor  # [n] px, the radius that a surface must exceed
    ceiling: Tensor  # [n] px, the radius that a surface must not reach
    of: Tensor | None = None  # [n] the picture of a batch that each is of; None if there is one

    def select(self, index: Tensor) -> HiddenQueries:
        """The pixels of these indices."""
        at, border, ceiling = (values.index_select(0, index) for values in self[:3])
        of = None if self.of is None else self.of.index_select(0, index)
        return HiddenQueries(at, border, ceiling, of)


def continued(
    finest: tuple[Tensor, Tensor],
    levels: Sequence[tuple[PyramidLevel, Tensor | None]],
    asked: HiddenQueries,
    fine: tuple[Axis, Axis],
) -> tuple[Tensor, Tensor]:
    """Values of hidden pixels, each from the surfaces that are continued to it.

    `levels`: the coarser levels, from fine to coarse, K channels; and which pixels [n] have them,
    None if all do. Returns [K, n] values times weights, and [n] weights in [0, 1].
    """
    values, weight = finest
    for level, exists in levels:
        lacks = weight < _ENOUGH
        lacking = torch.nonzero(lacks if exists is None else lacks & exists)[:, 0]
        if not len(lacking):
            break
        more, fraction = nearby(level, asked.select(lacking), fine)
        missing = 1 - weight.index_select(0, lacking)
        values = values.index_add(1, lacking, more * missing)
        weight = weight.index_add(0, lacking, fraction * missing)
    return values, weight


def nearby(
    level: PyramidLevel, asked: HiddenQueries, fine: tuple[Axis, Axis]
) -> tuple[Tensor, Tensor]:
    """The mean of the four coarse pixels of one level around each pixel, weighted by distance.

    Arguments and result are those of `continued`.
    """
    count = pieces(asked.at.device, _PIXELS, _BYTES_EACH)
    if len(asked.at) <= count:
        return _nearby(level, asked, fine)
    numbers = torch.split(torch.arange(len(asked.at), device=asked.at.device), count)
    parts = [_nearby(level, asked.select(chunk), fine) for chunk in numbers]
    values, weights = zip(*parts, strict=True)
    return torch.cat(values, 1), torch.cat(weights)


def _nearby(
    level: PyramidLevel, asked: HiddenQueries, fine: tuple[Axis, Axis]
) -> tuple[Tensor, Tensor]:
    """The same for few pixels at once."""
    n, limits = len(asked.at), (asked.border.detach().repeat(4), asked.ceiling.detach().repeat(4))
    position = torch.stack(positions(asked.at, fine, level.middle, level.level))
    (row, column), (down, across) = _neighbours(position.to(asked.border.dtype), level.size)
    coarse_pixel = row[:, None] * level.size[1] + column
    if asked.of is not None:
        coarse_pixel = coarse_pixel + asked.of * (level.size[0] * level.size[1])
    coarse_pixel = coarse_pixel.flatten()
    fraction = (down[:, None] * across).flatten()
    values, weight = _weighed(level.first, coarse_pixel, limits, fraction)
    if level.second is not None and level.second_index is not None:
        second_index = level.second_index.index_select(0, coarse_pixel)
        # 0 where a coarse pixel has no second sheet
        fraction = fraction * (second_index + 1).clamp_(max=1)
        second_values, second_weight = _weighed(
            level.second, second_index.clamp_(min=0), limits, fraction
        )
        values, weight = values + second_values, weight + second_weight
    values, weight = values.reshape(-1, 4, n).sum(1), weight.reshape(4, n).sum(0)
    maximum = weight.clamp(min=1)
    return values / maximum, weight / maximum


def _weighed(
    sheet: CellSurface, coarse_pixel: Tensor, limits: tuple[Tensor, Tensor], fraction: Tensor
) -> tuple[Tensor, Tensor]:
    """Values [K, n] of coarse pixels by weights, and weights [n]; 0 for radii beyond `limits`."""
    values, weight, minimum, _ = sheet.select(coarse_pixel).parts
    between = (minimum > limits[0]) & (minimum < limits[1])
    weight = torch.where(between, fraction * weight, 0.0)
    return values * weight, weight


def _neighbours(position: Tensor, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """The two coarse pixels beside each place [2, n] along both axes, and their shares; 0 outside.

    Returns numbers and shares, each [2, 2, n]: rows first, then columns.
    """
    below = position.floor()
    last = sent(size, below)[:, None] - 1
    fraction = position - below
    exists = torch.stack([below + 1, last - below], 1).clamp_(0, 1)
    second_index = torch.stack([below, below + 1], 1).clamp_(min=0)
    return torch.minimum(second_index, last[:, None]).long(), torch.stack(
        [1 - fraction, fraction], 1
    ) * exists

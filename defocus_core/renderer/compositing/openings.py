"""Openings: where a lens sees past the opaque samples of pixels, to what these hide.

Slices of one surface add up to the whole only nearly: a slope, or depth in steps, leaves a gap of a
hundredth. Where no edge is in reach, such a gap is an error, whatever lies behind.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d, pad

from defocus_core.renderer.layers.slice_radii import slice_position
from defocus_core.renderer.layers.stacked_samples import ascending
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent

# Neighbours are of two surfaces if their radii differ by more than this, in px and as a share of
# the radius; less is a slope.
_NEAR, _FAR = 0.25, 0.1
# Samples whose neighbours are looked up at once; bounds memory.
_SAMPLES_AT_ONCE = 1 << 18


class Openings(NamedTuple):
    """Where a lens sees past the nearest opaque sample of each pixel."""

    room: Tensor  # [h, w] from 0, where no edge of opaque samples is in reach, to 1
    layer_index: Tensor  # [h, w] of the layer that the sample is in; inf where there is none

    @classmethod
    def of(cls, opaque: Tensor, radii: tuple[float, ...], layer_of: list[int]) -> Openings:
        """The openings of opaque samples.

        `opaque`: radii [L, h, w] px of the samples of each pixel; inf of those that are clear;
        `radii`: signed radius of each slice in px.
        """
        opaque = opaque.detach()
        nearest = opaque.amin(0)
        position = slice_position(nearest.clamp(max=radii[-1]), radii).ceil().long()
        layer_index = sent(layer_of, nearest)[position]
        none = nearest == torch.inf
        room = _spread(_reach_of_edges(opaque)).clamp(0, 1)
        return cls(room.masked_fill(none, 1), layer_index.masked_fill(none, torch.inf))

    def over(self, box: Box) -> Openings:
        """Those in a box."""
        return Openings(*map(box.of, self))

    def to(self, layer_index: int) -> Tensor:
        """The room [h, w] for what is hidden in a layer."""
        return torch.where(self.layer_index < layer_index, self.room, 1)


def _reach_of_edges(opaque: Tensor) -> Tensor:
    """How far the blur [h, w] px of samples reaches that do not go on in all pixels beside."""
    count = int((opaque < torch.inf).sum(0).amax())
    if not count:
        return torch.zeros_like(opaque[0])
    opaque = opaque.gather(0, ascending(opaque))[:count]
    around = pad(opaque[:, None], (1, 1, 1, 1), mode="replicate")[:, 0].permute(1, 2, 0)
    rows = max(1, _SAMPLES_AT_ONCE // around[0].numel())
    bands = range(0, opaque.shape[1], rows)
    return torch.cat([_reach_in_band(around[top : top + rows + 2]) for top in bands])


def _reach_in_band(around: Tensor) -> Tensor:
    """As `_reach_of_edges`, of ascending radii [h + 2, w + 2, L] with the pixels around."""
    height, width, count = around.shape
    radius = around[1:-1, 1:-1].contiguous()
    ends = torch.zeros_like(radius, dtype=torch.bool)
    for y, x in ((0, 1), (2, 1), (1, 0), (1, 2)):
        beside = around[y : y + height - 2, x : x + width - 2].contiguous()
        above = torch.searchsorted(beside, radius).clamp(max=count - 1)
        steps = [
            (beside.gather(2, index) - radius).abs() for index in (above, (above - 1).clamp(min=0))
        ]
        ends |= ~(torch.minimum(*steps) <= _NEAR + _FAR * radius.abs())
    return torch.where(ends & (radius < torch.inf), radius.abs(), 0).amax(2)


def _spread(reach: Tensor) -> Tensor:
    """By how many px each pixel [h, w] lies within the reach of another."""
    for step in range(math.ceil(float(reach.amax())) - 1):
        beside = reach[None, None]
        if step % 2:  # squares and crosses in turn: an octagon is nearly a circle
            beside = torch.maximum(_pooled(beside, 3, 1), _pooled(beside, 1, 3))
        else:
            beside = _pooled(beside, 3, 3)
        reach = torch.maximum(reach, beside[0, 0] - 1)
    return reach


def _pooled(values: Tensor, height: int, width: int) -> Tensor:
    return max_pool2d(values, (height, width), 1, (height // 2, width // 2))

"""Sight limits: how far the lens sees at each pixel.

A surface of radius r shows itself to every lens point that meets it within r of a pixel: of what
lies behind, nothing is seen but where its disc of r px passes an edge. So the farthest that the
lens sees at a pixel is the farthest within its own disc. Slices of one surface add up to the whole
only nearly, where its radius has a slope or steps: such a gap is an error, whatever lies behind.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent

# Px around the disc of a pixel that it may see: edges lie between pixels, some half a pixel off.
_AROUND = 0.7
# Ratio of the sizes of discs that are told apart, from those of whole px on.
_RATIO = 1.1
# Squares and crosses, in turn, whose sum is nearly a disc; True for squares.
_SHAPES = (True, False, False, True, False)
# Apothem of the octagon, as a share of the radius of the disc.
_APOTHEM = 0.97


class SightLimits(NamedTuple):
    """How far the lens sees at each pixel of a picture."""

    farthest: Tensor  # [..., h, w], the number of the farthest slice
    layer_of: list[int]  # for each slice the number of its layer, ascending
    octaves: list[int]  # for each slice the octave of what is hidden, ascending

    @classmethod
    def of(
        cls, radius: Tensor, positions: Tensor, layer_of: list[int], octaves: list[int]
    ) -> SightLimits:
        """The limits of a picture.

        `radius`: [..., h, w] px, signed; `positions`: [..., h, w], between slice radii.
        """
        small = torch.uint8 if len(layer_of) <= torch.iinfo(torch.uint8).max else torch.int16
        slices = positions.detach().ceil().to(small)
        return cls(_greatest_within(slices, radius.detach().abs()), layer_of, octaves)

    def over(self, box: Box) -> SightLimits:
        """Those in a box."""
        return self._replace(farthest=box.of(self.farthest))

    def without(self, pictures: list[bool]) -> SightLimits:
        """Those of a batch, without limits in some of its pictures."""
        if not any(pictures):
            return self
        free = sent(pictures, self.farthest)[:, None, None].bool()
        return self._replace(farthest=self.farthest.masked_fill(free, len(self.layer_of)))

    def to(self, layer_index: int) -> Tensor | None:
        """Whether [..., h, w] the lens sees as far as a layer; None if it does everywhere."""
        return self._to(bisect_left(self.layer_of, layer_index))

    def to_octave(self, octave: int) -> Tensor | None:
        """As `to`, of the hidden surfaces of an octave."""
        return self._to(bisect_left(self.octaves, octave))

    def _to(self, number: int) -> Tensor | None:
        seen = self.farthest >= number
        return None if seen.is_cpu and bool(seen.all()) else seen


def _greatest_within(values: Tensor, radius: Tensor) -> Tensor:
    """The greatest of values [..., h, w] within a distance [..., h, w] px of each pixel."""
    px = radius.add(_AROUND).mul_(_APOTHEM).round_().clamp_(min=1).to(torch.int32)
    sizes = [1]
    while sizes[-1] < int(px.amax()):
        sizes.append(max(sizes[-1] + 1, round(_RATIO * sizes[-1])))
    nearest = [
        min(range(len(sizes)), key=lambda i: abs(sizes[i] - n)) for n in range(sizes[-1] + 1)
    ]
    greatest = values.new_empty(len(sizes), values.numel())
    for number, (size, before) in enumerate(zip(sizes, [0, *sizes], strict=False)):
        square = _SHAPES[number % len(_SHAPES)]
        values = _dilated(values, size - before, square=square)
        greatest[number] = values.flatten()
    which = torch.tensor(nearest, device=px.device).index_select(0, px.flatten())
    return greatest.gather(0, which[None]).view_as(values)


def _dilated(values: Tensor, by: int, *, square: bool) -> Tensor:
    """The greatest of values [..., h, w] and those `by` px beside, above and below.

    Of a square those on its corners, too.
    """
    greatest = values.clone()
    for dim in (-2, -1):
        given = greatest.clone() if square else values
        n = max(values.shape[dim] - by, 0)
        for target, source in ((by, 0), (0, by)):
            if n:
                part = greatest.narrow(dim, target, n)
                torch.maximum(part, given.narrow(dim, source, n), out=part)
    return greatest

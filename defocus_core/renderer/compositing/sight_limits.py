"""Sight limits: how far the lens sees at each pixel.

A surface of radius r shows itself to every lens point that meets it within r of a pixel: of what
lies behind, nothing is seen but where its disc of r px passes an edge. So the farthest that the
lens sees at a pixel is the farthest within its own disc. Slices of one surface add up to the whole
only nearly, where its radius has a slope or steps: such a gap is an error, whatever lies behind.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.layers.slice_radii import slice_position
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.neighbourhoods import extreme_around

# Px around the disc of a pixel that it may see, for edges lie between pixels.
_AROUND = 1.0
# Ratio of the sizes of discs that are told apart, from those of whole px on.
_RATIO = 1.2


class SightLimits(NamedTuple):
    """How far the lens sees at each pixel of a picture.

    Attributes:
        layer_index: [..., h, w], the number of the farthest layer.
        octave: [..., h, w], the farthest octave of what is hidden.
    """

    layer_index: Tensor
    octave: Tensor

    @classmethod
    def of(
        cls, radius: Tensor, radii: tuple[float, ...], layer_of: list[int], octaves: list[int]
    ) -> SightLimits:
        """The limits of a picture.

        Args:
            radius: [..., h, w] px, signed.
            radii: Signed radius of each slice in px.
            layer_of: For each slice the number of its layer.
            octaves: For each slice the octave of what is hidden.
        """
        farthest = _farthest_within_discs(radius.detach(), max(map(abs, radii)))
        position = slice_position(farthest, radii).ceil().long()
        return cls(sent(layer_of, farthest)[position], sent(octaves, farthest)[position])

    def over(self, box: Box) -> SightLimits:
        """Those in a box."""
        return SightLimits(*map(box.of, self))

    def to(self, layer_index: int) -> Tensor:
        """Whether [..., h, w] the lens sees as far as a layer: 1 or 0."""
        return (self.layer_index >= layer_index).to(self.layer_index.dtype)

    def to_octave(self, octave: int) -> Tensor:
        """Whether [..., h, w] the lens sees as far as hidden surfaces of an octave: 1 or 0."""
        return (self.octave >= octave).to(self.octave.dtype)


def _farthest_within_discs(radius: Tensor, maximum: float) -> Tensor:
    """The greatest radius [..., h, w] px in the disc of each pixel.

    Args:
        radius: [..., h, w] px.
        maximum: The greatest size of a radius.
    """
    reach = radius.abs() + _AROUND
    greatest = farthest = extreme_around(radius, 1, torch.maximum)
    px, square = 1, False
    while px + 0.5 < maximum + _AROUND:
        step = max(1, round((_RATIO - 1) * px))
        greatest = _dilated(greatest, step, square=square)
        farthest = torch.where(reach > px + 0.5, greatest, farthest)
        px, square = px + step, not square
    return farthest


def _dilated(values: Tensor, by: int, *, square: bool) -> Tensor:
    """The greatest of values [..., h, w] and those `by` px beside, above and below.

    Of a square those on its corners, too: squares and crosses in turn make octagons of squares.
    """
    greatest = values
    for dim in (-2, -1):
        given = greatest if square else values
        n = values.shape[dim] - by
        if n < 1:
            continue
        greatest = greatest.clone() if greatest is values or square else greatest
        for target, source in ((by, 0), (0, by)):
            part = greatest.narrow(dim, target, n)
            torch.maximum(part, given.narrow(dim, source, n), out=part)
    return greatest

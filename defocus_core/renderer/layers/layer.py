"""Layers: samples of one surface per pixel, visible or hidden.

The layers of a picture are the surface at the depth of each pixel, then the nearer surfaces that
cover a share of a pixel. The layers of a layered scene are its samples, from near to far.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.matting import MixedPixels
from defocus_core.renderer.layers.slice_radii import membership, slice_position
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.neighbourhoods import flat_nonzero

# Kinds of layers: seen by a pinhole; hidden by nearer samples of the same pixels; shares of pixels
# that no sample covers, without colours; and continued behind edges, maybe at half the resolution.
VISIBLE, HIDDEN, UNCOVERED, CONTINUED = "visible", "hidden", "uncovered", "continued"
# And the nearest opaque sample of each pixel, which may hide lights; and the trace of itself that a
# pixel keeps where the pupil may see nothing of the frame.
SOLID, TRACE = "solid", "trace"


class SampleLayer(NamedTuple):
    """A layer with at most one sample in each pixel."""

    color: Tensor  # [C, ..., H, W], not premultiplied by coverage; 0 where that is 0
    coverage: Tensor  # [1, ..., H, W], the share of each pixel that the layer covers
    signed_radius: Tensor  # [..., H, W] px
    sparse: bool = False  # whether there are pixels without a sample
    kind: str = VISIBLE

    @classmethod
    def whole(cls, color: Tensor, signed_radius: Tensor) -> SampleLayer:
        """A layer that covers all pixels."""
        return cls(color, color.new_ones(1, *signed_radius.shape), signed_radius)

    @property
    def light(self) -> Tensor:
        """The colour premultiplied by coverage, [C, ..., H, W]."""
        return self.color * self.coverage

    @property
    def covered(self) -> Tensor:
        """The coverage as [..., H, W]."""
        return self.coverage[0]

    @property
    def light_and_coverage(self) -> list[Tensor]:
        """Light [C, ..., H, W] and coverage [1, ..., H, W]."""
        return [self.light, self.coverage]

    def crop(self, box: Box) -> SampleLayer:
        """The part of the layer in a box."""
        color, coverage, radius = map(box.crop, self[:3])
        return self._replace(color=color, coverage=coverage, signed_radius=radius)


class HiddenLayer(NamedTuple):
    """The surface behind the visible one, where the aperture may see it or where it is known.

    Attributes:
        color: [C, H, W].
        signed_radius: [H, W] px.
        mask: [H, W] bool, where the surface exists.
    """

    color: Tensor
    signed_radius: Tensor
    mask: Tensor


# Colour, radius and mask as of a `HiddenLayer`, in memory or in files: undefined outside the mask,
# which is not 0 where the layer is known.
KnownLayer = tuple[Tensor, Tensor, Tensor]


def layers_of(image: Tensor, signed_radius: Tensor, mixed: MixedPixels) -> tuple[SampleLayer, ...]:
    """The layers of a picture: the surface at each pixel's depth, then nearer ones in mixed pixels.

    `image`: [C, ..., H, W]; `signed_radius`: [..., H, W] px.
    """
    if not len(mixed.at):
        return (SampleLayer.whole(image, signed_radius),)
    index = mixed.at[:, 0] * signed_radius.shape[-1] + mixed.at[:, 1]
    own, nearer = mixed.own, mixed.nearer

    size = signed_radius.shape
    color = image.flatten(1).index_copy(1, index, own[:-1]).view(image.shape)
    coverage = image.new_ones(1, size.numel()).index_copy_(1, index, own[-1:]).view(1, *size)
    parts = image.new_zeros(len(nearer), size.numel()).index_copy_(1, index, nearer)
    others = parts.view(-1, *size).tensor_split([-2, -1])
    return (
        SampleLayer(color, coverage, signed_radius),
        SampleLayer(others[0], others[1], others[2][0], sparse=True),
    )


def mixed_within(mixed: MixedPixels, box: Box) -> MixedPixels:
    """The mixed pixels of a frame that lie in a box, with positions relative to the box."""
    y, x = mixed.at[:, 0] - box.top, mixed.at[:, 1] - box.left
    number = flat_nonzero((y >= 0) & (x >= 0) & (y < box.height) & (x < box.width))
    at = torch.stack([y, x], 1)
    return mixed._replace(at=at).select(number)


def of_slices(layers: Sequence[SampleLayer], radii: tuple[float, ...]) -> list[SampleLayer]:
    """Layers merged to one layer for each slice that holds any of their samples.

    `radii`: signed radii of the slices in px.
    """
    sums: dict[int, Tensor] = {}
    for layer in layers:
        positions = slice_position(layer.signed_radius, radii)
        held = positions.detach()[layer.covered.detach() > 0]
        if not len(held):
            continue
        light = torch.cat([layer.light, layer.covered[None]])
        for k in range(int(held.min().floor()), int(held.max().ceil()) + 1):
            part = light * membership(positions, sent([k], positions))
            sums[k] = sums[k] + part if k in sums else part
    return [
        SampleLayer(
            light[:-1] / torch.where(light[-1:] > 0, light[-1:], 1.0),
            light[-1:],
            torch.full_like(light[0], radii[k]),
            sparse=True,
        )
        for k, light in sums.items()
    ]

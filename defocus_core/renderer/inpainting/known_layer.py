"""A known layer behind the visible surface, and the hidden pixels that it leaves to invent."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.inpainting.disocclusion import STEP
from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer
from defocus_core.renderer.inpainting.region_view import in_coarse_pixels, in_pixels
from defocus_core.tensors.box import Box
from defocus_core.tensors.pyramid import Axis
from defocus_core.tensors.source import Pixels


class Behind(NamedTuple):
    """The known layer of a whole frame, in memory or in files.

    Attributes:
        color: [C, H, W] linear; undefined outside the mask.
        signed_radius: [H, W] px; undefined outside the mask.
        mask: [H, W], not 0 where the layer is known.
    """

    color: Pixels
    signed_radius: Pixels
    mask: Pixels

    def of_channels(self, channels: list[int], px: float | Tensor) -> Behind:
        """Some of its channels, with px added to its radii."""
        if len(channels) == self.color.shape[0] and isinstance(px, float) and px == 0:
            return self
        return Behind(self.color[channels], self.signed_radius[:] + px, self.mask)

    def within(self, box: Box, signed_radius: Tensor, dtype: torch.dtype) -> HiddenLayer:
        """The known layer within a box whose visible radii are [height, width] px."""
        color, radius, mask = map(box.of, self)
        mask = mask.bool()
        color = torch.where(mask, color.to(dtype), 0.0)
        return HiddenLayer(color, torch.where(mask, radius.to(dtype), signed_radius), mask)


def separated(
    known: HiddenLayer, hidden: HiddenLayer, middle: tuple[Axis, Axis]
) -> tuple[HiddenLayer, HiddenLayer]:
    """The hidden part of a known layer, and the part of an invented layer that is still needed.

    Args:
        known: The known layer, [H, W].
        hidden: The invented layer, at full or half resolution.
        middle: The middle of the frame, in px.
    """
    size = (known.mask.shape[-2], known.mask.shape[-1])
    halved = hidden.mask.shape != known.mask.shape
    mask, radius = hidden.mask, hidden.signed_radius
    if halved:
        mask = in_pixels(mask.to(radius.dtype), size, middle) > 0
        radius = in_pixels(radius.detach(), size, middle)
    farther = radius > known.signed_radius + STEP
    needed = mask & (~known.mask | farther)
    if halved:
        needed = hidden.mask & in_coarse_pixels(needed, middle)
    return known._replace(mask=mask & known.mask), hidden._replace(mask=needed)

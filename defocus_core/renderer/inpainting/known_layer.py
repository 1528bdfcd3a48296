"""A known layer behind the visible surface, and the hidden pixels that it leaves to invent."""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.renderer.inpainting.disocclusion import STEP
from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer
from defocus_core.renderer.inpainting.region_view import in_coarse_pixels, in_pixels
from defocus_core.tensors.box import Box
from defocus_core.tensors.pyramid import Axis
from defocus_core.tensors.source import Pixels

# Colour, radius and mask as of a `HiddenLayer`, in memory or in files: undefined outside the mask,
# which is not 0 where the layer is known.
KnownLayer = tuple[Pixels, Pixels, Pixels]


def known_within(
    known: KnownLayer, box: Box, signed_radius: Tensor, dtype: torch.dtype
) -> HiddenLayer:
    """A known layer within a box whose visible radii are [height, width] px."""
    color, radius, mask = map(box.of, known)
    mask = mask.bool()
    color = torch.where(mask, color.to(dtype), 0.0)
    return HiddenLayer(color, torch.where(mask, radius.to(dtype), signed_radius), mask)


def separated(
    known: HiddenLayer, hidden: HiddenLayer, middle: tuple[Axis, Axis]
) -> tuple[HiddenLayer, HiddenLayer]:
    """The hidden part of a known layer, and the part of an invented layer that is still needed.

    `known`: the known layer, [H, W]; `middle`: the middle of the frame, in px.
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

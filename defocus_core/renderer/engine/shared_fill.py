"""Shared fill: hidden surfaces of a picture whose colours are rendered apart, continued once.

What is hidden is the same for all colours, but for the px by which their radii differ. It is kept
for a region until each colour has taken it, if there is room.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.matting import unmixed, whole
from defocus_core.renderer.compositing.highlights import split
from defocus_core.renderer.engine.frame import SharedFrame
from defocus_core.renderer.inpainting.frame_pyramid import Backdrop, backdrop_of
from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer, hidden_layer
from defocus_core.tensors.box import Box
from defocus_core.tensors.neighbourhoods import range_of
from defocus_core.tensors.source import Pixels, banded

_Place = tuple[Box, Box]


class SharedFill:
    """The hidden surfaces of a picture, for colours of different radii.

    Attributes:
        limits: Least and greatest signed radius in px of all colours.
        colors: The number of channels.
        keeps: Whether there is room to keep what is continued.
    """

    def __init__(
        self,
        frame: Callable[[], SharedFrame],
        pixels: Pixels,
        signed_radius: Pixels,
        offsets: Sequence[float],
        *,
        keep: bool,
    ) -> None:
        """Keep the picture; nothing is continued yet.

        Args:
            frame: Makes the frame of all channels, at full size.
            pixels: [C, H, W], all channels.
            signed_radius: [H, W] px, of a colour without an offset.
            offsets: Px that are added to the radii of each group of colours.
            keep: Whether there is room to keep it; without room it is continued for each colour.
        """
        self.keeps = keep
        self._made, self._pixels, self._radius = frame, pixels, signed_radius
        self._groups, self.colors = len(offsets), pixels.shape[0]
        limits = torch.stack([range_of(band) for band in banded(signed_radius)])
        minimum, maximum = float(limits[:, 0].amin()), float(limits[:, 1].amax())
        self.limits = minimum + min(offsets), maximum + max(offsets)
        self._layers: dict[_Place, HiddenLayer | None] = {}
        self._taken: Counter[_Place] = Counter()

    def of(self, channels: Sequence[int], px: float) -> FillOfColors:
        """The fill of some channels, whose radii have an offset."""
        return FillOfColors(self, list(channels), px)

    def layer(self, outer: Box, inside: Box) -> HiddenLayer | None:
        """The hidden layer within `inside` of the rectangle `outer`; None where nothing is hidden.

        Gradients do not flow to it.
        """
        if not self.keeps:
            return self._continued(outer, inside)
        position = outer, inside
        if position not in self._layers:
            self._layers[position] = self._continued(outer, inside)
        self._taken[position] += 1
        if self._taken[position] == self._groups:
            return self._layers.pop(position)
        return self._layers[position]

    def _continued(self, outer: Box, inside: Box) -> HiddenLayer | None:
        frame = self._frame
        pixels, radius = (
            outer.of(x).to(frame.dtype).contiguous() for x in (self._pixels, self._radius)
        )
        limit = frame.content.limit
        shown = unmixed(pixels, radius, limit) if frame.quality.unmixes else whole(pixels, radius)
        if frame.content.highlights:
            shown, _ = split(shown, radius, limit)
        return continued(shown.color, radius, self._backdrop, outer, inside, frame)

    @cached_property
    def _frame(self) -> SharedFrame:
        """The frame of all channels, if anything is continued."""
        return self._made()

    @cached_property
    def _backdrop(self) -> Backdrop:
        frame = self._frame
        return backdrop_of(
            self._pixels,
            self._radius,
            frame.content.limit,
            frame.dtype,
            frame.settings.threads,
            frame.content.limits,
            unmixes=frame.quality.unmixes,
        )


class FillOfColors(NamedTuple):
    """The hidden surfaces of some colours.

    Attributes:
        shared: Those of all colours.
        channels: The numbers of the colours.
        px: Px that are added to their radii.
    """

    shared: SharedFill
    channels: list[int]
    px: float

    def layer(self, outer: Box, inside: Box) -> HiddenLayer | None:
        """As that of all colours."""
        layer = self.shared.layer(outer, inside)
        if layer is None:
            return None
        return HiddenLayer(layer.color[self.channels], layer.signed_radius + self.px, layer.mask)


def continued(
    color: Tensor,
    signed_radius: Tensor,
    backdrop: Backdrop | FillOfColors,
    outer: Box,
    inside: Box,
    frame: SharedFrame,
) -> HiddenLayer | None:
    """The hidden layer of a region, continued here or for all colours; None without any.

    Args:
        color: [C, h, w] of the visible surface in the rectangle `outer`.
        signed_radius: [h, w] px.
        backdrop: The frame at low resolution, or what is continued for all colours.
        outer: The region with all that decides it.
        inside: Where in it the layer matters.
        frame: The frame.
    """
    if isinstance(backdrop, FillOfColors):
        return backdrop.layer(outer, inside)
    level = frame.slices.invented.level
    return hidden_layer(color, signed_radius, backdrop, outer, inside, level=level)

"""RegionSurfaces of a picture whose colours are rendered apart: taken apart and continued once.

A pixel holds the same shares of the same surfaces in all colours, whose radii differ by some px.
What is continued in a region is kept until each colour has taken it, if there is room.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.matting import Unmixed, unmixed, whole
from defocus_core.renderer.compositing.highlights import split
from defocus_core.renderer.engine.frame import SharedFrame
from defocus_core.renderer.inpainting.frame_pyramid import Backdrop, backdrop_of
from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer, hidden_layer
from defocus_core.tensors.box import Box
from defocus_core.tensors.neighbourhoods import range_of
from defocus_core.tensors.source import Pixels, Scalar, banded


class RegionSurfaces(NamedTuple):
    """The surfaces of a rectangle."""

    shown: Unmixed
    hidden: HiddenLayer | None  # those that are continued behind them; None where nothing is hidden


class SharedSurfaces:
    """The surfaces of a picture, for colours of different radii.

    Attributes:
        limits: Least and greatest signed radius in px of all colours.
        colors: The number of channels.
        keeps: Whether there is room to keep what is continued.
    """

    def __init__(
        self,
        frame: Callable[[], SharedFrame],
        pixels: Pixels,  # [C, H, W], all channels
        signed_radius: Pixels,  # [H, W] px, of a colour without an offset
        offsets: Sequence[Scalar],
        *,
        keep: bool,
        matte: Pixels | None = None,  # [H, W], the coverage of a subject; None if it is not known
    ) -> None:
        """Keep the picture; nothing is continued yet."""
        self.keeps, self._matte = keep, matte
        self._made, self._pixels, self._radius = frame, pixels, signed_radius
        self._groups, self.colors = len(offsets), pixels.shape[0]
        limits = torch.stack([range_of(band) for band in banded(signed_radius)])
        minimum, maximum = float(limits[:, 0].amin()), float(limits[:, 1].amax())
        added = [float(torch.as_tensor(px).detach()) for px in offsets]
        self.limits = minimum + min(added), maximum + max(added)
        self._hidden: dict[tuple[Box, Box], HiddenLayer | None] = {}
        self._taken: Counter[tuple[Box, Box]] = Counter()

    def of(self, channels: Sequence[int], px: Scalar) -> SurfacesOfColors:
        """The surfaces of some channels, whose radii have an offset."""
        return SurfacesOfColors(self, list(channels), px)

    def at(self, outer: Box, inside: Box) -> RegionSurfaces:
        """The visible surfaces of the rectangle `outer`, the hidden ones within `inside` of it."""
        frame, position = self._frame, (outer, inside)
        pixels, radius = (
            outer.of(x).to(frame.dtype).contiguous() for x in (self._pixels, self._radius)
        )
        shown = taken_apart(pixels, radius, self._matte, outer, frame)
        if position in self._hidden:
            hidden = self._hidden[position]
        else:
            ordinary = shown
            if frame.content.highlights:
                ordinary, _ = split(shown, radius, frame.content.limit)
            hidden = continued(ordinary.color, radius, self._backdrop, outer, inside, frame)
        if self.keeps:
            self._hidden[position] = hidden
            self._taken[position] += 1
            if self._taken[position] == self._groups:
                del self._hidden[position]
        return RegionSurfaces(shown, hidden)

    def prepare(self) -> None:
        """Find now what is found once for the whole frame."""
        _ = self._backdrop

    @cached_property
    def _frame(self) -> SharedFrame:
        """The frame of all channels, if anything is continued."""
        return self._made()

    @cached_property
    def _backdrop(self) -> Backdrop:
        """The frame of all channels at low resolution."""
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


class SurfacesOfColors(NamedTuple):
    """The surfaces of some colours."""

    shared: SharedSurfaces  # those of all colours
    channels: list[int]  # the numbers of the colours
    px: Scalar  # px that are added to their radii

    def at(self, outer: Box, inside: Box) -> RegionSurfaces:
        """As those of all colours."""
        shown, hidden = self.shared.at(outer, inside)
        _, layer, radius = shown.fringe
        fringe = shown.fringe._replace(
            layer=layer[:, [*self.channels, layer.shape[1] - 1]], signed_radius=radius + self.px
        )
        shown = shown._replace(color=shown.color[self.channels], fringe=fringe)
        if hidden is None:
            return RegionSurfaces(shown, None)
        color, radius, mask = hidden
        return RegionSurfaces(shown, HiddenLayer(color[self.channels], radius + self.px, mask))


def taken_apart(
    pixels: Tensor,  # [C, h, w] in the rectangle `outer`
    signed_radius: Tensor,  # [h, w] px
    matte: Pixels | None,  # [H, W], the coverage of a subject; None if it is not known
    outer: Box,
    frame: SharedFrame,
) -> Unmixed:
    """The visible surfaces of a region, mixed pixels taken apart where surfaces hide others."""
    if not (frame.content.edges and frame.quality.unmixes):
        return whole(pixels, signed_radius)
    coverage = None if matte is None else outer.of(matte).to(signed_radius)
    return unmixed(pixels, signed_radius, frame.content.limit, coverage)


def continued(
    color: Tensor,  # [C, h, w] of the visible surface in the rectangle `outer`
    signed_radius: Tensor,  # [h, w] px
    backdrop: Backdrop,
    outer: Box,
    inside: Box,
    frame: SharedFrame,
) -> HiddenLayer | None:
    """The hidden layer of a region; None without any."""
    level = frame.slices.invented.level
    return hidden_layer(color, signed_radius, backdrop, outer, inside, level=level)

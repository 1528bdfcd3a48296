"""What all regions of one picture share: slices, windows, grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch

from defocus_core.blur.kernel_bank import Window
from defocus_core.images.box import Box
from defocus_core.images.tiling import Grid
from defocus_core.layers.octaves import Turns
from defocus_core.layers.quality import Quality
from defocus_core.optics.aperture import Aperture, Part

# Px around a pixel that decide what its own surface is: soft edges, mixed pixels, slopes.
NEIGHBOURHOOD = 24


class FillSlices(NamedTuple):
    """How the slices of hidden surfaces are blurred.

    Attributes:
        stride: They are every one (1) or every other (2) of those of the frame.
        halvings: How many times resolution is halved before anything else.
        windows: Of all slices of the frame, in cells of this resolution.
        layers: The number of the layer of each: all of a window, and of one octave of blur.
        octaves: For each layer this octave.
        cells: Cells of this resolution that light of each spreads at most.
        reaches: Px of the frame that each spreads.
    """

    stride: int
    halvings: int
    windows: list[Window]
    layers: list[int]
    octaves: dict[int, int]
    cells: list[int]
    reaches: list[int]


@dataclass(frozen=True)
class Frame:
    """What all regions of one picture share.

    Attributes:
        size: (height, width) in px.
        grid: Its tiles.
        aperture: The pupil.
        quality: Spacing of slices and the like.
        parts: Of the aperture: first those of the centre, then those of left and right if these
            are composited besides.
        centre: How many are the centre's.
        groups: The same as slices of the parts.
        weights: The share of the aperture that each part is.
        left_right: Whether left and right are wanted.
        signed: Whether pixels are negative (colours outside the gamut).
        dtype: To compute in.
        limit: What exceeds this is a highlight.
        radii: Of the slices in px.
        reaches: Px that each spreads.
        layers: The number of the layer of each, ascending.
        turns: When it is the turn of what is hidden, between these layers.
        windows: Of each.
        known: How what is known to be hidden is blurred.
        invented: How what is invented is.
        edges: Whether surfaces hide others.
        quantised: Whether depth had few levels: small gaps between surfaces may be its errors.
        tilted: Whether surfaces may be tilted.
        margin: Px around a region that its pixels depend on.
        sharp: Radius in px up to which pixels are in focus; None where slices were asked for.
        ends: Least and greatest signed radius in px of what is visible.
    """

    size: tuple[int, int]
    grid: Grid
    aperture: Aperture
    quality: Quality
    parts: list[Part]
    centre: int
    groups: list[slice]
    weights: list[float]
    left_right: bool
    signed: bool
    dtype: torch.dtype
    limit: float
    radii: tuple[float, ...]
    reaches: list[int]
    layers: list[int]
    turns: Turns
    windows: list[Window]
    known: FillSlices
    invented: FillSlices
    edges: bool
    quantised: bool
    tilted: bool
    margin: int
    sharp: float | None
    ends: tuple[float, float]

    @property
    def box(self) -> Box:
        """The whole frame."""
        return Box(0, 0, *self.size)

    @property
    def farthest(self) -> int:
        """Px that light spreads at most."""
        reaches: list[int] = [*self.reaches, *(self.invented.reaches if self.edges else ())]
        return max(reaches)

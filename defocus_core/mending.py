"""What is mended of depth before it is rendered, and in which order."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

from defocus_core.antialiased import AROUND as AROUND_AVERAGES
from defocus_core.antialiased import without_averages
from defocus_core.mended import Mended
from defocus_core.ramps import AROUND as AROUND_RAMPS
from defocus_core.ramps import without_ramps
from defocus_core.soft_edges import AROUND as AROUND_SOFT_EDGES
from defocus_core.soft_edges import with_hard_edges
from defocus_core.source import Pixels
from defocus_core.terraces import AROUND as AROUND_TERRACES
from defocus_core.terraces import without_terraces


class Mending(NamedTuple):
    """What a picture's depth needs.

    Attributes:
        antialiased: Where pixels of edges are averages of distance, the signed radius in px of
            what is infinitely far, where of disparity, infinity; None where they are not.
        ramps: Whether ramps of depth are to be made steps.
        soft_edges: Slope in px per px of edges that are soft, to be put where colours have theirs;
            None where most are hard.
        terraces: Whether small steps are to be made slopes.
    """

    antialiased: float | None = None
    ramps: bool = False
    soft_edges: float | None = None
    terraces: bool = False

    @property
    def is_told(self) -> bool:
        """Whether depth is not what a renderer would write, pixel by pixel."""
        return self.has_edges or self.terraces

    @property
    def has_edges(self) -> bool:
        """Whether edges are put where they belong: ramps beside are surfaces then."""
        return self.antialiased is not None or self.soft_edges is not None

    def mended(self, signed_radius: Pixels, pixels: Pixels) -> Pixels:
        """Radii [H, W] px of a picture [C, H, W], changed in each window as it is cut."""
        if self.antialiased is not None:
            mend = partial(without_averages, infinity=self.antialiased)
            signed_radius = Mended(signed_radius, mend, AROUND_AVERAGES)
        elif self.soft_edges:
            mend = partial(with_hard_edges, steep=self.soft_edges)
            signed_radius = Mended(signed_radius, mend, AROUND_SOFT_EDGES, pixels)
        elif self.ramps:
            signed_radius = Mended(signed_radius, without_ramps, AROUND_RAMPS)
        if self.terraces:
            signed_radius = Mended(signed_radius, without_terraces, AROUND_TERRACES)
        return signed_radius

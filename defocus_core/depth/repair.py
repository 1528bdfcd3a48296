"""What is mended of depth before it is rendered, and in which order."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

from defocus_core.depth.antialiased import AROUND as AROUND_AVERAGES
from defocus_core.depth.antialiased import without_averages
from defocus_core.depth.noise import AROUND as AROUND_NOISE
from defocus_core.depth.noise import noise_of, without_noise
from defocus_core.depth.quantised import AROUND as AROUND_TERRACES
from defocus_core.depth.quantised import without_terraces
from defocus_core.depth.ramps import AROUND as AROUND_RAMPS
from defocus_core.depth.ramps import without_ramps
from defocus_core.depth.soft_edges import AROUND as AROUND_SOFT_EDGES
from defocus_core.depth.soft_edges import with_hard_edges
from defocus_core.images.derived import Mended, held
from defocus_core.images.source import Pixels


class Mending(NamedTuple):
    """What a picture's depth needs.

    Attributes:
        antialiased: Where pixels of edges are averages of distance, the signed radius in px of
            what is infinitely far, where of disparity, infinity; None where they are not.
        ramps: Whether ramps of depth are to be made steps.
        soft_edges: Slope in px per px of edges that are soft, to be put where colours have theirs;
            None where most are hard.
        terraces: Whether small steps are to be made slopes.
        noise: Standard deviation in px of noise that was taken out before all else; None if there
            was none.
    """

    antialiased: float | None = None
    ramps: bool = False
    soft_edges: float | None = None
    terraces: bool = False
    noise: float | None = None

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


def denoised(signed_radius: Pixels, threads: int, *, hold: bool) -> tuple[Pixels, float | None]:
    """Radii [H, W] px without noise, before anything else is seen in them, and how much it was.

    Args:
        signed_radius: [H, W] px, as given.
        threads: Bands that are computed at once.
        hold: Whether there is room for them.

    Returns:
        The radii, and the standard deviation in px; as they are and None if there is no noise.
    """
    noise = noise_of(signed_radius)
    if noise is None:
        return signed_radius, None
    quiet = Mended(signed_radius, partial(without_noise, noise=noise), AROUND_NOISE)
    return held(quiet, signed_radius, threads=threads, hold=hold), noise

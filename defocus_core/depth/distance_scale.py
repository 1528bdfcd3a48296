"""Distance in the unit of a radius: the scale in which a network of metric depth softens edges.

Radii are affine in disparity. An edge that is soft in distance is lopsided in radius: steep on its
near side, as if a hard edge stood there, and flat on its far side.
"""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from defocus_core.tensors.bands import Scalar

# Radii less than this many px from the radius of infinity count as infinitely far.
INFINITE = 2.0**-12


class DistanceScale(NamedTuple):
    """The distances of a frame, as px that span the same range as its radii."""

    infinity: float  # signed radius in px of what is infinitely far
    nearest: float  # px of radius between infinity and the nearest surface of the frame
    farthest: float  # px of radius between infinity and its farthest surface

    def of(self, radii: Tensor) -> Tensor:
        """Distances of radii [H, W] px; 0 px for the nearest surface."""
        by_distance = self.nearest * self.farthest
        distance = distance_of(radii, self.infinity)
        return distance * by_distance - self.farthest

    def times(self, factor: float) -> DistanceScale:
        """The scale of the same distances where all radii are so many times as great."""
        return DistanceScale(*(px * factor for px in self))

    def through(self, scale: float, infinity: float) -> DistanceScale:
        """The scale of the same distances for a lens of a greater scale and another infinity."""
        return DistanceScale(infinity, self.nearest * scale, self.farthest * scale)


def distance_scale(minimum: float, maximum: float, infinity: float | None) -> DistanceScale | None:
    """The scale of distance of a frame.

    `minimum`: least radius in px; `maximum`: greatest radius in px; `infinity`: signed radius in px
    of what is infinitely far; None if that is not known. Returns none if distance is not known,
    infinite somewhere, or the same everywhere.
    """
    if infinity is None or not INFINITE < infinity - maximum < infinity - minimum:
        return None
    return DistanceScale(infinity, infinity - minimum, infinity - maximum)


def distance_of(radii: Tensor, infinity: Scalar) -> Tensor:
    """Distances of radii in px, as 1 over px of radius from infinity."""
    return (infinity - radii).clamp(min=INFINITE).reciprocal()


def radius_from_relative_disparity(
    disparity: Tensor, focus: float, max_radius: float, reach: float | None = None
) -> Tensor:
    """Signed radius of the circle of confusion by disparity of unknown scale and offset.

    The radius of a thin lens is linear in disparity: r = R (d_f − d) / max |d_f − d|.

    Args:
        disparity: d, any shape, greater nearer; of any scale, with any offset.
        focus: d_f, what is in focus.
        max_radius: R, of the most blurred pixel, px.
        reach: max |d_f − d|; None for that of `disparity`.

    Returns:
        Radii of the same shape in px, negative nearer than the focus; 0 where all are in focus.
    """
    apart = focus - disparity
    maximum = float(apart.detach().abs().amax()) if reach is None else reach
    return apart * (max_radius / maximum if maximum else 0.0)

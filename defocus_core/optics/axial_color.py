"""Axial colour: light of other wavelengths is in focus before or behind the sensor."""

from __future__ import annotations

from defocus_core.optics.outline import Scalar
from defocus_core.optics.thin_lens import ThinLens


def color_offset(lens: ThinLens, shift: Scalar) -> Scalar:
    """The px by which the radii of a colour differ from those that the lens is focused for.

    The image of a point lies at v' behind the lens, and its circle on a sensor at v is
    A (v - v') / v' across, signed. A colour whose images lie farther behind by a shift has circles
    that are smaller by A shift / v at any depth. Beyond focus its disc is smaller, so that the
    others make its rim; nearer than focus it is larger, and makes the rim.

    Args:
        lens: The lens, with its focus.
        shift: How much farther behind the lens the colour is in focus, in mm.

    Returns:
        The offset in px of signed radius; gradients flow to the shift and the lens.
    """
    distance: Scalar = -lens.foc_dist
    image_distance = 1 / (1 / lens.foclen - 1 / distance)
    return -lens.foclen / lens.fnum * shift / (2 * lens.pixel_size * image_distance)

"""Axial colour: light of other wavelengths is in focus before or behind the sensor."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from defocus_core.optics.thin_lens import ThinLens
from defocus_core.tensors.validation import Scalar, number


def color_offset(lens: ThinLens, shift: Scalar) -> Scalar:
    """The px to add to a lens's signed radii for a colour that is focused at another distance.

    The image of a point lies at v' behind the lens; on a sensor at v its circle has the signed
    diameter A (v - v') / v', where A is the width of the aperture. If the images of a colour lie
    farther behind the lens by a shift, its signed diameters are smaller by A shift / v at any
    depth. Beyond focus its disc is smaller than those of the other colours, which then tint the
    rim; nearer than focus it is larger and tints the rim itself.

    Args:
        lens: The lens, with its focus.
        shift: How much farther behind the lens the colour is in focus, in mm.

    Returns:
        The offset in px of signed radius; gradients flow to the shift and the lens.
    """
    distance: Scalar = -lens.foc_dist
    image_distance = 1 / (1 / lens.foclen - 1 / distance)
    return -lens.foclen / lens.fnum * shift / (2 * lens.pixel_size * image_distance)


def channel_groups(
    offsets: Sequence[Scalar] | None, channels: int
) -> list[tuple[list[int], Scalar]]:
    """Group channels with equal offsets, which are rendered together.

    Args:
        offsets: px to add to the signed radii, a number for each channel; None for no offsets.
        channels: The number of channels.

    Returns:
        (indices of channels, their offset) for each group. An offset in a tensor has its own group,
        so that its gradient is its own.

    Raises:
        ValueError: If there is not one offset for each channel.
    """
    if offsets is None:
        return [(list(range(channels)), 0.0)]
    if len(offsets) != channels:
        problem = f"color_offsets must be one number in px for each of {channels} channels"
        raise ValueError(f"{problem}, got {len(offsets)}; 0 leaves a channel as it is")
    together: dict[float, tuple[list[int], Scalar]] = {}
    for c, px in enumerate(offsets):
        value = number("color_offsets", px, "in px of radius")
        key = value if not isinstance(px, Tensor) else -1.0 - id(px)  # a group for each
        together.setdefault(key, ([], px))[0].append(c)
    return list(together.values())

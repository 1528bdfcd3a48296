"""Noise of depth averaged over time: where a surface is still, neighbours measure it again.

A pixel is averaged with the pixel of a neighbour where its surface has moved to, unless colours or
radii around it tell that this is another surface, or that it has come nearer. Means over a few
pixels tell, for noise leaves them alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from defocus_core.sequences.motion import Frame, alike, approached, nearest_pixels, positions

# Distance in px around a pixel that is compared; greatest difference of its mean radius and of its
# own, in deviations.
_BY, _MEAN, _OWN = 2, 4.0, 4.0


def temporal_mean(frame: Frame, neighbours: Iterable[Frame], noise: float) -> tuple[Tensor, Tensor]:
    """Radii of a frame averaged with those of its neighbours where the scene is still.

    Args:
        frame: The frame; its motion is not used.
        neighbours: Other frames of the scene, each through the lens of the frame, and with the
            motion [2, H, W] px from the frame to it; none where nothing moves.
        noise: Standard deviation in px of the noise of the radii.

    Returns:
        [H, W] px, and the number [H, W] of frames that were averaged.
    """
    radius = frame.signed_radius
    total, count = torch.zeros_like(radius), torch.ones_like(radius)
    side = 2 * _BY + 1
    mean_limit, own_limit = (k * math.sqrt(2) * noise for k in (_MEAN / side, _OWN))
    color = _around(frame.image)
    for neighbour in neighbours:
        image, other, inside = _fetched(neighbour, frame)
        still = alike(_around(image), color) & inside
        off = other - radius
        still &= off.abs() <= own_limit
        near = torch.where(off.abs() <= own_limit, off, 0.0)
        still &= _around(near).abs() <= mean_limit
        total += torch.where(still, off, 0.0)
        count += still
    return radius + total / count, count


def _fetched(neighbour: Frame, frame: Frame) -> tuple[Tensor, Tensor, Tensor | bool]:
    """Colours and radii of a neighbour where the surfaces of the frame are in it."""
    image, radius, motion = neighbour
    if motion is None:
        return image, radius, True
    size = radius.shape[0], radius.shape[1]
    index, inside = nearest_pixels(positions(size, motion) + motion, size)
    color = image.flatten(1)[:, index]
    same = inside & alike(color, frame.image)
    there = torch.where(same, frame.signed_radius, torch.nan)
    other, _ = approached(radius.flatten()[index.flatten()], there.flatten())
    return color, other.view(size), inside


def _around(values: Tensor) -> Tensor:
    """The mean of values [..., H, W] over the square around each pixel, cut at the borders."""
    flat = values.reshape(1, -1, *values.shape[-2:])
    means = avg_pool2d(flat, 2 * _BY + 1, 1, _BY, count_include_pad=False)
    return means.reshape(values.shape)

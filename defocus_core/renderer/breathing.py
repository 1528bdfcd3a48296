"""Breathing: what is blurred lies farther out, or farther in, than the sharp picture shows it.

The magnification of a lens changes with its focus: a point at signed radius r is drawn about b r x,
x being its place from the middle of the frame in half widths, and b the breathing.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

_ROUNDS = 2  # in which a pixel finds the radius that brought it here


def breathed(image: Tensor, signed_radius: Tensor, breathing: float) -> tuple[Tensor, Tensor]:
    """A picture and its radii, each pixel at the place where its blur is drawn.

    `image`: [C, H, W]; `signed_radius`: [H, W] px; `breathing`: px outwards, half a width from the
    middle, of a radius of 1 px.
    """
    if not breathing:
        return image, signed_radius
    height, width = signed_radius.shape
    x = (2 * torch.arange(width).to(signed_radius) + 1) / width - 1
    y = (2 * torch.arange(height).to(signed_radius) + 1) / height - 1
    position = torch.stack(torch.meshgrid(y, x, indexing="ij")[::-1], -1)  # [H, W, 2], x and y
    radius = signed_radius
    for _ in range(_ROUNDS):
        # a displacement is in proportion to the place: the same scale along both axes
        there = position * (1 - breathing * radius * (2 / width))[..., None]
        radius = _sampled(signed_radius[None], there, "nearest")[0]
    return _sampled(image, there, "bilinear"), radius  # what is moved is blurred, too


def _sampled(values: Tensor, positions: Tensor, mode: str) -> Tensor:
    """[C, H, W] at places [H, W, 2] from -1 to 1."""
    return grid_sample(
        values[None], positions[None], mode, padding_mode="border", align_corners=False
    )[0]

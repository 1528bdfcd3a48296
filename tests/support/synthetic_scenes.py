"""Synthetic scenes to time, of several kinds, each of which needs other steps of rendering.

A scene is a picture with the signed CoC radius in px of each pixel, float32 on the CPU, always the
same. Shapes are shares of the frame, so that times at two sizes can be compared; only lights grow
in number, not in size.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

# Frame pixels per light, and the brightness of a light; white is 1.
_PIXELS_PER_LIGHT = 4000
_LIGHT = 200.0
# Largest CoC radius in px that counts as in focus.
_IN_FOCUS = 0.15
# Width of a wire as a share of the frame's, and the least in px.
_WIRE, _MIN_WIRE = 1 / 160, 3


class Scenery(NamedTuple):
    """A picture [3, H, W], linear light, and the signed radius [H, W] px of its pixels."""

    image: Tensor
    signed_radius: Tensor


def scenery(kind: str, height: int, width: int, radius: float) -> Scenery:
    """The scene of a kind, of height and width in px, blurred by `radius` px at most."""
    y = (torch.arange(height) + 0.5)[:, None] / height
    x = (torch.arange(width) + 0.5)[None, :] / width
    signed_radius = KINDS[kind](x, y, radius).expand(height, width)
    image = _texture(height, width)
    if kind == "lights":
        image = _lit(0.2 * image)
    return Scenery(image, signed_radius.contiguous())


def _cards(x: Tensor, y: Tensor, r: float) -> Tensor:
    """Cards that overlap each other before a background, on both sides of the focus."""
    radius = torch.full_like(x * y, r)
    for k in range(10):  # from the farthest to the nearest
        across, down = (0.13 + 0.618 * k) % 0.85, (0.07 + 0.371 * k) % 0.75
        on_card = (x > across) & (x < across + 0.22) & (y > down) & (y < down + 0.35)
        radius = torch.where(on_card, r * (0.8 - 0.2 * k), radius)
    return radius


def _wires(x: Tensor, y: Tensor) -> Tensor:
    """[H, W] bool: a fence of upright and of level wires."""
    width = x.shape[1]
    thick = max(_MIN_WIRE, round(width * _WIRE)) / width
    rows = y.shape[0]
    tall = max(_MIN_WIRE, round(width * _WIRE)) / rows
    return ((x * 8) % 1 < 8 * thick) | ((y * 4) % 1 < 4 * tall)


# The signed radius by name of the kind, of places x and y and the greatest radius.
KINDS: dict[str, Callable[[Tensor, Tensor, float], Tensor]] = {
    "focus": lambda x, y, r: _IN_FOCUS * (1 - 2 * y) + 0 * x,  # a floor within the depth of field
    "plane": lambda x, y, r: torch.full_like(x * y, r),
    "floor": lambda x, y, r: r * (1 - 2 * y) + 0 * x,  # through the focus: linear in y
    "cards": _cards,
    "thin": lambda x, y, r: torch.where(_wires(x, y), -r, r * (1 - y)),  # close wires, and a floor
    "lights": lambda x, y, r: torch.where(_wires(x, y), 0.0, r),  # far away, behind wires in focus
    "most": lambda x, y, r: r * (1 - 5 * y).clamp(min=0) + 0 * x,  # four fifths are in focus
}


def _texture(height: int, width: int) -> Tensor:
    """Waves of colour with fine grain in [0.05, 0.95]: [3, H, W]."""
    y, x = torch.arange(height)[:, None] / width, torch.arange(width) / width
    turns = torch.stack([29 * x + 9 * y, 31 * y - 12 * x, 21 * (x + y)])
    grain = torch.rand((1, height, width), generator=torch.Generator().manual_seed(0))
    return 0.5 + 0.3 * torch.sin(2 * math.pi * turns) + 0.3 * (grain - 0.5)


def _lit(image: Tensor) -> Tensor:
    """A picture [3, H, W] with lights of a pixel each, as many as fit its size."""
    height, width = image.shape[1:]
    count = max(1, height * width // _PIXELS_PER_LIGHT)
    generator = torch.Generator().manual_seed(1)
    at = torch.randint(height * width, (count,), generator=generator)
    image = image.clone()
    image.flatten(1)[:, at] = _LIGHT
    return image

"""Highlights: the few brightest pixels, separated from the picture.

Almost all energy of a scene with lights is in few pixels. Layers would fade the discs that a wire
before them clips, and a transform would spread rounding noise of 1e-7 of their brightness over
everything. So the light of such a pixel is taken out of the layers and drawn as a disc of its own.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.images.order_statistics import Ranks
from defocus_core.images.sparse_masks import exceeding, places_of
from defocus_core.images.tiling import BLOCK
from defocus_core.layers.matting import Unmixed

# A highlight is brighter than this many times the brightest of all but one pixel in 200.
_BRIGHTER = 2.0
_ORDINARY = 0.995


class Highlights(NamedTuple):
    """Pixels to be drawn one by one.

    Attributes:
        at: [n, 2] rows and columns.
        light: [n, C] their colours.
        signed_radius: [n] px.
    """

    at: Tensor
    light: Tensor
    signed_radius: Tensor


def threshold(brightness: Ranks, most: float) -> float:
    """The brightness above which a pixel is a highlight.

    Args:
        brightness: The brightness of all pixels of the frame.
        most: The greatest brightness.
    """
    most = max(most, 0.0)  # negative light is never a highlight, nor twice as much of it a bound
    rank = max(1, int(_ORDINARY * brightness.total))
    if brightness.about(rank)[0] >= most / _BRIGHTER:
        return most
    ordinary = max(brightness.exactly(rank), 0.0)
    return most if ordinary >= most / _BRIGHTER else _BRIGHTER * ordinary


def reached_by(farthest: int) -> int:
    """Px around a region on which its highlights depend, for a greatest blur of `farthest` px.

    The disc of a highlight beside the region reaches into it, clipped by a surface before it.
    """
    return 3 * farthest + 2 * BLOCK


def split(pixels: Tensor, signed_radius: Tensor, limit: float) -> tuple[Tensor, Highlights | None]:
    """Separate highlights from [C, H, W] pixels; in the rest they are black.

    Args:
        pixels: [C, H, W].
        signed_radius: [H, W] px.
        limit: The `threshold` of the frame.
    """
    if float(pixels.detach().amax()) <= limit:
        return pixels, None
    brightness = pixels.detach().amax(0)
    bright = exceeding(brightness, limit)
    at = places_of(bright)
    rows, columns = at.unbind(-1)
    rest = torch.where(bright, 0.0, pixels)
    return rest, Highlights(at, pixels[:, rows, columns].T, signed_radius[rows, columns])


def split_samples(
    own: Unmixed, signed_radius: Tensor, limit: float
) -> tuple[Unmixed, Highlights | None]:
    """Separate highlights from samples; their alpha, the last channel, stays.

    Args:
        own: [C + 1, H, W] colours and alpha, with their coverage and fringe.
        signed_radius: [H, W] px of the samples that are no fringe.
        limit: The `threshold` of the frame.
    """
    shown = own.color[:-1] if own.coverage is None else own.color[:-1] * own.coverage
    bright = shown.detach().amax(0) > limit
    bright_fringe = own.fringe.layer[:, :-2].detach().amax(1) > limit
    if not bool(bright.any() | bright_fringe.any()):
        return own, None
    at, number = places_of(bright), torch.nonzero(bright_fringe)[:, 0]
    rows, columns = at.unbind(-1)
    light = torch.cat([shown[:, rows, columns].T, own.fringe.layer[number, :-2]])
    found = Highlights(
        torch.cat([at, own.fringe.at[number]]),
        torch.cat([light, torch.zeros_like(light[:, :1])], 1),
        torch.cat([signed_radius[rows, columns], own.fringe.signed_radius[number]]),
    )
    color = torch.cat([torch.where(bright, 0.0, own.color[:-1]), own.color[-1:]])
    layer = own.fringe.layer
    layer = torch.cat([torch.where(bright_fringe[:, None], 0.0, layer[:, :-2]), layer[:, -2:]], 1)
    return own._replace(color=color, fringe=own.fringe._replace(layer=layer)), found

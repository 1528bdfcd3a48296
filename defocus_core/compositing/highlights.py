"""Highlights: the few brightest pixels, taken apart from the picture.

Almost all energy of a scene with lights is in few pixels. Layers would fade a disc that a wire in
front clips, and a transform would spread rounding noise of 1e-7 of its brightness over the whole
picture. So the excess of such a pixel over its surroundings is taken out of the layers, to be drawn
as a disc of its own.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.images.order_statistics import Ranks
from defocus_core.images.sparse_masks import exceeding, places_of
from defocus_core.images.tiling import BLOCK

# A highlight is brighter than _BRIGHTER times the brightness that _ORDINARY of all pixels do not
# exceed.
_BRIGHTER = 2.0
_ORDINARY = 0.995
# Spacings in px of the five by five pixels whose mean is the surroundings, from close to wide. A
# highlight wider than the widest has black surroundings.
_STEPS = (1, 3, 8, 24)


class Highlights(NamedTuple):
    """Pixels to be drawn one by one.

    Attributes:
        at: [n, 2] rows and columns.
        excess: [n, C] colour above that of their surroundings.
        signed_radius: [n] px.
    """

    at: Tensor
    excess: Tensor
    signed_radius: Tensor


def threshold(brightness: Ranks, most: float) -> float:
    """The brightness that a highlight exceeds.

    Args:
        brightness: Ranks of the brightness of all pixels of the frame.
        most: The greatest brightness.
    """
    rank = max(1, int(_ORDINARY * brightness.total))
    if brightness.about(rank)[0] >= most / _BRIGHTER:
        return most
    ordinary = brightness.exactly(rank)
    return most if ordinary >= most / _BRIGHTER else _BRIGHTER * ordinary


def reached_by(farthest: int) -> int:
    """Px around a region that its discs depend on, for a greatest blur radius in px.

    They hold the lights beside it, the surfaces that occlude them, and their surroundings.
    """
    return max(3 * farthest + 2 * BLOCK, farthest + 2 * max(_STEPS))


def split(pixels: Tensor, signed_radius: Tensor, limit: float) -> tuple[Tensor, Highlights | None]:
    """Separate highlights from [C, H, W] pixels; the rest continues their surroundings.

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
    around = _surroundings(pixels, ~bright, at)
    rows, columns = at.unbind(-1)
    rest = pixels.clone()
    rest[:, rows, columns] = around.T
    excess = pixels[:, rows, columns].T - around
    return rest, Highlights(at, excess, signed_radius[rows, columns])


def _surroundings(pixels: Tensor, ordinary: Tensor, at: Tensor) -> Tensor:
    """The mean colour [n, C] of ordinary pixels around others at [n, 2]; black where none is near.

    They are the first square of five by five pixels that holds any, from close to wide spacing.
    """
    H, W = ordinary.shape
    around = pixels.new_zeros(len(at), len(pixels))
    remaining = torch.arange(len(at), device=at.device)
    side = torch.arange(-2, 3, device=at.device)
    square = torch.stack(torch.meshgrid(side, side, indexing="ij"), -1).reshape(-1, 1, 2)
    for step in _STEPS:
        place = at[remaining] + step * square
        row, column = place[..., 0], place[..., 1]
        inside = (row >= 0) & (row < H) & (column >= 0) & (column < W)
        index = row.clamp(0, H - 1) * W + column.clamp(0, W - 1)
        counts = (ordinary.flatten()[index] & inside).to(pixels.dtype)
        number = counts.sum(0)
        found = torch.nonzero(number)[:, 0]
        colors = pixels.flatten(1)[:, index[:, found].flatten()].reshape(
            len(pixels), -1, len(found)
        )
        mean = (colors * counts[:, found]).sum(1) / number[found]
        around = around.index_copy(0, remaining[found], mean.T)
        remaining = remaining[number == 0]
        if not len(remaining):
            break
    return around

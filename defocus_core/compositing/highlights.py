"""Highlights: the few brightest pixels, taken apart from the picture.

Almost all energy of a scene with lights is in few pixels. Layers would fade the discs that a wire
before them clips, and a transform would spread rounding noise of 1e-7 of their brightness over
everything. So what such a pixel has above its surroundings is taken out of the layers, to be drawn
as a disc of its own.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.images.order_statistics import Ranks
from defocus_core.images.sparse_masks import exceeding, places_of
from defocus_core.images.tiling import BLOCK

# A highlight is brighter than this many times the brightest of all but one pixel in 200.
_BRIGHTER = 2.0
_ORDINARY = 0.995
# Px between the pixels of a square of five by five in which surroundings are looked for: close ones
# first. A highlight wider than the widest stands on black.
_STEPS = (1, 3, 8, 24)


class Highlights(NamedTuple):
    """Pixels to be drawn one by one.

    Attributes:
        at: [n, 2] rows and columns.
        excess: [n, C] what they have above their surroundings.
        signed_radius: [n] px.
    """

    at: Tensor
    excess: Tensor
    signed_radius: Tensor


def threshold(brightness: Ranks, most: float) -> float:
    """What a pixel must exceed to be a highlight.

    Args:
        brightness: Of all pixels of the frame.
        most: The greatest.
    """
    rank = max(1, int(_ORDINARY * brightness.total))
    if brightness.about(rank)[0] >= most / _BRIGHTER:
        return most
    ordinary = brightness.exactly(rank)
    return most if ordinary >= most / _BRIGHTER else _BRIGHTER * ordinary


def reached_by(farthest: int) -> int:
    """Px around a region that lights in it depend on, where light spreads so many px at most.

    A light beside it, what stands before that light, and what surrounds it.
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

    Of squares of five by five pixels that lie ever farther apart, the first that holds any.
    """
    H, W = ordinary.shape
    around = pixels.new_zeros(len(at), len(pixels))
    left = torch.arange(len(at), device=at.device)
    side = torch.arange(-2, 3, device=at.device)
    square = torch.stack(torch.meshgrid(side, side, indexing="ij"), -1).reshape(-1, 1, 2)
    for step in _STEPS:
        place = at[left] + step * square
        row, column = place[..., 0], place[..., 1]
        inside = (row >= 0) & (row < H) & (column >= 0) & (column < W)
        index = row.clamp(0, H - 1) * W + column.clamp(0, W - 1)
        counts = (ordinary.flatten()[index] & inside).to(pixels.dtype)
        number = counts.sum(0)
        some = torch.nonzero(number)[:, 0]
        colors = pixels.flatten(1)[:, index[:, some].flatten()].reshape(len(pixels), -1, len(some))
        mean = (colors * counts[:, some]).sum(1) / number[some]
        around = around.index_copy(0, left[some], mean.T)
        left = left[number == 0]
        if not len(left):
            break
    return around

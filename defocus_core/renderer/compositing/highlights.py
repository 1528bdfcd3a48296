"""Highlights: the few brightest pixels, separated from the picture.

Almost all energy of a scene with lights is in few pixels. Layers would fade the discs that a wire
before them clips, and a transform would spread rounding noise of 1e-7 of their brightness over
everything. So the light of such a pixel is taken out of the layers and drawn as a disc of its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.matting import Unmixed
from defocus_core.renderer.layers.samples import Sampled
from defocus_core.tensors.box import BLOCK
from defocus_core.tensors.order_statistics import Ranks
from defocus_core.tensors.sparse_masks import positions_of

# A highlight is brighter than this many times the brightest of all but one pixel in 200.
_BRIGHTER = 2.0
_ORDINARY = 0.995
# Discs as large as so many frames, all together, are drawn one by one at most, brightest first; but
# all that are so many times as bright as this pixel, for their rounding noise would be seen.
_FRAMES, _ALWAYS = 8.0, 100.0


class Highlights(NamedTuple):
    """Pixels to be drawn one by one."""

    at: Tensor  # [n, 2] rows and columns
    light: Tensor  # [n, C] their colours
    signed_radius: Tensor  # [n] px


def threshold(brightness: Ranks, maximum: float, radius: float) -> float:
    """The brightness above which a pixel is a highlight.

    `radius`: the greatest radius of blur in px.
    """
    # negative light is never a highlight, nor twice as much of it a bound
    maximum = max(maximum, 0.0)
    rank = max(1, int(_ORDINARY * brightness.total))
    if brightness.about(rank)[0] >= maximum / _BRIGHTER:
        return maximum
    ordinary = max(brightness.exactly(rank), 0.0)
    if ordinary >= maximum / _BRIGHTER:
        return maximum
    drawn = max(1, int(_FRAMES * brightness.total / (math.pi * max(radius, 1.0) ** 2)))
    beyond = brightness.about(max(1, brightness.total - drawn))[1]
    return max(_BRIGHTER * ordinary, min(beyond, _ALWAYS * ordinary, maximum))


def reached_by(farthest: int) -> int:
    """Px around a region on which its highlights depend, for a greatest blur of `farthest` px.

    The disc of a highlight beside the region reaches into it, clipped by a surface before it.
    """
    return 3 * farthest + 2 * BLOCK


def split(
    unmixed: Unmixed, signed_radius: Tensor, limit: float
) -> tuple[Unmixed, Highlights | None]:
    """Separate highlights from pixels taken apart; in the rest they are black.

    `unmixed`: of colours [C, H, W]; `signed_radius`: [H, W] px.
    """
    samples, highlights = split_samples(
        Sampled(unmixed, []), len(unmixed.color), signed_radius, limit
    )
    if highlights is not None:
        highlights = highlights._replace(light=highlights.light[:, :-1])
    return samples.nearest, highlights


def split_samples(
    samples: Sampled, channels: int, signed_radius: Tensor, limit: float
) -> tuple[Sampled, Highlights | None]:
    """Separate highlights from samples; their alpha stays, and the light has none.

    `samples`: of colours [C, H, W], or of colours and alpha; `signed_radius`: [H, W] px of the
    nearest samples.
    """
    nearest, others = samples
    shown = nearest.color[:channels]
    shown = shown if nearest.coverage is None else shown * nearest.coverage
    layer = nearest.fringe.layer
    bright = [shown.detach().amax(0) > limit]
    bright += [each.detach()[:channels].amax(0) > limit for each, _ in others]
    listed = layer.detach()[:, :channels].amax(1) > limit
    if not bool(listed.any()) and not any(bool(each.any()) for each in bright):
        return samples, None
    dark = _darkened(nearest.color, channels, bright[0], 0)
    rest = _darkened(layer, channels, listed[:, None], 1)
    farther = [
        (_darkened(each, channels, where, 0), radius)
        for where, (each, radius) in zip(bright[1:], others, strict=True)
    ]
    drawn = [
        (nearest.fringe.at[listed], layer[listed, :channels], nearest.fringe.signed_radius[listed])
    ]
    colors = [(shown, signed_radius), *((each[:channels], radius) for each, radius in others)]
    for where, (color, radius) in zip(bright, colors, strict=True):
        at = positions_of(where)
        row, column = at.unbind(1)
        drawn.append((at, color[:, row, column].T, radius[row, column]))
    at, light, radius = (torch.cat(each) for each in zip(*drawn, strict=True))
    light = torch.cat([light, torch.zeros_like(light[:, :1])], 1)
    nearest = nearest._replace(color=dark, fringe=nearest.fringe._replace(layer=rest))
    return Sampled(nearest, farther), Highlights(at, light, radius)


def _darkened(colors: Tensor, channels: int, where: Tensor, dim: int) -> Tensor:
    """Colours whose first channels along a dimension are 0 where a mask holds."""
    light, rest = colors.tensor_split([channels], dim)
    return torch.cat([torch.where(where, 0.0, light), rest], dim)

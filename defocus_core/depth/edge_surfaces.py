"""The two surfaces beside pixels on a depth edge: their colours, and the share of the nearer one.

In the way of Bayesian matting (Chuang et al. 2001) both surfaces have a mean and a variance of
colour beside the edge. A share is expected before the colour is known; the colour corrects it.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.tensors.neighbourhoods import squares_around

# A pixel is on an edge if its radius and those of its neighbours span more than this, in px.
EDGE = 1.513
# Half width in px of the square around a pixel from which both surfaces are estimated.
AROUND = 2
# Index of the pixel itself in this square.
MIDDLE = (2 * AROUND + 1) ** 2 // 2
# Least standard deviation of the colours of a surface, as a share of their mean.
_MIN_DEVIATION = 0.01
# Least standard deviation as a share of the brightest channel: less may be rounding.
_ROUNDING = 1e-4
# Pixels examined at once on a CPU, and bytes that each takes elsewhere: bounds memory.
AT_ONCE, BYTES_EACH = 1 << 12, 1 << 12


class Side(NamedTuple):
    """One of the two surfaces beside n pixels."""

    mean: Tensor  # [n, C] colour
    variance: Tensor  # [n, C] of colour
    signed_radius: Tensor  # [n] px
    known: Tensor  # [n] bool, whether it is seen without the other surface


class Around(NamedTuple):
    """The 25 pixels around each of n."""

    colors: Tensor  # [C, 25, n]
    radii: Tensor  # [25, n] px
    is_near: Tensor  # [25, n] bool, whether they are of the nearer one of two surfaces
    nearness: Tensor  # [25, n], their weights: 0 on an edge

    @property
    def color(self) -> Tensor:
        """[n, C] of the pixels themselves."""
        return self.colors[:, MIDDLE].T

    def own(self) -> Tensor:
        """[25, n] bool, which are of the pixel's own surface, not of a second or third one."""
        alike = (self.radii - self.radii[MIDDLE]).detach().abs() <= EDGE
        return alike & (self.is_near == self.is_near[MIDDLE])

    def select(self, index: Tensor) -> Around:
        """The squares around the pixels of these indices."""
        return Around(*(each.index_select(-1, index) for each in self))


def around_edge(
    image: Tensor, signed_radius: Tensor, edge: Tensor, border: Tensor, at: Tensor
) -> Around:
    """The squares around pixels at [n, 2]; radii below the border [..., H, W] are near."""
    size = edge.shape[-2], edge.shape[-1]
    position = squares_around(at, size, AROUND).flatten(1).T.contiguous()
    spots = position.flatten()
    radii, on_edge = (
        x.flatten().index_select(0, spots).reshape(position.shape) for x in (signed_radius, edge)
    )
    own = at[:, 0] * size[1] + at[:, 1]
    is_near = radii.detach() < border.flatten().index_select(0, own)
    colors = image.flatten(1).index_select(1, spots).reshape(len(image), *position.shape)
    return Around(colors, radii, is_near, closeness(image) * ~on_edge)


def closeness(like: Tensor) -> Tensor:
    """Weights of the pixels of a square by their distance from its middle, [25, 1]."""
    offset = torch.arange(-AROUND, AROUND + 1, device=like.device)
    squares = (offset * offset + (offset * offset)[:, None]).flatten()
    return torch.exp(squares.to(like.dtype) / -4)[:, None]


def side_of(around: Around, weight: Tensor) -> Side:
    """The surface of the pixels of a square that have a weight; [25, n], 0 for other surfaces."""
    total = weight.sum(0)
    fraction = weight / torch.where(total > 0, total, 1.0)
    mean, radius = (around.colors * fraction).sum(1), (around.radii * fraction).sum(0)
    off = around.colors - mean[:, None]
    spread = (off * off * fraction).sum(1)
    brightest = torch.maximum(mean, around.colors[:, MIDDLE]).amax(0).clamp(min=0)
    minimum = torch.maximum(_MIN_DEVIATION * mean, _ROUNDING * brightest)
    variance = spread + minimum * minimum + torch.finfo(mean.dtype).tiny ** 0.5
    return Side(mean.T, variance.T, radius, total > 0)


def fraction_deviation(
    color: Tensor, near: Side, far: Side, expected: Tensor, deviation: float
) -> Tensor:
    """How far the most probable share [n] of the nearer surface is from the expected one.

    `color`: [n, C] = share · near + (1 - share) · far; `expected`: [n] shares before the colour is
    known.
    """
    variance = (near.variance + far.variance) / 2
    apart = near.mean - far.mean
    evidence = (apart * apart / variance).sum(1)
    observed = (apart * (color - far.mean) / variance).sum(1)
    return (observed - expected * evidence) / (deviation**-2 + evidence)

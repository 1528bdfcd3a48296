"""Coherence transport: lines of a picture continued behind the surface that hides them.

A smooth continuation fades the joints of a wall and the edges of a pattern. Where the picture
beside a hidden pixel has one direction, the pixel gets the colours that lie next to it along that
direction, from both sides if there are two (Bornemann and März 2007). The direction is given by the
structure tensor (Förstner and Gülch 1987), which is continued like a colour.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.renderer.engine.limits import (
    LINE_STEPS,
    NO_SLOPE,
    SAME_AT_HALF,
    TRANSPORTED,
    UNCLEAR,
)
from defocus_core.renderer.inpainting.disocclusion import FARTHEST
from defocus_core.renderer.inpainting.two_layer_pyramid import PyramidLevel
from defocus_core.renderer.layers.slopes import slope_within
from defocus_core.tensors.device_plan import sent


def structure(half: PyramidLevel) -> PyramidLevel:
    """A level with the structure tensor as three further channels: xx, xy and yy.

    The tensor is made of slopes between neighbours on the same surface, summed over channels (Di
    Zenzo 1986); there are no slopes at depth edges.

    `half`: linear colour and radius in px, at half the resolution.
    """
    assert half.near is not None
    radius = torch.where(half.edges, torch.nan, half.far[-1].detach())
    x, y = (slope_within(half.far[:-4], radius, dim, SAME_AT_HALF) for dim in (-1, -2))
    tensor = torch.stack([(x * x).sum(0), (x * y).sum(0), (y * y).sum(0)])
    # nearer surfaces have too few pixels for slopes
    pairs = (half.far, tensor), (half.near, torch.zeros_like(tensor))
    far, near = (torch.cat([surface[:-3], more, surface[-3:]]) for surface, more in pairs)
    return half._replace(far=far, near=near)


def transported(
    picture: Tensor,  # [C + 1, H, W]
    at: Tensor,  # [n, 2]
    border: Tensor,  # [n]
    smooth: Tensor,  # [n, C + 1]
    tensor: Tensor,  # [n, 3]
    level: int = 0,
) -> Tensor:
    """Colours [n, C] of hidden pixels, with visible lines continued behind nearer surfaces.

    `picture`: linear colours, then radius in px; `at`: rows and columns of the hidden pixels;
    `border`: radius in px that a farther surface exceeds; `smooth`, `tensor`: colours, radius and
    structure tensor as continued without a direction; `level`: how many times the resolution of
    `picture` is halved.
    """
    r, color, size = picture[-1].detach().flatten(), smooth[:, :-1], picture.shape[-2:]
    along, coherence = _direction(tensor, color)
    ways = (torch.cat([at, at]), torch.cat([border, border]), torch.cat([along, -along]))
    spot, away = _first_beyond(r, size, *ways, 0.5**level)
    expected = smooth[:, -1].detach().repeat(2)
    near = (away < FARTHEST) & ((r.index_select(0, spot) - expected).abs() < TRANSPORTED)
    limits = picture[:-1].flatten(1).index_select(1, spot).T
    n = len(at)
    first, second, to_first, to_second = limits[:n], limits[n:], away[:n], away[n:]
    is_first, is_second = near[:n], near[n:]
    both = is_first & is_second
    # the nearer one of two ends has more weight; a single end has less the farther it is
    fraction = torch.where(both, to_second / (to_first + to_second), is_first.to(r.dtype))[:, None]
    between = fraction * first + (1 - fraction) * second
    fading = 1 - torch.where(is_first, to_first, to_second) / FARTHEST
    weight = torch.where(both, 1.0, torch.where(is_first | is_second, fading, 0.0)) * coherence
    return color + weight[:, None] * (between - color)


def _direction(tensor: Tensor, color: Tensor) -> tuple[Tensor, Tensor]:
    """The direction [n, 2] (y, x) in which colours change least, and its coherence [n], 0 to 1."""
    xx, xy, yy = tensor.unbind(1)
    flat = NO_SLOPE**2 * (color * color).sum(1) + torch.finfo(color.dtype).tiny
    trace = xx + yy + flat
    cosine, sine = (xx - yy) / trace, 2 * xy / trace  # of twice the angle of the gradient
    square = cosine * cosine + sine * sine
    coherence = ((square + UNCLEAR**2).sqrt() - UNCLEAR) / ((1 + UNCLEAR**2) ** 0.5 - UNCLEAR)
    half = (cosine / torch.where(square > 0, square, 1.0).sqrt()).detach()
    y = ((1 + half) / 2).clamp(min=0).sqrt()
    x = ((1 - half) / 2).clamp(min=0).sqrt() * torch.where(sine > 0, -1.0, 1.0).to(sine)
    return torch.stack([y, x], 1), coherence


def _first_beyond(
    r: Tensor,  # [H * W] px
    size: tuple[int, ...],
    at: Tensor,  # [n, 2]
    border: Tensor,  # [n]
    along: Tensor,  # [n, 2] of length 1
    scale: float,
) -> tuple[Tensor, Tensor]:
    """The first pixel in a direction whose radius exceeds the border, and its distance.

    `scale`: pixels of the picture per px of full resolution. Returns flat indices [n] in r, and
    distances [n] in px, infinite where there is no such pixel.
    """
    H, W = size
    # halves are rounded away from 0: mirrored directions lead to mirrored pixels
    half = torch.full_like(along, 0.5).copysign(along)
    steps = sent(LINE_STEPS, along)[:, None, None] * scale
    row, column = (at + (half + along * steps).long()).unbind(2)  # [steps, n] each
    every = row.clamp_(0, H - 1).mul_(W).add_(column.clamp_(0, W - 1))
    known = r.index_select(0, every.flatten()).view(every.shape) > border
    which = known.byte().argmax(0)
    distance = sent(LINE_STEPS, r).index_select(0, which)
    distance = torch.where(known.any(0), distance, torch.inf)
    return every.gather(0, which[None])[0], distance

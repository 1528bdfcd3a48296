"""A smooth continuation of a picture to pixels that have no value: push and pull.

Values are averaged to half resolution again and again, by the weight they have; then each level
fills from the next coarser one what it lacks (Gortler et al. 1996). The averages overlap: a pixel
is continued alike wherever it lies among the cells. Only what is around the pixels that ask is
computed, and only as many levels as they ask for.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import interpolate, pad

from defocus_core.halving import Axis, pulled
from defocus_core.pieces import alike, pieces

# Values come from this many px times 2^level away at most.
REACH = 4


def continued(
    values: Tensor,
    rank: Tensor,
    at: Tensor,
    border: Tensor,
    *,
    level: int,
    middle: tuple[Axis, Axis],
    adjoining: bool = False,
) -> tuple[Tensor, Tensor]:
    """Values continued to some pixels, to each from those whose rank is beyond its border.

    Args:
        values: [K, H, W].
        rank: [H, W], of the dtype of the values.
        at: [n, 2] rows and columns to continue to, in between pixels too.
        border: [n] few different ones.
        level: How many times resolution is halved, at least 1: values come from up to
            1.5 · 2^level px away, whatever lies there, and never from more than REACH · 2^level.
        middle: Of the frame.
        adjoining: Whether what lies next to pixels that have values is mostly like these.

    Returns:
        [n, K], and [n] bool whether there was something to continue.
    """
    borders, which = torch.unique(border, return_inverse=True)
    size = (rank.shape[0], rank.shape[1])
    every, of = pieces(at, which, len(borders), size, middle, level)
    order = of.argsort(stable=True)
    ends = [0, *torch.bincount(of, minlength=len(every)).cumsum(0).tolist()]
    picture = torch.cat([values, torch.ones_like(rank)[None]])
    found = picture.new_zeros(len(at), len(picture) - 1)
    weight = picture.new_zeros(len(at))
    for batch in alike(every, level):
        some = order[ends[batch.start] : ends[batch.stop]]
        corners = [piece.corner(middle, level) for piece in every[batch]]
        limits = borders[[piece.border for piece in every[batch]]]
        size = every[batch.start].size(middle, level)
        result = _filled(picture, rank, corners, size, limits, level, middle, adjoining)
        number = of[some] - batch.start
        places = at[some] - torch.tensor(corners, device=at.device)[number]
        sampled = _sampled(result, number, places)
        share = sampled[:, -1:].detach()
        found = found.index_copy(0, some, sampled[:, :-1] / torch.where(share > 0, share, 1.0))
        weight = weight.index_copy(0, some, share[:, 0])
    return found, weight > 0


def _filled(
    picture: Tensor,
    rank: Tensor,
    corners: list[tuple[int, int]],
    size: tuple[int, int],
    border: Tensor,
    level: int,
    middle: tuple[Axis, Axis],
    adjoining: bool,
) -> Tensor:
    """Continued values and whether there were some, of m rectangles.

    Args:
        picture: [K + 1, H, W], the last channel is 1.
        rank: [H, W].
        corners: First row and first column of each.
        size: (height, width) of all.
        border: [m].
        level: Of the coarsest resolution.
        middle: Of the frame.
        adjoining: As above.

    Returns:
        [m, K + 1, h, w].
    """
    ranks = torch.stack([_cut(rank, corner, size, -torch.inf) for corner in corners])
    pixels = torch.stack([_cut(picture, corner, size, 0.0) for corner in corners])
    pixels = pixels.mul_((ranks > border[:, None, None])[:, None])
    odd = (middle[0].odd, middle[1].odd)
    levels = [_grown(pixels) if adjoining else pixels]
    for _ in range(level):
        pixels = pulled(pixels, odd)
        pixels = pixels / pixels[:, -1:].clamp(min=1)
        levels.append(pixels)
    found = _averaged(levels.pop())
    for finer in reversed(levels):
        found = torch.addcmul(finer, 1 - finer[:, -1:], _doubled(found, odd))
    return found


def _cut(picture: Tensor, corner: tuple[int, int], size: tuple[int, int], missing: float) -> Tensor:
    """A rectangle [..., height, width] of a picture [..., H, W], with a value where it has none."""
    edges: list[int] = []
    for dim in (-2, -1):
        start, length = corner[dim], size[dim]
        n = picture.shape[dim]
        first, last = min(max(start, 0), n), max(min(start + length, n), 0)
        last = max(first, last)
        picture = picture.narrow(dim, first, last - first)
        before = min(max(-start, 0), length)
        edges = [before, length - before - (last - first), *edges]
    return pad(picture, edges, value=missing) if any(edges) else picture


def _doubled(values: Tensor, odd: tuple[bool, bool]) -> Tensor:
    """The same field [..., h, w] at twice the resolution, linear between samples."""
    h, w = values.shape[-2:]
    height, width = 2 * h - odd[0], 2 * w - odd[1]
    if odd[0] == odd[1]:
        return interpolate(values, (height, width), mode="bilinear", align_corners=odd[0])
    values = interpolate(values, (height, w), mode="bilinear", align_corners=odd[0])
    return interpolate(values, (height, width), mode="bilinear", align_corners=odd[1])


def _grown(values: Tensor) -> Tensor:
    """Values [m, K + 1, h, w] times their weight, and what lies next to them where there are none.

    Those count by tents of three cells, but twice: beside an edge by a half.
    """
    tents = values
    for dim in (-1, -2):
        n = values.shape[dim] - 1
        wide = 2 * tents
        wide.narrow(dim, 1, n).add_(tents.narrow(dim, 0, n))
        wide.narrow(dim, 0, n).add_(tents.narrow(dim, 1, n))
        tents = wide
    weight = tents[:, -1:]
    share = (1 - values[:, -1:]) * (weight / 8).clamp(max=1) / weight.clamp(min=1)
    return torch.addcmul(values, share, tents)


def _averaged(values: Tensor) -> Tensor:
    """Values [m, K + 1, h, w] smoothed by tents of three cells, by their weight; 0 where none is.

    The last channel becomes 1 or 0.
    """
    for dim in (-1, -2):
        n = values.shape[dim]
        edge = (1, 1) if dim == -1 else (0, 0, 1, 1)
        wide = pad(values, edge)
        values = 2 * values + wide.narrow(dim, 0, n) + wide.narrow(dim, 2, n)
    weight = values[:, -1:]
    some = weight > 0
    return torch.where(some, values / torch.where(some, weight, 1.0), 0.0)


def _sampled(fields: Tensor, number: Tensor, places: Tensor) -> Tensor:
    """Fields [m, K, h, w] between the pixels, at [n, 2] of rectangle `number`: [n, K]."""
    (y0, y1, fy), (x0, x1, fx) = (
        _neighbours(places[:, d], fields.shape[d + 2], fields.dtype) for d in (0, 1)
    )
    h, w = fields.shape[-2:]
    rows = fields.movedim(1, -1).reshape(-1, fields.shape[1])
    above, below = number * (h * w) + y0 * w, number * (h * w) + y1 * w

    def at(row: Tensor) -> Tensor:
        return rows.index_select(0, row + x0) * (1 - fx) + rows.index_select(0, row + x1) * fx

    return at(above) * (1 - fy) + at(below) * fy


def _neighbours(place: Tensor, length: int, dtype: torch.dtype) -> tuple[Tensor, Tensor, Tensor]:
    """The two pixels beside each place [n], and the share of the second."""
    place = place.to(dtype)
    first = place.floor().clamp(0, length - 1)
    share = (place - first).clamp(0, 1)[:, None]
    return first.long(), (first.long() + 1).clamp(max=length - 1), share

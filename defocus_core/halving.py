"""Halving the resolution of pictures, symmetrically about the middle of the frame.

A mirrored picture halves to its mirror image, and a part of a frame as the whole. Of an even length
two pixels make one of the next level. Of an odd length every second pixel does, with half of its
neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

# Farther in front, in px of radius, than anything is; its square can be told from it.
_FAR = 1e12


class Axis(NamedTuple):
    """Where the middle of the frame lies.

    Attributes:
        middle: The first index at or after it.
        odd: Whether it is a pixel, and not between two.
    """

    middle: int
    odd: bool


class Coarse(NamedTuple):
    """A frame at reduced resolution.

    Attributes:
        values: [K, h, w].
        rank: [h, w] px, the least radius in each pixel of it; -inf where nothing is.
        middle: Where the middle of the frame is in it.
        halvings: How many times resolution is halved.
    """

    values: Tensor
    rank: Tensor
    middle: tuple[Axis, Axis]
    halvings: int

    def places(self, at: Tensor, fine: tuple[Axis, Axis]) -> Tensor:
        """Rows and columns [n, 2] in pixels of this resolution.

        Args:
            at: The same at full resolution.
            fine: Where the middle of the frame is there.
        """
        share = 0.5**self.halvings
        found = [
            coarse.middle + (at[:, d] - axis.middle) * share
            if axis.odd
            else coarse.middle - 0.5 + (at[:, d] + 0.5 - axis.middle) * share
            for d, (axis, coarse) in enumerate(zip(fine, self.middle, strict=True))
        ]
        return torch.stack(found, 1)


def axes(size: tuple[int, int], top: int = 0, left: int = 0) -> tuple[Axis, Axis]:
    """The middle of a frame of (height, width), counted from a pixel of it."""
    down, across = (
        Axis(n // 2 - start, n % 2 == 1) for n, start in zip(size, (top, left), strict=True)
    )
    return down, across


class Halves(NamedTuple):
    """How the pixels of one axis make those of half resolution.

    Attributes:
        before: Pixels missing at the beginning.
        after: Pixels missing at the end.
        length: Pixels of half resolution.
        axis: Where the middle is among them.
    """

    before: int
    after: int
    length: int
    axis: Axis


def halves(length: int, axis: Axis) -> Halves:
    """What an axis of some pixels lacks to be halved."""
    before = axis.middle % 2
    after = (length + before + axis.odd) % 2
    middle = Axis((axis.middle + before) // 2, axis.odd)
    return Halves(before, after, (length + before + after + axis.odd) // 2, middle)


def extended(values: Tensor, down: Halves, across: Halves, value: float) -> Tensor:
    """Values [..., H, W] with the missing pixels, which get a value."""
    missing = (across.before, across.after, down.before, down.after)
    return pad(values, missing, value=value) if any(missing) else values


def greatest(values: Tensor, middle: tuple[Axis, Axis], missing: float) -> Tensor:
    """The greatest [h, w] of the pixels [H, W] that make one of half resolution.

    Args:
        values: [H, W].
        middle: Of the frame.
        missing: What pixels outside count as.
    """
    down, across = (halves(n, axis) for n, axis in zip(values.shape, middle, strict=True))
    values = extended(values, down, across, missing)
    for dim, axis in enumerate(middle):
        even, odd = (values[i::2] if dim == 0 else values[:, i::2] for i in (0, 1))
        if not axis.odd:
            values = torch.maximum(even, odd)
            continue
        n = odd.shape[dim]
        values = even.clone()
        for start in (0, 1):
            side = values.narrow(dim, start, n)
            torch.maximum(side, odd, out=side)
    return values


def spread_out(values: Tensor, odd: tuple[bool, bool]) -> Tensor:
    """For each pixel the greatest [H, W] of those of half resolution [h, w] that it is part of."""
    for dim in (0, 1):
        twice = values.repeat_interleave(2, dim)
        if odd[dim]:
            n = 2 * values.shape[dim] - 1
            values = torch.maximum(twice.narrow(dim, 0, n), twice.narrow(dim, 1, n))
        else:
            values = twice
    return values


def halved(values: Tensor, odd: tuple[bool, bool]) -> Tensor:
    """Sums [..., h, w] of the pixels [..., H, W] that make one of half resolution."""
    for dim in (-2, -1):  # rows first: they lie together
        values = _halved(values, dim, odd[dim])
    return values


def _halved(values: Tensor, dim: int, odd: bool) -> Tensor:
    """The same along one axis."""
    even = values[..., 0::2] if dim == -1 else values[..., 0::2, :]
    other = values[..., 1::2] if dim == -1 else values[..., 1::2, :]
    if not odd:
        return even + other
    half = other / 2
    before = (1, 0) if dim == -1 else (0, 0, 1, 0)
    after = (0, 1) if dim == -1 else (0, 0, 0, 1)
    return even + pad(half, before) + pad(half, after)


def pulled(values: Tensor, odd: tuple[bool, bool]) -> Tensor:
    """Sums [..., h, w] of pixels [..., H, W] in cells that overlap (Burt 1981).

    As `halved`, but of an even length a pixel counts by 3/4 in its own cell and by 1/4 in the one
    next to it. What lies outside counts as 0.
    """
    for dim in (-2, -1):
        if odd[dim]:
            values = _halved(values, dim, odd[dim])
            continue
        even = values[..., 0::2] if dim == -1 else values[..., 0::2, :]
        other = values[..., 1::2] if dim == -1 else values[..., 1::2, :]
        n = even.shape[dim] - 1
        values = (even + other).mul_(0.75)
        values.narrow(dim, 1, n).add_(other.narrow(dim, 0, n), alpha=0.25)
        values.narrow(dim, 0, n).add_(even.narrow(dim, 1, n), alpha=0.25)
    return values


def coarser(picture: Coarse, sums: Callable[[Tensor, tuple[bool, bool]], Tensor]) -> Coarse:
    """The same at half of its resolution.

    Args:
        picture: Where nothing is, it has no weight.
        sums: `halved` or `pulled`.
    """
    values, rank, middle, halvings = picture
    some = (rank > -torch.inf).to(values.dtype)
    each = torch.cat([values * some, some[None]])
    down, across = (halves(n, axis) for n, axis in zip(rank.shape, middle, strict=True))
    each = sums(extended(each, down, across, 0.0), (down.axis.odd, across.axis.odd))
    exists = each[-1] > 0
    least = -greatest(torch.where(some > 0, -rank, -torch.inf), middle, -torch.inf)
    return Coarse(
        each[:-1] / torch.where(exists, each[-1], 1.0),
        torch.where(exists, least, -torch.inf),
        (down.axis, across.axis),
        halvings + 1,
    )


def farther(
    pictures: Sequence[Tensor], r: Tensor, middle: tuple[Axis, Axis], apart: float
) -> tuple[Coarse, Tensor]:
    """Pictures at half resolution; of cells that hold an edge only what is beyond it.

    Args:
        pictures: [k, H, W], K channels in all.
        r: [H, W] px.
        middle: Of the frame.
        apart: Px of radius up to which pixels are of one surface with the farthest of a cell.

    Returns:
        The pictures, and [h, w] bool which cells hold no edge, of depth or of the frame.
    """
    down, across = (halves(n, axis) for n, axis in zip(r.shape, middle, strict=True))
    cells = [
        (rows, columns, share_down * share_across)
        for rows, share_down in _cells(down)
        for columns, share_across in _cells(across)
    ]
    radius, *pictures = (
        _padded(extended(values, down, across, outside), down, across, outside)
        for values, outside in ((r, -_FAR), *((picture, 0.0) for picture in pictures))
    )
    near = [radius[rows, columns] for rows, columns, _ in cells]
    most = reduce(torch.maximum, near)
    limit, rank, weight = most - apart, most, torch.zeros_like(most)
    sums = [picture.new_zeros(len(picture), *most.shape) for picture in pictures]
    for some, (rows, columns, share) in zip(near, cells, strict=True):
        chosen = (some > limit).to(r.dtype)
        weight.add_(chosen, alpha=share)
        chosen *= share
        sums = [
            total.addcmul(picture[:, rows, columns], chosen)
            for total, picture in zip(sums, pictures, strict=True)
        ]
        rank = torch.minimum(rank, some + (share - chosen) * _FAR**2)  # of those chosen
    whole = weight == sum(share for _, _, share in cells)
    return Coarse(torch.cat(sums) / weight, rank, (down.axis, across.axis), 1), whole


def _cells(axis: Halves) -> list[tuple[slice, float]]:
    """For the pixels of each cell of an axis where they are, after `_padded`, and their share."""
    starts = [(0, 0.5), (1, 1.0), (2, 0.5)] if axis.axis.odd else [(0, 1.0), (1, 1.0)]
    return [(slice(start, start + 2 * axis.length - 1, 2), share) for start, share in starts]


def _padded(values: Tensor, down: Halves, across: Halves, value: float) -> Tensor:
    """Values [..., H, W] with what the outermost cells of an odd length lack."""
    edges = [int(axis.axis.odd) for axis in (across, across, down, down)]
    return pad(values, edges, value=value) if any(edges) else values


def averaged(
    values: Tensor, halvings: int, middle: tuple[Axis, Axis]
) -> tuple[Tensor, tuple[Axis, Axis]]:
    """Means [N, K, h, w] of pictures [N, K, H, W] halved some times, and where the middle is.

    What lies outside counts as 0.
    """
    down, across = middle
    for _ in range(halvings):
        y, x = halves(values.shape[-2], down), halves(values.shape[-1], across)
        values = halved(extended(values, y, x, 0.0), (down.odd, across.odd)) / 4
        down, across = y.axis, x.axis
    return values, (down, across)

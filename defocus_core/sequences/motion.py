"""Motion between frames: chained over several frames, and the change of depth that goes with it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

# Pixels whose change of radius is looked at, at most; ranges of radii; fewest pixels of a range.
_SAMPLE, _RANGES, _FEWEST = 1 << 16, 48, 32
# Greatest difference of the colours of a surface in two frames, as a share of its brightness, and
# besides.
_COLOR, _DARK = 0.03, 0.001


class Frame(NamedTuple):
    """A frame of a shot, as it is needed for another one.

    Attributes:
        image: [C, H, W] linear.
        signed_radius: [H, W] px, through the lens of the other frame.
        motion: [2, H, W] px, right and down, to where the surface of each pixel is in the next
            frame on the way to the other one; None where nothing is known to move.
    """

    image: Tensor
    signed_radius: Tensor
    motion: Tensor | None = None


def positions(size: tuple[int, int], like: Tensor) -> Tensor:
    """The places [2, H, W] of the pixels of a frame: columns, then rows."""
    rows, columns = (torch.arange(n, dtype=like.dtype, device=like.device) for n in size)
    return torch.stack(torch.meshgrid(columns, rows, indexing="xy"))


def nearest_pixels(at: Tensor, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """The numbers [H, W] of the pixels nearest to places [2, H, W], and whether they exist."""
    column, row = at.round()
    inside = (column >= 0) & (column < size[1]) & (row >= 0) & (row < size[0])
    number = row.clamp(0, size[0] - 1) * size[1] + column.clamp(0, size[1] - 1)
    return torch.where(inside, number, 0).long(), inside


def chained(motions: Sequence[Tensor], radii: Sequence[Tensor], step: float) -> Tensor:
    """The motion [2, H, W] from the first of some frames to the one after the last of them.

    At each frame on the way the motion of the pixel there is taken if it is of the same surface, as
    its radius tells; a surface that is hidden there is taken to move on as it did.

    Args:
        motions: [2, H, W] px each, from every frame to the next.
        radii: [H, W] px each, of the same frames.
        step: Greatest difference of radii in px of one surface in two frames.
    """
    total, last, nearest = motions[0], motions[0], radii[0]
    size = nearest.shape[0], nearest.shape[1]
    start = positions(size, total)
    for motion, radius in zip(motions[1:], radii[1:], strict=True):
        index, inside = nearest_pixels(start + total, size)
        there = radius.flatten()[index]
        same = inside & ((there - nearest).abs() <= step)
        nearest = torch.where(same, there, nearest)
        last = torch.where(same, motion.flatten(1)[:, index], last)
        total = total + last
    return total


def approached(radius: Tensor, there: Tensor) -> tuple[Tensor, Tensor]:
    """Radii of a neighbour as they would be in the frame, if the camera has moved.

    The nearer a surface, the more its disparity changes. The change of each range of radii is the
    median over its pixels, most of which both frames show; between the ranges it is interpolated.
    A curve through all pixels would follow the background, and lose the near surfaces.

    `radius`: [n] px of the neighbour; `there`: [n] px of the frame, where the motion leads; NaN
    where it leads to no such surface. Returns [n] px, and [n] px, the median distance of pixels of
    such a radius from these.
    """
    whole = (radius.isfinite() & there.isfinite()).nonzero()[:, 0]
    sample = whole[:: max(1, len(whole) // _SAMPLE)]
    x, off = radius[sample], (there - radius)[sample]
    if not len(x):
        return radius, torch.zeros_like(radius)
    x, order = x.sort()
    fractions = torch.linspace(0, 1, _RANGES + 1, dtype=x.dtype, device=x.device)
    limits = torch.searchsorted(x, torch.lerp(x[0], x[-1], fractions[1:-1]), right=True).tolist()
    knots, start = [], 0
    for end in [*limits, len(x)]:
        if end - start < _FEWEST and (end < len(x) or end == start):
            continue  # together with the next range
        of_range = off[order[start:end]]
        change = of_range.median()
        knots.append(torch.stack([x[start:end].mean(), change, (of_range - change).abs().median()]))
        start = end
    position, change, spread = torch.stack(knots, 1)
    return radius + _interpolated(radius, position, change), _interpolated(radius, position, spread)


def alike(color: Tensor, other: Tensor) -> Tensor:
    """Whether colours [C, ...] may be of one surface, in two frames."""
    brightness = other.abs().mean(0)
    return (color - other).abs().amax(0) <= _COLOR * brightness + _DARK


def _interpolated(x: Tensor, knots: Tensor, values: Tensor) -> Tensor:
    """Values [k] at ascending knots [k], read at x [n]; beyond the ends those of the ends."""
    if len(knots) == 1:
        return values.expand_as(x)
    before = torch.searchsorted(knots, x.contiguous()).clamp(1, len(knots) - 1) - 1
    width = (knots[before + 1] - knots[before]).clamp(min=torch.finfo(x.dtype).tiny)
    fraction = ((x - knots[before]) / width).clamp(0, 1)
    return torch.lerp(values[before], values[before + 1], fraction)

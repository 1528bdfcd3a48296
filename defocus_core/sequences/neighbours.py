"""Neighbours of a frame: the motion to them, depth averaged with them, and what they have seen.

Averaged is a pixel with that of a neighbour where its surface has moved to, unless colours or radii
around it tell that this is another surface, or that it has come nearer. Means over a few pixels
tell, for noise leaves them alone. Seen behind: each pixel of a neighbour is moved to where its
surface is in the frame. Where the frame shows a nearer surface there, the neighbour has seen what
is hidden; of several such surfaces the nearest is the next one behind. Of several neighbours the
closest in time tells, for errors of motion and of depth grow with the distance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from defocus_core.renderer.inpainting.disocclusion import STEP
from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer
from defocus_core.tensors.neighbourhoods import extreme_around

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


# Distance in px around a pixel that is compared; greatest difference of its mean radius and of its
# own, in deviations.
_BY, _MEAN, _OWN = 2, 4.0, 4.0


def temporal_mean(frame: Frame, neighbours: Iterable[Frame], noise: float) -> tuple[Tensor, Tensor]:
    """Radii of a frame averaged with those of its neighbours where the scene is still.

    Args:
        frame: The frame; its motion is not used.
        neighbours: Other frames of the scene, each through the lens of the frame, and with the
            motion [2, H, W] px from the frame to it; none where nothing moves.
        noise: Standard deviation in px of the noise of the radii.

    Returns:
        [H, W] px, and the number [H, W] of frames that were averaged.
    """
    radius = frame.signed_radius
    total, count = torch.zeros_like(radius), torch.ones_like(radius)
    side = 2 * _BY + 1
    mean_limit, own_limit = (k * math.sqrt(2) * noise for k in (_MEAN / side, _OWN))
    color = _around(frame.image)
    for neighbour in neighbours:
        image, other, inside = _fetched(neighbour, frame)
        still = alike(_around(image), color) & inside
        off = other - radius
        still &= off.abs() <= own_limit
        near = torch.where(off.abs() <= own_limit, off, 0.0)
        still &= _around(near).abs() <= mean_limit
        total += torch.where(still, off, 0.0)
        count += still
    return radius + total / count, count


def _fetched(neighbour: Frame, frame: Frame) -> tuple[Tensor, Tensor, Tensor | bool]:
    """Colours and radii of a neighbour where the surfaces of the frame are in it."""
    image, radius, motion = neighbour
    if motion is None:
        return image, radius, True
    size = radius.shape[0], radius.shape[1]
    index, inside = nearest_pixels(positions(size, motion) + motion, size)
    color = image.flatten(1)[:, index]
    same = inside & alike(color, frame.image)
    there = torch.where(same, frame.signed_radius, torch.nan)
    other, _ = approached(radius.flatten()[index.flatten()], there.flatten())
    return color, other.view(size), inside


def _around(values: Tensor) -> Tensor:
    """The mean of values [..., H, W] over the square around each pixel, cut at the borders."""
    flat = values.reshape(1, -1, *values.shape[-2:])
    means = avg_pool2d(flat, 2 * _BY + 1, 1, _BY, count_include_pad=False)
    return means.reshape(values.shape)


# Greatest change of radius of a surface that both frames show, in medians of what it should be.
_SPREADS = 4.0


def seen_behind(frame: Frame, neighbours: Iterable[Frame]) -> HiddenLayer:
    """What neighbours have seen behind the surfaces of a frame.

    Args:
        frame: The frame; its motion is not used.
        neighbours: Frames close in time, the closest first, each with its radii through the lens
            of the frame and with the motion from it to the frame.
    """
    H, W = frame.signed_radius.shape
    color = frame.signed_radius.new_zeros(len(frame.image), H * W)
    radius = frame.signed_radius.flatten().clone()
    known = torch.zeros_like(radius, dtype=torch.bool)
    for neighbour in neighbours:
        index, source, behind = _revealed(frame, neighbour, ~known)
        radius[index], known[index] = behind, True
        color[:, index] = neighbour.image.flatten(1)[:, source].to(color.dtype)
    return HiddenLayer(color.view(-1, H, W), radius.view(H, W), known.view(H, W))


def _revealed(frame: Frame, neighbour: Frame, unknown: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Pixels of the frame for which a neighbour has the next surface, and its pixels.

    `unknown`: [H * W], pixels of whose hidden surface nothing is known yet. Returns [n] numbers of
    pixels of the frame, [n] of the neighbour, and [n] px, the radii of these.
    """
    assert neighbour.motion is not None
    frame_radius, radius = frame.signed_radius.flatten(), neighbour.signed_radius
    H, W = radius.shape
    # a pixel beside a nearer surface holds a part of its colour
    whole = extreme_around(radius, 1, torch.minimum) > radius - STEP
    at = (positions((H, W), neighbour.motion) + neighbour.motion).flatten(1)
    source = torch.nonzero(whole.flatten() & at.isfinite().all(0))[:, 0]
    at = at[:, source]
    nearest, inside = nearest_pixels(at, (H, W))
    color = neighbour.image.flatten(1)[:, source]
    same = inside & alike(color, frame.image.flatten(1)[:, nearest])
    there = torch.where(same, frame_radius[nearest], torch.nan)
    behind, spread = approached(radius.flatten()[source].to(there.dtype), there)
    moved = torch.full_like(frame_radius, torch.inf)
    moved[source] = behind
    steps = STEP + _SPREADS * spread
    targets, sources, distances = [], [], []
    for down in (0, 1):
        for across in (0, 1):
            column, row = at[0].floor() + across, at[1].floor() + down
            inside = (column >= 0) & (column < W) & (row >= 0) & (row < H)
            inside &= (column - at[0] < 1) & (row - at[1] < 1)
            target = (row * W + column).where(inside, torch.zeros_like(row)).long()
            farther = inside & (behind > frame_radius[target] + steps)
            farther &= unknown[target]
            targets.append(target[farther])
            sources.append(source[farther])
            distance = (at[0] - column).square() + (at[1] - row).square()
            distances.append(distance[farther])
    target, source, distance = map(torch.cat, (targets, sources, distances))
    index, source = _closest(target, source, distance, moved[source], H * W)
    return index, source, moved[source]


def _closest(
    target: Tensor, source: Tensor, distance: Tensor, radius: Tensor, pixels: int
) -> tuple[Tensor, Tensor]:
    """For each target the source [n] of the nearest surface there that lies closest to it."""
    nearest = torch.full((pixels,), torch.inf, dtype=radius.dtype, device=radius.device)
    nearest = nearest.scatter_reduce(0, target, radius, "amin")
    first = radius <= nearest[target] + STEP
    target, source, distance = target[first], source[first], distance[first]
    minimum = torch.full((pixels,), torch.inf, dtype=distance.dtype, device=distance.device)
    minimum = minimum.scatter_reduce(0, target, distance, "amin")
    closest = distance <= minimum[target]
    owner = torch.full((pixels,), -1, dtype=torch.long, device=target.device)
    owner = owner.scatter_reduce(0, target[closest], source[closest], "amax")
    index = torch.nonzero(owner >= 0)[:, 0]
    return index, owner[index]

"""Hidden content that neighbours have seen: surfaces moved behind those that hide them now.

Each pixel of a neighbour is moved to where its surface is in the frame. Where the frame shows a
nearer surface there, the neighbour has seen what is hidden; of several such surfaces the nearest is
the next one behind. Of several neighbours the closest in time tells, for errors of motion and of
depth grow with the distance.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

from defocus_core.renderer.inpainting.disocclusion import STEP
from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer
from defocus_core.sequences.motion import Frame, alike, approached, nearest_pixels, positions
from defocus_core.tensors.neighbourhoods import extreme_around

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

"""The few brightest pixels, each drawn as its own disc and clipped by what stands before it.

Almost all energy of a scene with lights is in few pixels. Layers would fade the discs that a wire
before them clips, and a transform would spread rounding noise of 1e-7 of their brightness over
everything. So what such a pixel has above its surroundings is taken out of the layers and drawn
by its own kernel. Disc pixel x of a light q is seen through lens point u = (x - q) / r_q, and a
nearer surface of radius r_k in front of it at q + u (r_q - r_k).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

from defocus_core.aperture import Aperture, Part, kernel
from defocus_core.convolution import reach
from defocus_core.ranks import Ranks
from defocus_core.tiling import BLOCK, Box, blocks_of

# A highlight is brighter than this many times the brightest of all but one pixel in 200.
_BRIGHTER = 2.0
_ORDINARY = 0.995
# Px between the pixels of a square of five by five in which surroundings are looked for: close ones
# first. A highlight wider than the widest stands on black.
_STEPS = (1, 3, 8, 24)
# How much nearer, in px of radius and as a share of it, a surface must be to stand before a light.
_BEFORE = (1.5, 0.15)
# Samples drawn at once: bounds memory.
_SAMPLES = 1 << 21


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
    brightness = pixels.detach().amax(0)
    at = torch.nonzero(brightness > limit)
    if not len(at):
        return pixels, None
    around = _surroundings(pixels, brightness <= limit, at)
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


def draw(
    highlights: Highlights,
    signed_radius: Tensor,
    places: Tensor,
    radii: tuple[float, ...],
    aperture: Aperture,
    parts: list[Part],
    box: Box,
) -> Tensor:
    """The discs of all highlights as the parts of the aperture see them: [M, C, height, width].

    Args:
        highlights: From `split`.
        signed_radius: [H, W] px of all pixels.
        places: [H, W] positions of all pixels on the ladder.
        radii: The ladder.
        aperture: The pupil.
        parts: M parts of it.
        box: What is wanted of the frame.
    """
    channels, (H, W) = highlights.excess.shape[1], (box.height, box.width)
    total = highlights.excess.new_zeros(len(parts), channels, H * W)
    most = max(*places.shape, box.top + H, box.left + W)
    spread = torch.tensor(
        [reach(float(r), most) for r in highlights.signed_radius.detach()], dtype=torch.long
    )
    corner = torch.tensor([box.top, box.left])
    far = torch.maximum(
        corner - highlights.at.cpu(), highlights.at.cpu() - corner - torch.tensor([H, W]) + 1
    )
    order = spread.argsort(descending=True, stable=True)
    order = order[(far.amax(1) <= spread)[order]]
    if not len(order):
        return total.reshape(len(parts), channels, H, W)
    widest = int(spread[order[0]]) + math.ceil(max(map(abs, radii)))  # |u (r_q - r_k)|
    present = _present(highlights, widest, places.detach(), len(radii))
    start = 0
    while start < len(order):
        extent = int(spread[order[start]])
        count = max(1, _SAMPLES // (2 * extent + 1) ** 2)
        some = order[start : start + count].to(places.device)
        start += count
        chosen = Highlights(*(values[some] for values in highlights))
        seen = _unobstructed(
            chosen, extent, signed_radius.detach(), places.detach(), radii, present[:, some]
        )
        index, inside = _targets(chosen.at - corner.to(places.device), extent, H, W)
        seen = (seen * inside).flatten()
        some_radii, which = chosen.signed_radius, slice(None)
        if not some_radii.requires_grad:  # many lights are equally far away
            some_radii, which = torch.unique(some_radii, return_inverse=True)
        for m, part in enumerate(parts):
            shape = kernel(some_radii, 2 * extent + 1, aperture, part)[which].flatten() * seen
            spots = shape.reshape(len(some), -1)
            for c in range(channels):
                values = (spots * chosen.excess[:, c : c + 1]).flatten()
                total[m, c].index_add_(0, index.flatten(), values)
    return total.reshape(len(parts), channels, H, W)


def _targets(at: Tensor, extent: int, H: int, W: int) -> tuple[Tensor, Tensor]:
    """Flat indices [n, S, S] of the pixels around each, and whether they lie in the frame."""
    offset = torch.arange(-extent, extent + 1, device=at.device)
    y = (at[:, 0, None] + offset)[:, :, None]
    x = (at[:, 1, None] + offset)[:, None, :]
    inside = (y >= 0) & (y < H) & (x >= 0) & (x < W)
    return torch.where(inside, y * W + x, 0), inside


def _unobstructed(
    highlights: Highlights,
    extent: int,
    signed_radius: Tensor,
    places: Tensor,
    radii: tuple[float, ...],
    present: Tensor,
) -> Tensor:
    """The share of each disc pixel's ray that no nearer surface stops: [n, S, S].

    Slices that are not present, [K, n], do not stop any.
    """
    at, r = highlights.at, highlights.signed_radius.detach()
    offset = torch.arange(-extent, extent + 1, device=at.device, dtype=places.dtype)
    stopped = places.new_zeros(len(at), len(offset), len(offset))
    limit = r - torch.maximum(torch.full_like(r, _BEFORE[0]), _BEFORE[1] * r.abs())
    H, W = places.shape
    for k, radius in enumerate(radii):
        before = torch.nonzero((limit > radius) & present[k])[:, 0]
        if not len(before):
            continue
        scale = 1 - radius / r[before]  # where r is 0 only the pixel itself is drawn
        scale = torch.where(r[before].abs() > 0.5, scale, 1.0)
        y = at[before, 0, None] + scale[:, None] * offset
        x = at[before, 1, None] + scale[:, None] * offset
        rows = y.round().long().clamp(0, H - 1)[:, :, None]
        columns = x.round().long().clamp(0, W - 1)[:, None, :]
        nearer = signed_radius[rows, columns] < limit[before, None, None]  # not its own surface
        stopped[before] += nearer * (1 - (places[rows, columns] - k).abs()).clamp(min=0)
    return (1 - stopped).clamp(min=0)


def _present(highlights: Highlights, within: int, places: Tensor, slices: int) -> Tensor:
    """Whether each slice has a pixel within some px of each highlight, or a block more: [K, n]."""
    around = -(-within // BLOCK)
    blocks = blocks_of(places, slices).to(torch.float32)
    near = blocks
    for edge in ((around, 0), (0, around)):
        near = max_pool2d(near, (2 * edge[0] + 1, 2 * edge[1] + 1), stride=1, padding=edge)
    rows, columns = highlights.at.div(BLOCK, rounding_mode="floor").unbind(-1)
    return near[:, rows, columns] > 0

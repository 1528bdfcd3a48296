"""What the pinhole does not see but the aperture does: surfaces behind depth edges.

Neighbouring pixels whose radii differ by more than one px hold a depth edge: with |∇r| < 1 the map
from a lens point's picture to the pinhole's is one to one, beyond that a surface hides another.
From the whole aperture the farther surface shows up to r_far - r_near px behind the edge. There it
is continued by the colour and radius of what lies farther, near by first, and along the lines that
lead there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.backdrop import (
    COARSE,
    DECAY,
    Backdrop,
    backdrop,
    halvings_for,
    level_of,
    levels_of,
)
from defocus_core.continuation import REACH, continued
from defocus_core.halving import Axis, Coarse, farther
from defocus_core.source import Pixels
from defocus_core.tiling import Box
from defocus_core.transport import structure, transported

# How much farther, in px of radius, than the surface in front of it hidden content must be; no
# round number, so that rounding decides nothing.
STEP = 0.51
# Where between a near and a far radius a border may be that tells them apart: where the far one is
# shown with more than half of its distance left, and where with less.
_WELL_BETWEEN, _ALMOST_HIDDEN = (0.25, 0.5), (0.1, 0.25)
# Up to this times 2^level px from the farther surface it is continued from half of the resolution,
# as far as that level reaches; what is deeper comes from the backdrop.
_SHALLOW = 1.25
# Px of radius up to which pixels side by side are of one surface.
_ONE_SURFACE = 1.0
# Borders are multiples of 1 / 8 px, and of as great a power of two as fits in between; a little
# more, for round numbers are frequent radii.
_GRAINS = 8
_MORE = 0.0213


def around(finest: int) -> int:
    """Px around a region from which what it hides beside edges is continued."""
    return REACH << finest


class HiddenLayer(NamedTuple):
    """The surface behind the visible one, where the aperture may see it or where it is known.

    Attributes:
        color: [C, H, W].
        signed_radius: [H, W] px.
        mask: [H, W] bool.
    """

    color: Tensor
    signed_radius: Tensor
    mask: Tensor


class Behind(NamedTuple):
    """What is known of a whole frame, in memory or not; elsewhere than in the mask, anything."""

    color: Pixels
    signed_radius: Pixels
    mask: Pixels

    def within(self, box: Box, signed_radius: Tensor, dtype: torch.dtype) -> HiddenLayer:
        """What is known within a box whose visible radii are [height, width] px."""
        color, radius, mask = map(box.of, self)
        mask = mask.bool()
        color = torch.where(mask, color.to(dtype), 0.0)
        return HiddenLayer(color, torch.where(mask, radius.to(dtype), signed_radius), mask)


def hidden_layer(
    image: Tensor,
    signed_radius: Tensor,
    beyond: Backdrop | None = None,
    box: Box | None = None,
    wanted: Box | None = None,
    *,
    finest: int = 3,
) -> HiddenLayer | None:
    """Continue farther surfaces behind nearer ones, as far as the aperture sees them.

    Args:
        image: [C, H, W] linear.
        signed_radius: [H, W] px.
        beyond: The frame that this is a part of; None if it is the whole.
        box: Where in the frame it is.
        wanted: Where in it the layer matters; None if everywhere.
        finest: The `hidden_level` of a quality.

    Returns:
        What is in `wanted`; None if nothing is hidden there.
    """
    H, W = signed_radius.shape
    beyond = beyond or backdrop(image, signed_radius)
    box = box or Box(0, 0, H, W)
    wanted = wanted or Box(0, 0, H, W)
    r = signed_radius.detach()
    inside = wanted.of(r)
    shown, source = beyond.revealed(
        Box(box.top + wanted.top, box.left + wanted.left, wanted.height, wanted.width)
    )
    behind = shown > inside + STEP
    index = torch.nonzero(behind.flatten())[:, 0]
    if not len(index):
        return None
    y = index.div(wanted.width, rounding_mode="floor")
    at = torch.stack([y + wanted.top, index - y * wanted.width + wanted.left], 1)
    here = at[:, 0] * W + at[:, 1]
    pictures = (image, signed_radius[None])
    # stays where nothing is farther
    found = torch.cat([some.flatten(1).index_select(1, here).T for some in pictures], 1)
    near = found[:, -1].detach().clone()
    far, cone = (x.flatten().index_select(0, index) for x in (source, shown))
    border = _border(near, far, cone)
    deep = far - cone > (_SHALLOW * DECAY) * (1 << finest)
    all_of_it = levels_of(*beyond.pictures[0].rank.shape)
    levels = level_of(far - near).clamp(max=all_of_it).clamp(min=finest)
    levels = torch.where(deep, levels, finest)
    down, across = beyond.fine
    middle = (
        Axis(down.middle - box.top, down.odd),
        Axis(across.middle - box.left, across.odd),
    )
    for level in torch.unique(levels).tolist():
        some = torch.nonzero(levels == level)[:, 0]
        places, borders = at.index_select(0, some), border.index_select(0, some)
        if level > finest:
            picture = beyond.pictures[halvings_for(level) - COARSE]
            result, exists = _coarsely(picture, places, borders, middle, level)
        else:
            half, whole = farther(pictures, r, middle, _ONE_SURFACE)
            result, exists = _continued(
                half, half.places(places, middle), borders, level, adjoining=True
            )
            tensors = structure(half, whole)
            tensor, _ = _coarsely(tensors, places, borders, middle, level, adjoining=True)
            lines = transported(image, signed_radius, places, borders, result, tensor)
            result = torch.cat([lines, result[:, -1:]], 1)
        if not bool(exists.all()):
            some, result = some[exists], result[exists]
        found.index_copy_(0, some, result)
    color = torch.zeros_like(wanted.of(image)).flatten(1).index_copy(1, index, found[:, :-1].T)
    radius = wanted.of(signed_radius).flatten().index_copy(0, index, found[:, -1])
    radius = radius.reshape(inside.shape)
    mask = behind & (radius.detach() > inside + STEP)
    return HiddenLayer(color.reshape(-1, *inside.shape), radius, mask)


def _coarsely(
    picture: Coarse,
    at: Tensor,
    border: Tensor,
    middle: tuple[Axis, Axis],
    level: int,
    *,
    adjoining: bool = False,
) -> tuple[Tensor, Tensor]:
    """What `continued` returns, from a picture at reduced resolution, alike all over a cell.

    Args:
        picture: K channels.
        at: [n, 2] rows and columns at full resolution.
        border: [n].
        middle: Of the frame at full resolution.
        level: Counted from full resolution.
        adjoining: As for `continued`.
    """
    cells = _cells(at, border, middle)
    places = picture.places(cells.at, middle)
    result, exists = _continued(picture, places, cells.border, level, adjoining=adjoining)
    return result.index_select(0, cells.of), exists.index_select(0, cells.of)


def _continued(
    picture: Coarse, places: Tensor, border: Tensor, level: int, *, adjoining: bool = False
) -> tuple[Tensor, Tensor]:
    """What `continued` returns, of a picture at reduced resolution.

    Args:
        picture: K channels.
        places: [n, 2] rows and columns in its pixels.
        border: [n].
        level: Counted from full resolution.
        adjoining: As for `continued`.
    """
    return continued(
        picture.values,
        picture.rank,
        places,
        border,
        level=level - picture.halvings,
        middle=picture.middle,
        adjoining=adjoining,
    )


class _Cells(NamedTuple):
    """Pixels put together where the same colour will do for them.

    Attributes:
        at: [m, 2] rows and columns of their middles.
        border: [m].
        of: [n] which of them each pixel belongs to.
    """

    at: Tensor
    border: Tensor
    of: Tensor


def _cells(at: Tensor, border: Tensor, middle: tuple[Axis, Axis]) -> _Cells:
    """Cells of 2^COARSE px, symmetric about the middle of the frame, by borders.

    Args:
        at: [n, 2] rows and columns.
        border: [n] few different ones.
        middle: Of the frame.
    """
    side = 1 << COARSE
    borders, key = torch.unique(border, return_inverse=True)
    cells, starts, counts = [], [], []
    for d, axis in enumerate(middle):
        offset = at[:, d] - axis.middle
        cell = (
            offset.sign() * (offset.abs() + side // 2 - 1).div(side, rounding_mode="floor")
            if axis.odd
            else offset.div(side, rounding_mode="floor")
        )
        first, last = (int(end) for end in torch.aminmax(cell))
        cells.append(cell - first)
        starts.append(first)
        counts.append(last + 1 - first)
    key = (cells[0] * counts[1] + cells[1]) * len(borders) + key
    present = torch.zeros(counts[0] * counts[1] * len(borders), dtype=torch.bool, device=at.device)
    present[key] = True
    some = torch.nonzero(present)[:, 0]
    number = present.cumsum(0, dtype=torch.int32).index_select(0, key) - 1
    cell = some.div(len(borders), rounding_mode="floor")
    row = cell.div(counts[1], rounding_mode="floor")
    places = [
        (index + start) * side + axis.middle + (0.0 if axis.odd else (side - 1) / 2)
        for index, start, axis in zip((row, cell - row * counts[1]), starts, middle, strict=True)
    ]
    return _Cells(torch.stack(places, 1), borders[some - cell * len(borders)], number)


def _border(near: Tensor, far: Tensor, shown: Tensor) -> Tensor:
    """A radius well between each near and far one [n], of few different ones.

    It is up to half of what is left of the far one's reach. A surface in front of an edge may rise
    towards it, like the top of a box seen from above: it hides nothing of itself, and a border but
    a little above the near radius would take its far end for what is hidden.
    """
    lasting = shown - near > (far - near) / 2
    low, high = (
        near + (far - near) * torch.where(lasting, most, least)
        for most, least in zip(_WELL_BETWEEN, _ALMOST_HIDDEN, strict=True)
    )
    middle, reach = (low + high) / 2, (high - low) / 2
    border = (middle * _GRAINS).round() / _GRAINS
    found = torch.zeros_like(border, dtype=torch.bool)
    unit = 2.0 ** math.ceil(math.log2(float(middle.abs().max()) + 1))
    while unit * _GRAINS >= 1:
        some = (middle / unit).round() * unit
        fits = ((some - middle).abs() <= reach) & ~found
        border, found = torch.where(fits, some, border), found | fits
        unit /= 2
    return border + _MORE

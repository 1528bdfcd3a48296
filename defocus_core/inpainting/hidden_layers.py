"""Hidden layers: surfaces behind depth edges, unseen by the pinhole but not by the aperture.

Neighbouring pixels whose radii differ by more than one px hold a depth edge: with |∇r| < 1 the map
from a lens point's picture to the pinhole's is one to one, beyond that a surface hides another.
From the whole aperture the farther surface shows up to r_far - r_near px behind the edge. There it
is continued by the colour and radius of what lies farther, near by first, and along the lines that
lead there. There is one hidden layer: where two wires cross before a wall, what goes on behind the
nearer one is the wire or the wall, whichever is the sharper one.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.images.box import Box
from defocus_core.images.neighbourhoods import halfway
from defocus_core.images.pyramid import Axis
from defocus_core.images.sparse_masks import numbers_of
from defocus_core.inpainting.coherence_transport import FARTHEST, transported
from defocus_core.inpainting.disocclusion import DECAY, STEP
from defocus_core.inpainting.frame_pyramid import Backdrop, backdrop
from defocus_core.inpainting.push_pull import Asked, continued, nearby
from defocus_core.inpainting.region_view import View, half_view, whole_view
from defocus_core.inpainting.two_layer_pyramid import Level, coarser, pixels_of

# Where between a near and a far radius the border is that tells them apart: where the far one is
# shown with more than half of its distance left, and where with less.
_BETWEEN, _NEARER = 0.377, 0.177
# Px of reach that are spent up to which lines go on behind an edge.
_LINES = 20.1 * DECAY
# The same up to which something may be next to a pixel.
_CLOSE = 4.1 * DECAY
# Resolutions, a quarter and less, that decide the direction of lines together.
_DIRECTIONS = 3
# Px on a side of the widest of the cells in which pixels are put together, or more.
_WIDEST = 6
# By how much what is next to a pixel counts more than what fills its surroundings.
_NEXT = 4.0


# Px around a region from which what it hides is continued.
PX_AROUND = FARTHEST + 2 + _WIDEST


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


def hidden_layer(
    image: Tensor,
    signed_radius: Tensor,
    beyond: Backdrop | None = None,
    box: Box | None = None,
    wanted: Box | None = None,
    *,
    halvings: int = 0,
) -> HiddenLayer | None:
    """Continue farther surfaces behind nearer ones, as far as the aperture sees them.

    Args:
        image: [C, H, W] linear.
        signed_radius: [H, W] px.
        beyond: The frame that this is a part of; None if it is the whole.
        box: Where in the frame it is.
        wanted: Where in it the layer matters; None if everywhere.
        halvings: How many times the resolution of the layer is halved, at most once.

    Returns:
        What is in `wanted`: what comes next behind each pixel. None where nothing is hidden.
    """
    H, W = signed_radius.shape
    beyond = beyond or backdrop(image, signed_radius)
    box = box or Box(0, 0, H, W)
    wanted = wanted or Box(0, 0, H, W)
    middle = (
        beyond.fine[0]._replace(middle=beyond.fine[0].middle - box.top),
        beyond.fine[1]._replace(middle=beyond.fine[1].middle - box.left),
    )
    view = whole_view(image, signed_radius, middle)
    half = coarser(pixels_of(view.picture, signed_radius, middle))
    if halvings:
        view = half_view(half, middle)
    seen = _Seen(beyond, view, half, box)
    whole, wanted = Box(0, 0, *view.near.shape), view.cells(wanted)
    # what is put together, is whole
    around = wanted.grown(_WIDEST >> halvings, whole)
    layer = _behind(seen, around.of(view.near), around)
    return layer and HiddenLayer(*map(wanted.seen_from(around).of, layer))


class _Seen(NamedTuple):
    """A part of a frame in which something is hidden.

    Attributes:
        beyond: The frame.
        view: The part.
        half: The same at half of the resolution.
        box: Where in the frame it is.
    """

    beyond: Backdrop
    view: View
    half: Level
    box: Box


def _behind(seen: _Seen, near: Tensor, around: Box) -> HiddenLayer | None:
    """The next surface behind some cells of a part; None if there is none.

    Args:
        seen: The part.
        near: [h, w] px, the surface in front.
        around: Where in the part these cells are.
    """
    beyond, view, half, box = seen
    halvings = view.halvings
    revealed = beyond.reach.behind(near, around, view.middle, halvings)
    behind = revealed.shown > near + STEP
    index = numbers_of(behind)
    if not len(index):
        return None
    y = index.div(around.width, rounding_mode="floor")
    at = torch.stack([y + around.top, index - y * around.width + around.left], 1)
    cone, far, front, ceiling = (x.flatten().index_select(0, index) for x in revealed)
    asked, spent = Asked(at, _border(front, far, cone), ceiling), far - cone
    found = far.new_zeros(len(at), len(view.picture))
    exists = torch.zeros_like(far, dtype=torch.bool)
    several = ceiling < torch.inf
    for some, side in (
        (several, 2),
        (~several & (spent <= _CLOSE), 2),
        (~several & (spent > _CLOSE), 4),
    ):
        some = torch.nonzero(some)[:, 0]
        if not len(some):
            continue
        few = asked.some(some)
        groups = _grouped(few, view.middle, side >> halvings)
        result, tensor, weight = _seen_coarsely(beyond, groups, view, box)
        if side == 2:
            result, weight = _with_what_is_next(result, weight, half, view, few)
        result = (result / torch.where(weight > 0, weight, 1.0)).T
        lines = torch.nonzero(spent.index_select(0, some) <= _LINES)[:, 0]
        if len(lines):
            spot, border, smooth = (x.index_select(0, lines) for x in (*few[:2], result))
            way = tensor.index_select(1, lines).T
            colors = transported(view.picture, spot, border, smooth, way, halvings)
            result = result.index_copy(0, lines, torch.cat([colors, smooth[:, -1:]], 1))
        found = found.index_copy(0, some, result)
        exists[some] = weight > 0
    if not bool(exists.all()):
        some = torch.nonzero(exists)[:, 0]
        index, found = index.index_select(0, some), found.index_select(0, some)
    blank = view.picture.new_zeros(len(view.picture) - 1, near.numel())
    color = blank.index_copy(1, index, found[:, :-1].T).reshape(-1, *near.shape)
    radius = near.flatten().index_copy(0, index, found[:, -1]).reshape(near.shape)
    mask = behind & (radius.detach() > near + STEP)
    return HiddenLayer(color, radius, mask)


def _seen_coarsely(
    beyond: Backdrop, groups: _Groups, view: View, box: Box
) -> tuple[Tensor, Tensor, Tensor]:
    """Colour and radius of cells [C + 1, n] times their weight, structure tensors, and weights."""
    at = view.pixels(groups.asked.at) + groups.asked.at.new_tensor(box[:2])
    asked = groups.asked._replace(at=at)
    finest, *levels = beyond.levels
    both, weight = nearby(finest, asked, beyond.fine)
    colors = [level.channels(slice(-3)) for level in levels]
    values, weight = continued((both[:-3], weight), colors, asked, beyond.fine)
    tensor = both[-3:]
    for level in levels[: _DIRECTIONS - 1]:
        tensors = level.channels(slice(-3, None))
        tensor = tensor + nearby(tensors, asked, beyond.fine)[0]
    result, tensor, weight = (x.index_select(-1, groups.of) for x in (values, tensor, weight))
    return result, tensor, weight


def _with_what_is_next(
    values: Tensor, weight: Tensor, half: Level, view: View, asked: Asked
) -> tuple[Tensor, Tensor]:
    """The same with what lies next to the pixels of cells, at half of the resolution, first."""
    offsets = (-0.25, 0.25) if view.halvings else (0.0,)
    offset = asked.border.new_tensor([(y, x) for y in offsets for x in offsets])
    n, count = len(asked.at), len(offset)
    spots = view.pixels((offset[:, None] + asked.at).flatten(0, 1))
    each = Asked(spots, asked.border.repeat(count), asked.ceiling.repeat(count))
    found, share = nearby(half, each, view.fine)
    found, share = found.reshape(-1, count, n).mean(1), share.reshape(count, n).mean(0)
    most = (share * _NEXT).clamp(max=1)
    left = 1 - most
    found = found * (most / torch.where(share > 0, share, 1.0))
    return torch.addcmul(found, values, left), torch.addcmul(most, weight, left)


class _Groups(NamedTuple):
    """Cells put together where what is seen coarsely is the same for them.

    Attributes:
        asked: m, by the rows and columns of their middles; the farthest border and ceiling.
        of: [n] to which of them each cell belongs.
    """

    asked: Asked
    of: Tensor


def _grouped(asked: Asked, middle: tuple[Axis, Axis], side: int) -> _Groups:
    """Squares of cells, symmetric about the middle of the frame.

    Args:
        asked: n cells.
        middle: Of the frame.
        side: Cells on a side, an even number or 1.
    """
    at = asked.at
    if side == 1:
        return _Groups(asked, torch.arange(len(at), device=at.device))
    numbers, firsts, counts = [], [], []
    for d, axis in enumerate(middle):
        offset = at[:, d] - axis.middle
        if axis.odd:  # away from the middle
            number = offset.sign() * (offset.abs() + side // 2 - 1).div(side, rounding_mode="floor")
        else:
            number = offset.div(side, rounding_mode="floor")
        first, last = (int(end) for end in torch.aminmax(number))
        numbers.append(number - first)
        firsts.append(first)
        counts.append(last + 1 - first)
    key = numbers[0] * counts[1] + numbers[1]
    present = torch.zeros(counts[0] * counts[1], dtype=torch.bool, device=at.device)
    present[key] = True
    cell = torch.nonzero(present)[:, 0]
    of = (present.cumsum(0, dtype=torch.int32) - 1).index_select(0, key).long()
    blank = torch.full_like(asked.border[:1], -torch.inf).repeat(len(cell))
    border, ceiling = (blank.scatter_reduce(0, of, x, "amax") for x in asked[1:])
    row = cell.div(counts[1], rounding_mode="floor")
    places = [
        ((number + first) * side + axis.middle).float() + (0.0 if axis.odd else (side - 1) / 2)
        for number, first, axis in zip((row, cell - row * counts[1]), firsts, middle, strict=True)
    ]
    return _Groups(Asked(torch.stack(places, 1), border, ceiling), of)


def _border(near: Tensor, far: Tensor, shown: Tensor) -> Tensor:
    """A radius between each near and far one [n].

    It is up to half of what is left of the far one's reach. A surface in front of an edge may rise
    towards it, like the top of a box seen from above: it hides nothing of itself, and a border but
    a little above the near radius would take its far end for what is hidden.
    """
    lasting = shown > halfway(near, far)
    return near + (far - near) * torch.where(lasting, _BETWEEN, _NEARER).to(near)

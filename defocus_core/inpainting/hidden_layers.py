"""Hidden layers: surfaces behind depth edges, unseen by the pinhole but not by the aperture.

Neighbouring pixels whose radii differ by more than one px hold a depth edge: with |∇r| < 1 the map
from a lens point's picture to the pinhole's is one to one, beyond that a surface hides another.
From the whole aperture the farther surface shows up to r_far - r_near px behind the edge. There it
is continued from the colour and radius of farther surfaces around, and along the lines that lead
there. Behind this first hidden layer a second one is made in the same way: where two wires cross
before a wall, the farther wire goes on behind the nearer one, and the wall behind both.
"""

from __future__ import annotations

import math
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

# Place of the border between a near and a far radius, in [0, 1]: where more than half of the far
# surface's reach is left, and where less.
_BETWEEN, _NEARER = 0.377, 0.177
# Spent reach in px up to which lines are continued behind an edge.
_LINES = 20.1 * DECAY
# Spent reach in px up to which the picture next to a pixel is read at half resolution.
_CLOSE = 4.1 * DECAY
# Number of levels, from a quarter down, whose structure tensors are summed.
_DIRECTIONS = 3
# Width in px of the widest group of cells, or more.
_WIDEST = 6
# Weight of the picture next to a pixel, relative to the coarser levels.
_NEXT = 4.0


def px_around(count: int) -> int:
    """Px around a region from which `count` hidden layers are continued."""
    return FARTHEST + 2 + count * _WIDEST


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


def hidden_layers(
    image: Tensor,
    signed_radius: Tensor,
    beyond: Backdrop | None = None,
    box: Box | None = None,
    wanted: Box | None = None,
    *,
    further: float = 0.0,
    halvings: int = 0,
) -> list[HiddenLayer]:
    """Continue farther surfaces behind nearer ones, as far as the aperture sees them.

    Args:
        image: [C, H, W] linear.
        signed_radius: [H, W] px.
        beyond: The pyramid of the frame that the image is a part of; None if it is the whole.
        box: The place of the image in the frame.
        wanted: The rectangle of the image to return; None for all of it.
        further: Greatest blur of the second hidden layer, as a multiple of the blur of the first;
            0 for no second layer.
        halvings: How many times the resolution of the layers is halved, at most once.

    Returns:
        The layers in `wanted`, from front to back: the next surface, and the one behind it where
        the aperture sees past both. Fewer where nothing is hidden.
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
    region = _Region(beyond, view, half, box)
    whole, wanted = Box(0, 0, *view.near.shape), view.cells(wanted)
    blurs = [math.inf, further] if further else [math.inf]
    near, among, layers = view.near, torch.ones_like(view.near, dtype=torch.bool), []
    at = whole
    for number, blur in enumerate(blurs):
        # grow the window so that no group of cells is cut
        around = wanted.grown((_WIDEST >> halvings) * (len(blurs) - number), whole)
        inner = around.seen_from(at)
        layer = _behind(region, inner.of(near), inner.of(among), around, blur)
        if layer is None:
            break
        layers.append((layer, around))
        near, among, at = layer.signed_radius.detach(), layer.mask, around
    return [HiddenLayer(*map(wanted.seen_from(around).of, layer)) for layer, around in layers]


class _Region(NamedTuple):
    """A region of a frame, and what hidden layers in it are continued from.

    Attributes:
        beyond: The pyramid of the frame.
        view: The region.
        half: The region at half resolution.
        box: The place of the region in the frame.
    """

    beyond: Backdrop
    view: View
    half: Level
    box: Box


def _behind(
    region: _Region, near: Tensor, among: Tensor, around: Box, blur: float
) -> HiddenLayer | None:
    """The next surface behind a rectangle of cells; None if nothing is hidden.

    Args:
        region: The region.
        near: [h, w] px, the surface in front.
        among: [h, w] bool, where this surface is.
        around: The rectangle of cells.
        blur: Greatest blur of the next surface, as a multiple of the blur in front.
    """
    beyond, view, half, box = region
    halvings = view.halvings
    revealed = beyond.reach.behind(near, around, view.middle, halvings)
    behind = among & (revealed.shown > near + STEP)
    if blur < math.inf:
        behind = behind & (revealed.source.abs() < near.abs() * blur)
    index = numbers_of(behind)
    if not len(index):
        return None
    y = index.div(around.width, rounding_mode="floor")
    at = torch.stack([y + around.top, index - y * around.width + around.left], 1)
    near_radius, cone, far, ceiling = (
        x.flatten().index_select(0, index) for x in (near, *revealed)
    )
    asked, spent = Asked(at, _border(near_radius, far, cone), ceiling), far - cone
    values = near_radius.new_zeros(len(at), len(view.picture))
    exists = torch.zeros_like(near_radius, dtype=torch.bool)
    several = ceiling < torch.inf
    for chosen, side in (
        (several, 2),
        (~several & (spent <= _CLOSE), 2),
        (~several & (spent > _CLOSE), 4),
    ):
        chosen = torch.nonzero(chosen)[:, 0]
        if not len(chosen):
            continue
        group_asked = asked.some(chosen)
        groups = _grouped(group_asked, view.middle, side >> halvings)
        result, tensor, weight = _from_pyramid(beyond, groups, view, box)
        if side == 2:
            result, weight = _with_neighbours(result, weight, half, view, group_asked)
        result = (result / torch.where(weight > 0, weight, 1.0)).T
        lines = torch.nonzero(spent.index_select(0, chosen) <= _LINES)[:, 0]
        if len(lines):
            spot, border, smooth = (x.index_select(0, lines) for x in (*group_asked[:2], result))
            tensors = tensor.index_select(1, lines).T
            colors = transported(view.picture, spot, border, smooth, tensors, halvings)
            result = result.index_copy(0, lines, torch.cat([colors, smooth[:, -1:]], 1))
        values = values.index_copy(0, chosen, result)
        exists[chosen] = weight > 0
    if not bool(exists.all()):
        chosen = torch.nonzero(exists)[:, 0]
        index, values = index.index_select(0, chosen), values.index_select(0, chosen)
    blank = view.picture.new_zeros(len(view.picture) - 1, near.numel())
    color = blank.index_copy(1, index, values[:, :-1].T).reshape(-1, *near.shape)
    radius = near.flatten().index_copy(0, index, values[:, -1]).reshape(near.shape)
    mask = behind & (radius.detach() > near + STEP)
    return HiddenLayer(color, radius, mask)


def _from_pyramid(
    beyond: Backdrop, groups: _Groups, view: View, box: Box
) -> tuple[Tensor, Tensor, Tensor]:
    """From the pyramid: colour and radius [C + 1, n] times weight, structure tensors, weights."""
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


def _with_neighbours(
    values: Tensor, weight: Tensor, half: Level, view: View, asked: Asked
) -> tuple[Tensor, Tensor]:
    """Values and weights, first from the picture next to each cell at half resolution."""
    offsets = (-0.25, 0.25) if view.halvings else (0.0,)
    offset = asked.border.new_tensor([(y, x) for y in offsets for x in offsets])
    n, count = len(asked.at), len(offset)
    spots = view.pixels((offset[:, None] + asked.at).flatten(0, 1))
    each = Asked(spots, asked.border.repeat(count), asked.ceiling.repeat(count))
    beside, beside_weight = nearby(half, each, view.fine)
    beside, beside_weight = (
        beside.reshape(-1, count, n).mean(1),
        beside_weight.reshape(count, n).mean(0),
    )
    most = (beside_weight * _NEXT).clamp(max=1)
    left = 1 - most
    beside = beside * (most / torch.where(beside_weight > 0, beside_weight, 1.0))
    return torch.addcmul(beside, values, left), torch.addcmul(most, weight, left)


class _Groups(NamedTuple):
    """Groups of neighbouring cells, which read the pyramid once for all.

    Attributes:
        asked: The middles of m groups, with the farthest border and ceiling in each.
        of: [n] the group of each cell.
    """

    asked: Asked
    of: Tensor


def _grouped(asked: Asked, middle: tuple[Axis, Axis], side: int) -> _Groups:
    """Group cells by squares, symmetric about the middle of the frame.

    Args:
        asked: n cells.
        middle: The middle of the frame.
        side: Width of a square in cells, an even number or 1.
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

    A surface in front of an edge may rise towards it, like the top of a box seen from above, and it
    does not hide itself. So the border is well above the near radius: else the far end of such a
    surface would be continued behind its near end.
    """
    lasting = shown > halfway(near, far)
    return near + (far - near) * torch.where(lasting, _BETWEEN, _NEARER).to(near)

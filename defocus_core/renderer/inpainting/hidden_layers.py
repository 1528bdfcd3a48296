"""Hidden layers: surfaces behind depth edges that the aperture sees and the pinhole does not.

Neighbouring pixels whose radii differ by more than one px have a depth edge between them: with
|∇r| < 1 the map from the picture of a lens point to that of the pinhole is one to one; beyond that,
one surface hides another. The whole aperture sees the farther surface up to r_far - r_near px
behind the edge. There the colour and radius of farther surfaces are continued, from the closest
pixels and along lines. There is one hidden layer: where two wires cross before a wall, the surface
continued behind the nearer wire is the other wire or the wall, whichever is sharper. A known layer
replaces the invented one.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.engine import limits
from defocus_core.renderer.inpainting.coherence_transport import transported
from defocus_core.renderer.inpainting.disocclusion import DECAY, STEP
from defocus_core.renderer.inpainting.frame_pyramid import Backdrop, backdrop_of
from defocus_core.renderer.inpainting.two_layer_pyramid import HiddenQueries, least_of, nearby
from defocus_core.renderer.layers.layer import HiddenLayer
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.neighbourhoods import flat_nonzero
from defocus_core.tensors.pyramid import Axis, halves

_Axes = tuple[Axis, Axis]


class CoarseGrid(NamedTuple):
    """The coarse pixels of a rectangle of a frame: single px, or 2 x 2 px at half resolution."""

    middle: _Axes  # where the middle of the frame is among coarse pixels
    fine: _Axes  # where the middle of the frame is among pixels
    level: int

    @classmethod
    def from_size(cls, size: tuple[int, int], fine: _Axes, level: int) -> CoarseGrid:
        """The coarse pixels of a rectangle that has `size` (height, width) in px."""
        if not level:
            return cls(fine, fine, 0)
        down, across = (halves(n, axis) for n, axis in zip(size, fine, strict=True))
        return cls((down.axis, across.axis), fine, level)

    def pixels(self, at: Tensor) -> Tensor:
        """Positions `at` [n, 2] in coarse pixels, converted to px; they may be fractional."""
        step = 1 << self.level
        positions = [
            (at[:, d] - axis.middle) * step + fine.middle + (0.0 if axis.odd else (step - 1) / 2)
            for d, (axis, fine) in enumerate(zip(self.middle, self.fine, strict=True))
        ]
        return torch.stack(positions, 1)

    def coarse(self, box: Box) -> Box:
        """The rectangle of coarse pixels that contain the pixels of `box`."""
        if not self.level:
            return box
        limits = []
        for start, length, axis, fine in zip(box[:2], box[2:], self.middle, self.fine, strict=True):
            half = halves(length, Axis(fine.middle - start, fine.odd))
            limits.append((axis.middle - half.axis.middle, half.length))
        return Box(limits[0][0], limits[1][0], limits[0][1], limits[1][1])


def hidden_layer(
    image: Tensor,  # [C, H, W] linear
    signed_radius: Tensor,  # [H, W] px
    backdrop: Backdrop | None = None,  # the frame that this is a part of; None if it is the whole
    box: Box | None = None,
    wanted: Box | None = None,  # where in it the layer matters; None if everywhere
    *,
    level: int = 0,
) -> HiddenLayer | None:
    """Continue farther surfaces behind nearer ones, where the aperture sees them.

    `box`: where the picture lies in the frame; `level`: 1 to continue at half the resolution.
    Returns the layer within `wanted`, or None if nothing is hidden there.
    """
    H, W = signed_radius.shape[-2:]
    backdrop = backdrop or backdrop_of(image, signed_radius)
    box, middle = box or Box(0, 0, H, W), backdrop.fine
    fine = (
        middle[0]._replace(middle=middle[0].middle - box.top),
        middle[1]._replace(middle=middle[1].middle - box.left),
    )
    grid = CoarseGrid.from_size((H, W), fine, level)
    coarse = grid.coarse(wanted or Box(0, 0, H, W))
    near = coarse.crop(least_of(signed_radius.detach(), fine) if level else signed_radius.detach())
    revealed = backdrop.reach.revealed(near, coarse, grid.middle, level)
    index = flat_nonzero(revealed.shown > near + STEP)
    if not len(index):
        return None
    row = index.div(coarse.width, rounding_mode="floor")
    at = torch.stack([row + coarse.top, index - row * coarse.width + coarse.left], 1)
    shown, source, front, ceiling = (x.flatten().index_select(0, index) for x in revealed)
    pixels = grid.pixels(at) + sent(box[:2], at)
    asked = HiddenQueries(pixels, front + (source - front) * limits.BORDER, ceiling)
    values, tensor, weight = _from_frame(backdrop, asked)
    values, weight = _with_adjacent_surface(values, weight, backdrop, asked, level)
    surface = values / weight.clamp(min=limits.LEAST_WEIGHT)[:, None]
    lines = torch.nonzero(source - shown <= limits.LINES * DECAY)[:, 0]
    if len(lines):
        if level:  # the whole frame
            half = backdrop.half
            picture = half.far[:-3]
            corner = [half.middle[d].middle - grid.middle[d].middle for d in (0, 1)]
        else:
            picture, corner = torch.cat([image, signed_radius[None]]), [0, 0]
        spot, border, smooth = (x.index_select(0, lines) for x in (at, asked.border, surface))
        way = tensor.index_select(0, lines)
        spot = spot + sent(corner, spot)
        colors = transported(picture, spot, border, smooth, way, level)
        surface = surface.index_copy(0, lines, torch.cat([colors, smooth[:, -1:]], 1))
    exists = weight > 0
    # the radius of no hidden surface is below all others
    radius = torch.where(exists, surface[:, -1], near.flatten().index_select(0, index))
    color = surface[:, :-1].T * exists
    blank = color.new_zeros(len(color), near.numel())
    color = blank.index_copy(1, index, color).reshape(-1, *near.shape)
    radius = near.flatten().index_copy(0, index, radius).reshape(near.shape)
    return HiddenLayer(color, radius, radius.detach() > near + STEP)


def _from_frame(backdrop: Backdrop, asked: HiddenQueries) -> tuple[Tensor, Tensor, Tensor]:
    """The farther surfaces around hidden pixels, from a quarter of the resolution and coarser.

    Weight missing at a level is taken from the next coarser one. Returns colour and radius
    [n, C + 1] times weights, structure tensors [n, 3], and weights [n].
    """
    first, *rest = backdrop.tables
    found, weights = nearby(first, asked)
    values, weight, tensor = found[0, :, :-3], weights[0], found[0, :, -3:]
    for more, fraction in zip(found[1:], weights[1:], strict=True):
        values, weight = _filled(values, weight, more[:, :-3], fraction)
        tensor = tensor + more[:, -3:]
    for table in rest:
        lacking = flat_nonzero(weight < limits.ENOUGH)
        if not len(lacking):
            break
        some = asked.select(lacking)
        own_values, own = values.index_select(0, lacking), weight.index_select(0, lacking)
        for more, fraction in zip(*nearby(table, some), strict=True):
            own_values, own = _filled(own_values, own, more[:, :-3], fraction)
        values = values.index_copy(0, lacking, own_values)
        weight = weight.index_copy(0, lacking, own)
    return values, tensor, weight


def _filled(
    values: Tensor, weight: Tensor, more: Tensor, fraction: Tensor
) -> tuple[Tensor, Tensor]:
    """Values [n, C + 1] and weights [n], completed from a coarser level where weight is missing.

    `more`, `fraction`: values and weights of the coarser level.
    """
    missing = (1 - weight) * (weight < limits.ENOUGH)
    return torch.addcmul(values, more, missing[:, None]), torch.addcmul(weight, fraction, missing)


def _with_adjacent_surface(
    values: Tensor, weight: Tensor, backdrop: Backdrop, asked: HiddenQueries, level: int
) -> tuple[Tensor, Tensor]:
    """Values and weights of hidden pixels at half resolution, completed by the given ones.

    The surface next to a pixel at half resolution comes first; `values` and `weight`, of coarser
    levels, add what is missing.
    """
    found, fractions = nearby(backdrop.adjacent, asked, 0.5 if level else 0.0)
    fraction = fractions[0]
    maximum = (fraction * limits.NEXT).clamp(max=1)
    left = 1 - maximum
    next_values = found[0] * (maximum / fraction.clamp(min=limits.LEAST_WEIGHT))[:, None]
    weight = torch.addcmul(maximum, weight, left)
    return torch.addcmul(next_values, values, left[:, None]), weight


def without_known(
    hidden: HiddenLayer, known: Tensor, known_radius: Tensor, middle: tuple[Axis, Axis]
) -> HiddenLayer:
    """An invented layer without the parts that known layers replace.

    `known`: [H, W] bool, where the hidden content is known up to `known_radius` [H, W] px;
    `middle`: the middle of the frame, in px.
    """
    limit = torch.where(known, known_radius.detach(), -torch.inf)
    if hidden.mask.shape != known.shape:
        limit = least_of(limit, middle)
    return hidden._replace(mask=hidden.mask & (hidden.signed_radius > limit + STEP))

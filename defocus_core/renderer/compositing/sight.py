"""Sight: how far the lens sees past opaque samples, and past the border of the frame.

The lens looks past a surface of radius r only where an edge of the surface lies within r px of the
pixel. So the farthest surface that the lens sees at a pixel is the farthest within the blur disc of
the pixel. Slices of a surface with slopes or steps leave gaps of a hundredth of its coverage: these
are errors, whatever lies behind.

Beyond the frame, surfaces are continued from its edge, but were not seen: trust is the share of the
aperture that sees the frame. If the blur is much wider than the frame, surfaces are continued for
only a part of its reach. Lens points that look farther see nothing, which surfaces behind must not
fill.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple, Self

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, max_pool2d, pad

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.cat_eye import Rim
from defocus_core.optics.parts import Part
from defocus_core.renderer.engine import limits
from defocus_core.renderer.layers.samples import ascending
from defocus_core.renderer.layers.slice_radii import slice_position
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.neighbourhoods import exceeding, flat_nonzero


class SightLimits(NamedTuple):
    """The farthest slice that the lens sees at each pixel."""

    farthest: Tensor  # [..., h, w], the number of the farthest slice that is seen
    layer_of: list[int]  # for each slice the number of its layer, ascending
    octaves: list[int]  # for each slice the octave of hidden surfaces, ascending

    @classmethod
    def from_radius(
        cls, radius: Tensor, positions: Tensor, layer_of: list[int], octaves: list[int]
    ) -> SightLimits:
        """How far the lens sees at each pixel of a picture.

        `radius`: [..., h, w] px, signed; `positions`: [..., h, w], fractional slice indices;
        `layer_of`, `octaves`: for each slice the number of its layer and its octave.
        """
        small = torch.uint8 if len(layer_of) <= torch.iinfo(torch.uint8).max else torch.int16
        slices = positions.detach().ceil().to(small)
        return cls(_greatest_within(slices, radius.detach().abs()), layer_of, octaves)

    def crop(self, box: Box) -> SightLimits:
        """The limits in a box."""
        return self._replace(farthest=box.crop(self.farthest))

    def to_layer(self, layer_index: int) -> Tensor:
        """Whether the lens sees past nearer surfaces to a layer: [..., h, w] bool."""
        return self.farthest >= bisect_left(self.layer_of, layer_index)

    def to_octave(self, octave: int) -> Tensor:
        """Whether the lens sees past nearer surfaces to a hidden octave: [..., h, w] bool."""
        return self.farthest >= bisect_left(self.octaves, octave)


def _greatest_within(values: Tensor, radius: Tensor) -> Tensor:
    """The greatest of values [..., h, w] up to `radius` [..., h, w] px away from each pixel."""
    px = radius.add(limits.SEEN_AROUND).mul_(limits.APOTHEM).round_().clamp_(min=1).to(torch.int32)
    sizes, greatest_px = [1], int(px.amax())
    while sizes[-1] < greatest_px:
        sizes.append(max(sizes[-1] + 1, round(limits.SEEN_RATIO * sizes[-1])))
    nearest = [
        min(range(len(sizes)), key=lambda i: abs(sizes[i] - n)) for n in range(sizes[-1] + 1)
    ]
    greatest = values.new_empty(len(sizes), values.numel())
    for number, (size, before) in enumerate(zip(sizes, [0, *sizes], strict=False)):
        square = limits.SQUARES[number % len(limits.SQUARES)]
        values = _dilated(values, size - before, square=square)
        greatest[number] = values.flatten()
    which = torch.tensor(nearest, device=px.device).index_select(0, px.flatten())
    return greatest.gather(0, which[None]).view_as(values)


def _dilated(values: Tensor, by: int, *, square: bool) -> Tensor:
    """The greatest of each value [..., h, w] and the values `by` px beside, above and below it.

    `square`: whether the values `by` px away on diagonals count, too.
    """
    greatest = values.clone()
    for dim in (-2, -1):
        given = greatest.clone() if square else values
        n = max(values.shape[dim] - by, 0)
        for target, source in ((by, 0), (0, by)):
            if n:
                part = greatest.narrow(dim, target, n)
                torch.maximum(part, given.narrow(dim, source, n), out=part)
    return greatest


# Neighbours are of two surfaces if their radii differ by more than this, in px and as a share of
# the radius; less is a slope.
_NEAR, _FAR = 0.25, 0.1
# Samples whose neighbours are looked up at once; bounds memory.
_SAMPLES_AT_ONCE = 1 << 18


class Openings(NamedTuple):
    """Where the lens sees past the nearest opaque sample of each pixel."""

    room: Tensor  # [h, w] from 0, where no edge of opaque samples is in reach, to 1
    layer_index: Tensor  # [h, w] of the layer that the sample is in; inf where there is none

    @classmethod
    def from_samples(cls, opaque: Tensor, radii: tuple[float, ...], layer_of: list[int]) -> Self:
        """The openings between opaque samples.

        `opaque`: [L, h, w], radii in px of the samples of each pixel; inf for samples that are not
        opaque; `radii`: signed radius of each slice in px; `layer_of`: for each slice the number of
        its layer.
        """
        nearest = opaque.detach().amin(0)
        position = slice_position(nearest.clamp(max=radii[-1]), radii).ceil().long()
        layer_index = sent(layer_of, nearest)[position]
        none = nearest == torch.inf
        room = _spread(_reach_of_edges(opaque)).clamp(0, 1)
        return cls(room.masked_fill(none, 1), layer_index.masked_fill(none, torch.inf))

    def crop(self, box: Box) -> Openings:
        """The openings in a box."""
        return Openings(*map(box.crop, self))

    def to_layer(self, layer_index: int) -> Tensor:
        """The share [h, w] of the pupil through which hidden parts of a layer may be seen."""
        return torch.where(self.layer_index < layer_index, self.room, 1)

    def to_octave(self, _: int) -> float:
        """The share for invented surfaces, always 1, as these fill the gaps left at the end."""
        return 1.0


def _reach_of_edges(opaque: Tensor) -> Tensor:
    """The greatest blur radius [h, w] px among the samples of each pixel that lie at an edge.

    A sample lies at an edge if a neighbouring pixel has no sample of similar radius.
    """
    count = int((opaque.detach() < torch.inf).sum(0).amax())
    if not count:
        return torch.zeros_like(opaque[0])
    opaque = opaque.gather(0, ascending(opaque))[:count]
    around = pad(opaque[:, None], (1, 1, 1, 1), mode="replicate")[:, 0].permute(1, 2, 0)
    rows = max(1, _SAMPLES_AT_ONCE // around[0].numel())
    bands = range(0, opaque.shape[1], rows)
    return torch.cat([_reach_in_band(around[top : top + rows + 2]) for top in bands])


def _reach_in_band(around: Tensor) -> Tensor:
    """`_reach_of_edges` for ascending radii [h + 2, w + 2, L], with a border of one pixel."""
    height, width, count = around.shape
    radius = around[1:-1, 1:-1].contiguous()
    ends = torch.zeros_like(radius, dtype=torch.bool)
    for y, x in ((0, 1), (2, 1), (1, 0), (1, 2)):
        beside = around[y : y + height - 2, x : x + width - 2].contiguous()
        above = torch.searchsorted(beside.detach(), radius.detach()).clamp(max=count - 1)
        steps = [
            (beside.gather(2, index) - radius).abs() for index in (above, (above - 1).clamp(min=0))
        ]
        ends |= ~(torch.minimum(*steps) <= _NEAR + _FAR * radius.abs())
    return torch.where(ends & (radius < torch.inf), radius.abs(), 0).amax(2)


def _spread(reach: Tensor) -> Tensor:
    """At each pixel [h, w], the maximum over all pixels of their reach minus their distance."""
    for step in range(math.ceil(float(reach.detach().amax())) - 1):
        beside = reach[None, None]
        if step % 2:  # squares and crosses in turn: an octagon is nearly a circle
            beside = torch.maximum(_pooled(beside, 3, 1), _pooled(beside, 1, 3))
        else:
            beside = _pooled(beside, 3, 3)
        reach = torch.maximum(reach, beside[0, 0] - 1)
    return reach


def _pooled(values: Tensor, height: int, width: int) -> Tensor:
    return max_pool2d(values, (height, width), 1, (height // 2, width // 2))


Sight = SightLimits | Openings

# Coverage that a pixel's own surface keeps where a measured pupil, with its light off the centre,
# may see nothing of the frame, so that a pixel at the border keeps its colour. And the same where
# an opaque middle may hide the frame: there errors of a small coverage are larger.
ASIDE, OPAQUE = 1e-6, 1e-3
# Intervals of the pupil's width in which areas are interpolated; errors stay below 5e-4.
_STEPS = 128


def fraction_in_frame(
    signed_radius: Tensor,  # [h, w] px
    box: Box,
    size: tuple[int, int],  # (height, width) of the rectangle
    aperture: Aperture,
    parts: list[Part],
    views: Sequence[Rim] = (),
) -> Tensor:
    """The share of each aperture part that sees a pixel's own surface within a rectangle.

    Lens point u images the surface at pixel q to q + r u: pixel x sees the surface at x - r u.

    `box`: where the pixels lie in the rectangle. Returns [M, 1, h, w] in [0.01, 1].
    """
    positions = (sent(torch.arange(s.first, s.end), signed_radius) + 0.5 for s in box.sides)
    # [h, 2] and [w, 2] px from both borders of an axis to a pixel
    down, across = (torch.stack([at, at - n], -1) for at, n in zip(positions, size, strict=True))
    nearest = torch.minimum(down.abs().amin(-1)[:, None], across.abs().amin(-1))
    index = flat_nonzero(exceeding(signed_radius.abs() - nearest, 0.0))
    rows = index.div(box.width, rounding_mode="floor")
    columns = index - rows * box.width
    r = signed_radius.flatten().index_select(0, index)[:, None]
    y, x = (
        (away / r).clamp(-1, 1)
        for away in (down.index_select(0, rows), across.index_select(0, columns))
    )
    # the frame is between two of the points u that see its corners, in x and in y
    corners = torch.stack([x[:, None].expand(-1, 2, -1), y[..., None].expand(-1, -1, 2)], -1)
    tables = [_areas_below(aperture, part, view) for part in parts for view in views or (None,)]
    areas, corners = sent(torch.stack(tables)[None], r), corners.reshape(1, -1, 4, 2)
    below = grid_sample(areas, corners, align_corners=True).view(len(tables), len(index), 4)
    within = (below[..., 0] + below[..., 3] - below[..., 1] - below[..., 2]).abs()
    fraction = signed_radius.new_ones(len(tables), *signed_radius.shape)
    fraction = fraction.flatten(1).index_copy(1, index, within.clamp(min=limits.IN_FRAME))
    return fraction.view(len(tables), 1, *signed_radius.shape)


def _areas_below(aperture: Aperture, part: Part, view: Rim | None) -> Tensor:
    """`_summed_area`, cached unless the pupil has gradients or varies over the frame."""
    if aperture.requires_grad:
        return _summed_area.__wrapped__(aperture, part, view)
    return (_summed_area.__wrapped__ if view else _summed_area)(aperture.fixed, part, view)


@lru_cache(maxsize=256)
def _summed_area(aperture: Aperture, part: Part, view: Rim | None) -> Tensor:
    """The share [y, x] of a part of the pupil whose coordinates are less than u.y and u.x.

    u.y and u.x are evenly spaced from -1 to 1.
    """
    with torch.inference_mode(False):  # the cache serves calls that need gradients, too
        limits = torch.linspace(-1, 1, _STEPS + 1, dtype=torch.float64)
        if part.is_uneven or view:
            r = torch.tensor(_STEPS / 2, dtype=torch.float64)
            below = aperture.kernel(r, _STEPS, part, view).cumsum(0).cumsum(1)
            return torch.nn.functional.pad(below, (1, 0, 1, 0))
        up_to = torch.stack([torch.full_like(limits, -1), limits], -1)
        return aperture.fraction_between(part, up_to[None], up_to[:, None])

"""Samples of a layer of the scene: pixels, their fringe, and further samples of the same pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.matting import Unmixed
from defocus_core.renderer.layers.slice_radii import membership, slice_position
from defocus_core.renderer.layers.subpixel_shifts import Shifts
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.sparse_masks import flat_nonzero

# Samples of pixels: [C + 1, H, W], colour premultiplied by coverage, then coverage; and [H, W],
# their radii in px, or their positions between slice radii.
Sheet = tuple[Tensor, Tensor]


class SurfaceSamples(NamedTuple):
    """A layer of the scene as samples with positions between slice radii."""

    color: Tensor  # [C, H, W]
    # [1, H, W], the share of each pixel that the layer covers; None if all are whole
    coverage: Tensor | None
    positions: Tensor  # [H, W] positions
    # [n, 2] rows and columns of fringe samples; rows are counted on from one picture of a batch
    # to the next
    at: Tensor
    extra: Tensor  # [n, C + 1] fringe samples: parts of nearer surfaces in the same pixels
    extra_positions: Tensor  # [n] positions of fringe samples
    slopes: Tensor | None  # [2, H, W] of the radius, px per px; None where no surface is tilted
    # Sub-pixel shifts of the colours near focus; None if they are not rendered
    shifts: Shifts | None
    others: Sequence[Sheet] = ()  # further samples of the same pixels, at their positions
    # The rectangle, counted from the first pixel, in which the pixels on the edge are repeated,
    # as the frame continues them; None to repeat none
    around: Box | None = None

    @classmethod
    def within(
        cls,
        box: Box,
        pixels: Unmixed,  # [C, H, W]
        positions: Tensor,  # [h, w] positions of the pixels in the box
        radii: tuple[float, ...],
        slopes: Tensor | None = None,  # [2, h, w] of the radius in the box
        shifts: Shifts | None = None,
        others: Sequence[Sheet] = (),  # further samples [C + 1, H, W] and their radii [H, W] px
    ) -> SurfaceSamples:
        """The samples of pixels in a box."""
        coverage, fringe = pixels.coverage, pixels.fringe
        at, extra, radius = fringe
        if len(at):
            height = pixels.color.shape[-2]
            above = at[:, 0].div(height, rounding_mode="floor")
            y, x = at[:, 0] - above * height - box.top, at[:, 1] - box.left
            inside = (y >= 0) & (x >= 0) & (y < box.height) & (x < box.width)
            at = torch.stack([y + above * box.height, x], 1)
            number = flat_nonzero(inside)
            at, extra, radius = (each.index_select(0, number) for each in (at, extra, radius))
        further = [(box.of(layer), slice_position(box.of(r), radii)) for layer, r in others]
        if len(further) > len(radii):
            further = _of_slices(further)
        return cls(
            box.of(pixels.color),
            None if coverage is None else box.of(coverage),
            positions,
            at,
            extra,
            slice_position(radius, radii),
            slopes,
            shifts,
            further,
        )


def _of_slices(sheets: list[Sheet]) -> list[Sheet]:
    """Samples of many sheets, at positions, summed to one sheet for each slice that holds any."""
    sums: dict[int, Tensor] = {}
    for layer, positions in sheets:
        present = positions.detach()[layer[-1] != 0]
        if not len(present):
            continue
        for k in range(math.floor(present.min()), math.ceil(present.max()) + 1):
            part = layer * membership(positions, sent([k], positions))
            sums[k] = sums[k] + part if k in sums else part
    return [(layer, torch.full_like(layer[0], k)) for k, layer in sums.items()]

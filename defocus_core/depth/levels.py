"""Levels of reduced resolution, on which large displacements of edges are corrected first.

At each halving of resolution a displacement becomes half as many px, so that the search over few px
finds it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from defocus_core.depth.displacement import (
    DEEPEST,
    Silhouette,
    edge_evidence,
    likely_shifts,
    moved,
    shifts_of,
    silhouette_of,
)
from defocus_core.depth.ramps import LEAST_SIDE, DistanceScale
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.later import Tensor, torch

# Greatest displacement that is looked for, as a share of the longer side of a picture.
_FRACTION = 0.01


class CoarseShifts(NamedTuple):
    """The displacements of edges that one level of reduced resolution shows."""

    level: int  # how many times resolution is halved
    field: Tensor  # [h, w] in coarse px, around silhouettes; 0 elsewhere
    median: float  # median displacement in px of full resolution


def coarse_shifts(
    signed_radius: Tensor,  # [H, W] px, without ramps
    pixels: Tensor,  # [C, H, W] linear
    *,
    step: float,  # least step in px of an edge
    scale: DistanceScale | None = None,
    reach: float = 0.0,  # px of displacement to look for at least
    threads: int = 1,
) -> list[CoarseShifts]:
    """The displacements found at each reduced level, coarsest first.

    At each level, those of coarser levels are corrected before what is left is measured.
    """
    size = (signed_radius.shape[-2], signed_radius.shape[-1])
    reach = max(_FRACTION * max(size), reach)
    levels = max(0, math.ceil(math.log2(reach / DEEPEST)))
    while levels and min(size) < LEAST_SIDE << levels:
        levels -= 1
    pyramid = [(signed_radius, pixels)]
    for _ in range(levels):
        pyramid.append(_halved(*pyramid[-1]))
    found: list[CoarseShifts] = []
    for level in range(levels, 0, -1):
        radii, colors = pyramid[level]
        radii = with_coarse_shifts(radii, found, step, scale, level)
        silhouette = silhouette_of(radii, step, scale)
        if silhouette is None:
            continue
        evidence = edge_evidence(silhouette, radii, colors, threads)
        shifts, _ = shifts_of(evidence, step)
        shift = likely_shifts(evidence, shifts)
        field = _field_of(silhouette, shift, radii)
        found.append(CoarseShifts(level, field, shifts.median * (1 << level)))
    return found


def with_coarse_shifts(
    signed_radius: Tensor,  # [H, W] px of a level
    found: Sequence[CoarseShifts],
    step: float,
    scale: DistanceScale | None,
    level: int = 0,
) -> Tensor:
    """Radii [H, W] px of a level with edges moved by coarse displacements, one after another.

    `step`, `scale`: as for `coarse_shifts`; `level`: of the radii, 0 for full resolution.
    """
    for each in found:
        silhouette = silhouette_of(signed_radius.detach(), step, scale)
        if silhouette is None:
            break
        shift = _read_at(each.field, silhouette.at.T.double(), signed_radius.shape)
        signed_radius = moved(signed_radius, silhouette, shift * (1 << (each.level - level)))
    return signed_radius


def _read_at(field: Tensor, at: Tensor, size: tuple[int, ...]) -> Tensor:
    """Values [n] of a field [h, w], interpolated linearly.

    `at`: [2, n] rows and columns in a picture of `size` (height, width), which the field covers.
    """
    places = (2 * at + 1) / sent([[size[0]], [size[1]]], at) - 1
    places = places.flip(0).T[None, None].to(field.dtype)
    read = torch.nn.functional.grid_sample(
        field[None, None], places, padding_mode="border", align_corners=False
    )
    return read[0, 0, 0].double()


def _halved(signed_radius: Tensor, pixels: Tensor) -> tuple[Tensor, Tensor]:
    """Radii and colours at half the resolution.

    A pixel gets the second least radius and the mean colour of 2×2 px.
    """
    H, W = signed_radius.shape
    radii, colors = (
        torch.nn.functional.pad(each.detach()[None], (0, W % 2, 0, H % 2), mode="replicate")[0]
        for each in (signed_radius[None], pixels)
    )
    four = torch.stack([radii[0, y::2, x::2] for y in (0, 1) for x in (0, 1)])
    return four.sort(0).values[1].contiguous(), torch.nn.functional.avg_pool2d(colors, 2)


def _field_of(silhouette: Silhouette, shift: Tensor, radii: Tensor) -> Tensor:
    """Displacements [n] of a silhouette as a field [h, w]: means over 5×5 px; 0 beyond."""
    both = shift.new_zeros(2, radii.numel(), dtype=torch.float32)
    number = silhouette.at[:, 0] * radii.shape[1] + silhouette.at[:, 1]
    both[:, number] = torch.stack([shift, torch.ones_like(shift)]).float()
    total, count = torch.nn.functional.avg_pool2d(both.view(2, 1, *radii.shape), 5, 1, 2)[:, 0]
    return torch.where(count > 0, total / count.clamp(min=1e-3), 0.0)

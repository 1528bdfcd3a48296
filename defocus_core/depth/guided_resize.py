"""Depth of another size than its picture, enlarged with edges where the colours change.

Disparity is interpolated linearly between coarse pixels, those of the given depth, but hard edges
stay hard. Then edges are repaired as those of any estimated depth.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from defocus_core.depth.diagnosis import diagnosed
from defocus_core.depth.displacement import least_step
from defocus_core.depth.repair import repair_depth
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import in_bands
from defocus_core.tensors.neighbourhoods import halfway
from defocus_core.tensors.pyramid import coarse_neighbours, linear
from defocus_core.tensors.validation import described

# Range of radii in px for which the depth is repaired.
_RANGE_PX = 30.0
# Greatest displacement of an edge, in coarse pixels.
_REACH = 2
# Width in px of edges without ramps.
_HARD = 1.0


def guided_depth(depth: Tensor, image: Tensor, threads: int = 1) -> Tensor:
    """Depth at the size of a picture, its edges moved to those of the colours.

    Args:
        depth: [h, w], positive, in any unit; inf is sky. It covers the same field of view as the
            picture.
        image: [C, H, W], linear light.
        threads: Number of bands of rows computed at once.

    Returns:
        [H, W], in the unit and the precision of the depth.

    Raises:
        ValueError: If `depth` is not [h, w] of positive floating-point numbers.
    """
    if depth.dim() != 2 or not depth.is_floating_point() or not bool((depth > 0).all()):
        problem = f"depth must be [h, w] of positive floats, got {described(depth)}"
        raise ValueError(f"{problem}; inf is sky")
    size = (image.shape[-2], image.shape[-1])
    disparity = 1 / depth.double()
    farthest, nearest = float(disparity.min()), float(disparity.max())
    span = nearest - farthest
    scale = -_RANGE_PX / span if 0 < span < math.inf else -1.0
    coarse = (disparity * scale).to(depth.dtype)  # in focus at infinity
    soft = diagnosed(coarse, 0.0, 1).soft_edges is not None
    step = least_step(coarse, None)

    def enlarged(box: Box) -> Tensor:
        rows, columns = ((first, end) for first, end in box.sides)
        radii = linear(coarse, rows, columns, size)
        return radii if soft else _snapped(radii, coarse, rows, columns, size, step)

    radius = in_bands(enlarged, size, depth.device, threads=threads)
    if 0 < span < math.inf:
        pitch = max(size[0] / depth.shape[0], size[1] / depth.shape[1])
        radius, _ = repair_depth(
            radius, image, 0.0, threads, edge_width=None if soft else _HARD, reach=_REACH * pitch
        )
    return (1 / (radius / scale).clamp(min=0).abs()).to(depth.dtype)


GuidedDepth = guided_depth  # its name in 0.1


def _snapped(
    radii: Tensor,
    coarse: Tensor,
    rows: tuple[int, int],
    columns: tuple[int, int],
    size: tuple[int, int],
    step: float,
) -> Tensor:
    """Interpolated radii [H, W] px, but across an edge the radius of one of its two surfaces.

    Where the coarse pixels around span more than `step` px, a pixel gets the least or the greatest
    of their radii, whichever is closer. `rows`, `columns`: (first, end) of the window in the
    picture of `size` (height, width).
    """
    nearest = farthest = coarse
    for dim, (first, end) in enumerate((rows, columns)):
        before, after, _ = coarse_neighbours(coarse, dim, first, end, size[dim])
        nearest, farthest = (
            choice(values.index_select(dim, before), values.index_select(dim, after))
            for values, choice in ((nearest, torch.minimum), (farthest, torch.maximum))
        )
    closer = torch.where(radii < halfway(nearest, farthest), nearest, farthest)
    return torch.where(farthest - nearest > step, closer, radii)

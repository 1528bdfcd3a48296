"""Pictures at reduced resolution, read in between: by cubics if they are smooth, else by tents."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from defocus_core.halving import Axis, place_of
from defocus_core.tiling import Box


def cubic_shares(first: float, pixels: int, cells: int, step: float, like: Tensor) -> Tensor:
    """The shares [pixels, cells] of cells in pixels: the cubic of Keys 1981 with a = -1/2.

    Args:
        first: Where the first pixel lies, counted in cells from the first of these.
        pixels: How many there are.
        cells: The same.
        step: Cells from one pixel to the next.
        like: Of the dtype and device of the result.
    """
    away = _away(first, pixels, cells, step, like)
    near = (1.5 * away - 2.5) * away * away + 1
    far = ((2.5 - 0.5 * away) * away - 4) * away + 2
    return torch.where(away < 1, near, torch.where(away < 2, far, 0.0))


def linear_shares(first: float, pixels: int, cells: int, step: float, like: Tensor) -> Tensor:
    """The same by tents: nothing overshoots beside an edge."""
    return (1 - _away(first, pixels, cells, step, like)).clamp(min=0)


def _away(first: float, pixels: int, cells: int, step: float, like: Tensor) -> Tensor:
    """How many cells each pixel is away from each cell: [pixels, cells]."""
    place = torch.arange(pixels, dtype=like.dtype, device=like.device) * step + first
    number = torch.arange(cells, dtype=like.dtype, device=like.device)
    return (place[:, None] - number).abs()


def resampled(values: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Cells [..., h, w] read in pixels [..., H, W] by shares [H, h] and [W, w].

    Not in fewer bits than they have, whatever torch may round products to: TensorFloat32 or
    bfloat16 (`torch.set_float32_matmul_precision`), too coarse for a picture.
    """
    if values.dtype != torch.float32 or not _products_are_rounded():
        return rows @ values @ columns.mT
    return (rows.double() @ values.double() @ columns.double().mT).float()


def _products_are_rounded() -> bool:
    """Whether torch may compute products of float32 matrices in fewer bits on some device."""
    try:
        return torch.get_float32_matmul_precision() != "highest"
    except RuntimeError:  # it was set for one device alone
        return True


def cells_read(box: Box, fine: tuple[Axis, Axis], coarse: tuple[Axis, Axis], halvings: int) -> Box:
    """The cells between which the pixels of a rectangle lie."""
    first, end = [], []
    for d, axes in enumerate(zip(fine, coarse, strict=True)):
        first.append(math.floor(place_of(box[d], *axes, halvings)))
        end.append(math.floor(place_of(box[d] + box[d + 2] - 1, *axes, halvings)) + 2)
    return Box(first[0], first[1], end[0] - first[0], end[1] - first[1])

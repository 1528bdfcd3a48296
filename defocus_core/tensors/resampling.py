"""Interpolation of pictures at reduced resolution: cubic where smooth, else linear."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.pyramid import Axis, position_of

# Coarse pixels from one block of pixels to the next: products with larger ones are mostly with
# zeros.
_STRIDE = 8


class AxisWeights(NamedTuple):
    """The shares of coarse px in pixels along an axis, the same in all blocks of pixels."""

    block: Tensor  # [P, K] shares of K coarse pixels in the P pixels of a block
    lead: int  # the first coarse pixel of the first block; missing coarse pixels count as 0
    pixels: int


def cubic_weights(first: float, pixels: int, step: float, like: Tensor) -> AxisWeights:
    """The cubic of Keys 1981 with a = -1/2."""
    away, lead = _away(first, pixels, step, 2, like)
    near = (1.5 * away - 2.5) * away * away + 1
    far = ((2.5 - 0.5 * away) * away - 4) * away + 2
    block = torch.where(away < 1, near, torch.where(away < 2, far, 0.0))
    return AxisWeights(sent(block, like), lead, pixels)


def linear_weights(first: float, pixels: int, step: float, like: Tensor) -> AxisWeights:
    """Linear interpolation, without overshoot beside an edge; arguments of `cubic_weights`."""
    away, lead = _away(first, pixels, step, 1, like)
    return AxisWeights(sent((1 - away).clamp(min=0), like), lead, pixels)


def _away(first: float, pixels: int, step: float, reach: int, like: Tensor) -> tuple[Tensor, int]:
    """Distances from each pixel of a block to the coarse pixels in reach, and the first of these.

    Distances are the same in all blocks, whose first pixels are whole numbers of coarse pixels
    apart. They are few: on the CPU.
    """
    block = min(pixels, round(_STRIDE / step))
    lead = math.floor(first) - reach + 1
    start = torch.arange(block, dtype=like.dtype) * step + (first - lead)
    taps = math.floor(first - lead + (block - 1) * step) + reach + 1
    tap = torch.arange(taps, dtype=like.dtype)
    return (start[:, None] - tap).abs(), lead


def resampled(values: Tensor, rows: AxisWeights, columns: AxisWeights) -> Tensor:
    """Coarse pixels [..., h, w] read in pixels [..., H, W].

    In full precision, even where `torch.set_float32_matmul_precision` allows TensorFloat32 or
    bfloat16 for products, which are too coarse for a picture.
    """
    if values.dtype == torch.float32 and _products_are_rounded():
        double = (
            fractions._replace(block=fractions.block.double()) for fractions in (rows, columns)
        )
        return resampled(values.double(), *double).float()
    h, w = values.shape[-2:]
    missing = (*_missing(columns, w), *_missing(rows, h))
    if any(missing):
        values = pad(values, missing)
    across = values.unfold(-1, columns.block.shape[1], _STRIDE)  # [..., h, n, K]
    wide = across.reshape(-1, across.shape[-1]) @ columns.block.mT
    wide = wide.view(*across.shape[:-2], -1)[..., : columns.pixels]
    down = wide.unfold(-2, rows.block.shape[1], _STRIDE).mT  # [..., n, K, W]
    return _products(rows.block, down).flatten(-3, -2)[..., : rows.pixels, :]


def linear(
    coarse: Tensor, rows: tuple[int, int], columns: tuple[int, int], size: tuple[int, ...]
) -> Tensor:
    """Coarse pixels [h, w] read in a window of a picture of a size by linear interpolation."""
    values = coarse
    for dim, (first, end) in enumerate((rows, columns)):
        before, after, fraction = beside(coarse, dim, first, end, size[dim])
        low, high = values.index_select(dim, before), values.index_select(dim, after)
        values = low + fraction.unsqueeze(1 - dim) * (high - low)
    return values


def beside(
    coarse: Tensor, dim: int, first: int, end: int, length: int
) -> tuple[Tensor, Tensor, Tensor]:
    """The coarse pixels before and after each pixel of an axis, and where it lies between them."""
    count = coarse.shape[dim]
    position = torch.arange(first, end, dtype=coarse.dtype, device=coarse.device) + 0.5
    position = (position * count / length - 0.5).clamp(0, count - 1)
    before = position.long().clamp(max=max(count - 2, 0))
    return before, (before + 1).clamp(max=count - 1), position - before


def _products(block: Tensor, down: Tensor) -> Tensor:
    """The products [..., n, P, W] of shares [P, K] and coarse pixels [..., n, K, W]."""
    if torch.is_grad_enabled():
        return block @ down
    every = block.expand(down.shape[-3], -1, -1)
    products = down.new_empty(*down.shape[:-2], len(block), down.shape[-1])
    # one picture at a time: blocks share coarse pixels, which a product of all would copy
    for one, result in zip(down.flatten(0, -4), products.flatten(0, -4), strict=True):
        torch.bmm(every, one, out=result)
    return products


def _missing(fractions: AxisWeights, length: int) -> tuple[int, int]:
    """How many coarse pixels blocks need before and after those of an axis of a length."""
    block, taps = fractions.block.shape
    needed = (-(-fractions.pixels // block) - 1) * _STRIDE + taps
    return -fractions.lead, fractions.lead + needed - length


def _products_are_rounded() -> bool:
    """Whether torch may compute products of float32 matrices in fewer bits on some device."""
    try:
        return torch.get_float32_matmul_precision() != "highest"
    except RuntimeError:  # it was set for one device alone
        return True


def coarse_read(box: Box, fine: tuple[Axis, Axis], coarse: tuple[Axis, Axis], level: int) -> Box:
    """The coarse pixels between which the pixels of a rectangle lie."""
    first, end = [], []
    for d, axes in enumerate(zip(fine, coarse, strict=True)):
        first.append(math.floor(position_of(box[d], *axes, level)))
        end.append(math.floor(position_of(box[d] + box[d + 2] - 1, *axes, level)) + 2)
    return Box(first[0], first[1], end[0] - first[0], end[1] - first[1])

"""Blocks of 16 px that hold a slice, and the tiles that these blocks reach."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.renderer.layers.slice_radii import slice_before
from defocus_core.tensors.box import Box, Span
from defocus_core.tensors.tiling import BLOCK

# Blocks that are tested against tiles at once: bounds memory.
_COUNTED = 1 << 21


def visible_slices(blocks: Tensor, reaches: list[int], tiles: list[Box]) -> list[list[int]]:
    """For each tile the indices of the slices whose blur reaches it, nearest first.

    `blocks`: [K, rows, columns] bool, from `blocks_of` and `blocks_at`; `reaches`: blur radius of
    each slice, in px.
    """
    reached = []
    down, across = ([tile.sides[d] for tile in tiles] for d in (0, 1))
    rows, columns = list(dict.fromkeys(down)), list(dict.fromkeys(across))
    for chunk in torch.split(torch.arange(len(reaches)), max(1, _COUNTED // blocks[0].numel())):
        occupied = blocks[chunk[0] : chunk[-1] + 1].float().cpu()
        reach = torch.tensor(reaches)[chunk, None]
        within = (
            _reached(rows, reach, occupied.shape[1]),
            _reached(columns, reach, occupied.shape[2]),
        )
        reached.append(within[0] @ occupied @ within[1].mT > 0)  # [K, rows, columns] of tiles
    reaching = torch.cat(reached).permute(1, 2, 0)
    return [
        torch.nonzero(reaching[rows.index(y), columns.index(x)])[:, 0].tolist()
        for y, x in zip(down, across, strict=True)
    ]


def _reached(sides: list[Span], reach: Tensor, count: int) -> Tensor:
    """Which of `count` blocks along an axis are within reach [K, 1] px of sides: [K, n, count]."""
    first, end = (
        torch.tensor([getattr(side, name) for side in sides]) for name in ("first", "end")
    )
    first_block, end_block = (first - reach) // BLOCK, -((-end - reach) // BLOCK)
    block = torch.arange(count)
    return ((block >= first_block[..., None]) & (block < end_block[..., None])).float()


def blocks_of(
    positions: Tensor, slices: int, present: Tensor | None = None, sharp: int | None = None
) -> Tensor:
    """For each slice the blocks of 16 px that hold a pixel of it: [K, rows, columns] bool.

    `positions`: [..., H, W] positions of pixels among the slice radii, of any picture of a batch.
    If they learn, a pixel on a slice is in the one before, too: its share in this is 0, and has a
    gradient; `present`: [..., H, W] bool, which pixels exist; None if all do; `sharp`: the slice in
    focus, on which shares have no gradient; None if there is none.
    """
    if present is not None:
        at = torch.nonzero(present)
        size = positions.shape[-2], positions.shape[-1]
        return blocks_at(positions[at.unbind(1)], at[:, -2:], slices, size, sharp)
    learn, positions = positions.requires_grad, positions.detach()

    def beside(place: Tensor) -> tuple[Tensor, Tensor]:
        return _slices_beside(place, slices, sharp, learn=learn)

    extremes = block_ranges(positions)
    occupied = torch.zeros((*extremes[0].shape, slices), dtype=torch.bool, device=positions.device)
    least, greatest = map(beside, extremes)
    for slice_index in (*least, *greatest):
        occupied.scatter_(-1, slice_index[..., None], True)
    # which slices between the least and the greatest have a pixel?
    several = torch.nonzero(greatest[0] - least[-1] > 1)
    if len(several):
        mixed = _in_blocks(positions).transpose(-3, -2)[several.unbind(1)].flatten(1)
        slices_held = torch.zeros((len(several), slices), dtype=torch.bool, device=positions.device)
        for slice_index in beside(mixed):
            slices_held.scatter_(1, slice_index, True)
        occupied[several.unbind(1)] = slices_held
    occupied = occupied if occupied.dim() == 3 else occupied.any(0)
    return occupied.permute(2, 0, 1)


def block_ranges(values: Tensor) -> tuple[Tensor, Tensor]:
    """The least and the greatest value of each block of [..., H, W]."""
    blocks = _in_blocks(values)
    return blocks.amin(-3).amin(-1), blocks.amax(-3).amax(-1)


def _in_blocks(values: Tensor) -> Tensor:
    """Values [..., H, W] as [..., rows, 16, columns, 16]; past the border the last one repeats."""
    rest = (0, -values.shape[-1] % BLOCK, 0, -values.shape[-2] % BLOCK)
    padded = pad(values.reshape(-1, *values.shape[-2:]), rest, mode="replicate")
    padded = padded.view(*values.shape[:-2], *padded.shape[-2:])
    return torch.unflatten(torch.unflatten(padded, -1, (-1, BLOCK)), -3, (-1, BLOCK))


def blocks_at(
    positions: Tensor, at: Tensor, slices: int, size: tuple[int, int], sharp: int | None = None
) -> Tensor:
    """As `blocks_of`, for n samples: their places [n], and their rows and columns [n, 2].

    Rows may be counted on from one picture of a batch to the next.
    """
    rows, columns = (-(-n // BLOCK) for n in size)
    occupied = torch.zeros(slices * rows * columns, dtype=torch.bool, device=positions.device)
    row, column = (
        x.div(BLOCK, rounding_mode="floor") for x in (at[:, 0].remainder(size[0]), at[:, 1])
    )
    number = row * columns + column
    beside = _slices_beside(positions.detach(), slices, sharp, learn=positions.requires_grad)
    for slice_index in beside:
        occupied.index_fill_(0, slice_index * (rows * columns) + number, True)
    return occupied.view(slices, rows, columns)


def _slices_beside(
    positions: Tensor, count: int, sharp: int | None, *, learn: bool
) -> tuple[Tensor, Tensor]:
    """The slices before and after positions, which may be one."""
    before, after = positions.floor(), positions.ceil()
    if learn and torch.is_grad_enabled():
        between = torch.ones_like(positions, dtype=torch.bool)
        if sharp is not None:
            between = positions != sharp
        before = torch.where(between, slice_before(positions), before)
        after = torch.where(between, (before + 1).clamp(max=count - 1), after)
    return before.long(), after.long()

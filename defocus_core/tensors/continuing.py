"""Beyond the frame: what is on its edge goes on."""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.tensors.box import Box


def continue_edges(values: Tensor, given: Box) -> None:
    """Repeat the edges of a rectangle of values [..., H, W] all around it, in place."""
    for dim, side in zip((-2, -1), given.sides, strict=True):
        length = values.shape[dim]
        edges = ((side.first, 0, side.first), (side.end - 1, side.end, length - side.end))
        for edge, start, count in edges:
            if count:
                values.narrow(dim, start, count).copy_(values.narrow(dim, edge, 1))


def positions_continued(at: Tensor, size: tuple[int, int], box: Box) -> tuple[Tensor, Tensor]:
    """Rows and columns of samples of which those on an edge are repeated all around.

    `at`: [n, 2] rows and columns of samples; rows are counted on from one picture of a batch to the
    next, here and in the result; `size`: (height, width) of the values that they are of. Returns
    [m, 2] rows and columns in the rectangle, and the numbers [m] of the samples that are there.
    """
    number = torch.arange(len(at), device=at.device)
    above = at[:, 0].div(size[0], rounding_mode="floor")
    at = torch.stack([at[:, 0] - above * size[0], at[:, 1]], 1)
    for dim, (side, length) in enumerate(zip(box.sides, size, strict=True)):
        positions, numbers = [at], [number]
        steps = (0, range(side.first, 0)), (length - 1, range(1, side.end - length + 1))
        for edge, away in steps:
            on_edge = torch.nonzero(at[:, dim] == edge)[:, 0]
            if not len(away) or not len(on_edge):
                continue
            moved = at[on_edge].repeat(len(away), 1)
            moved[:, dim] += torch.tensor(away, device=at.device).repeat_interleave(len(on_edge))
            positions.append(moved)
            numbers.append(number[on_edge].repeat(len(away)))
        at, number = torch.cat(positions), torch.cat(numbers)
    row = at[:, 0] - box.top + above.index_select(0, number) * box.height
    return torch.stack([row, at[:, 1] - box.left], 1), number


def level_beyond(slopes: Tensor, box: Box) -> Tensor:
    """Slopes [2, ..., H, W], x and y, in a rectangle around them: beyond an edge only along it."""
    H, W = slopes.shape[-2:]
    given = Box(-box.top, -box.left, H, W)
    if box == given:
        return slopes
    whole = slopes.new_zeros(*slopes.shape[:-2], box.height, box.width)
    given.of(whole).copy_(slopes)
    rows, columns = given.sides
    continue_edges(whole[0, ..., columns.first : columns.end], given._replace(left=0))
    continue_edges(whole[1, ..., rows.first : rows.end, :], given._replace(top=0))
    return whole

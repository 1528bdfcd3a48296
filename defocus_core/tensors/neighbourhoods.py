"""Neighbourhoods of pixels: least and greatest values, steps, the pixels themselves."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor


class Choice(Protocol):
    """torch.maximum or torch.minimum: the greater or the less of two tensors."""

    def __call__(self, a: Tensor, b: Tensor, /, *, out: Tensor) -> Tensor:
        """Write the choice to `out`."""


def extreme_around(values: Tensor, by: int, choice: Choice) -> Tensor:
    """The greatest or least value [..., H, W] in the square around each pixel; has no gradient.

    Squares end at the borders. Each round joins squares side by side: 8 px take three.

    `values`: [..., H, W], numbers or bool; `by`: distance in px from a pixel to the sides of its
    square.
    """
    values = values.detach()
    for dim in (-2, -1):
        reached = 0
        while step := min(by - reached, 2 * reached + 1, values.shape[dim] - 1):
            values = _joined(values, step, dim, choice)
            reached += step
    return values


def steps_beside(values: Tensor, dim: int) -> tuple[Tensor, Tensor, Tensor]:
    """Sizes of steps along an axis: before each step, of the step itself, and after it.

    n pixels have n - 3 steps that lie between two others.
    """
    step = values.detach().diff(dim=dim).abs()
    n = max(step.shape[dim] - 2, 0)
    before, middle, after = (step.narrow(dim, i if n else 0, n) for i in range(3))
    return before, middle, after


def squares_around(at: Tensor, size: tuple[int, int], by: int = 1) -> Tensor:
    """The numbers [n, side, side] of the pixels in the squares around pixels at [n, 2].

    Beyond the borders of the frame the pixels at the border are repeated.

    `at`: [n, 2] rows and columns; rows are counted on from one picture of a batch to the next;
    `size`: (height, width) of the frame; `by`: distance in px from a pixel to the sides of its
    square.
    """
    offset = torch.arange(-by, by + 1, device=at.device)
    row = at[:, :1].remainder(size[0])
    y = ((row + offset).clamp_(0, size[0] - 1) + (at[:, :1] - row))[:, :, None]
    x = (at[:, 1:] + offset).clamp(0, size[1] - 1)[:, None, :]
    return y * size[1] + x


def _joined(values: Tensor, step: int, dim: int, choice: Choice) -> Tensor:
    """The extreme of each value and the values `step` px before and after it, cut at the ends."""
    extreme, n = values.clone(), values.shape[dim]
    rest = n - step
    parts = [((step, rest), (0, rest)), ((0, rest), (step, rest))]
    if step > 1:  # else the ends are themselves
        parts += [((0, step), (0, 1)), ((rest, step), (n - 1, 1))]
    for target, source in parts:
        part = extreme.narrow(dim, *target)
        choice(part, values.narrow(dim, *source), out=part)
    return extreme


def range_of(values: Tensor) -> Tensor:
    """The least and the greatest [2] of values [...]; NaN if any value is NaN.

    Two passes: on a CPU torch.aminmax takes longer, and four times as long where rows are not
    contiguous.
    """
    return torch.stack([values.amin(), values.amax()])


def ranges_of(pictures: Tensor) -> Tensor:
    """The least and the greatest value [..., 2] of each picture of a batch [..., H, W]."""
    if pictures.dim() == 2:
        return range_of(pictures)
    return torch.stack([pictures.amin((-2, -1)), pictures.amax((-2, -1))], -1)


# Where the border between a near and a far radius lies; below 1/2, so that a middle one is far.
_HALFWAY = 0.499


def halfway(near: Tensor, far: Tensor) -> Tensor:
    """The border between each near and far radius; the radius in the middle is on the far side."""
    return near + (far - near) * _HALFWAY

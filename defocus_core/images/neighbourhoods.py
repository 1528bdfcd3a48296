"""Neighbourhoods of pixels: least and greatest values, steps, the pixels themselves."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor


class Choice(Protocol):
    """Of two tensors the greater, or the less, element by element: torch.maximum, torch.minimum."""

    def __call__(self, a: Tensor, b: Tensor, /, *, out: Tensor) -> Tensor:
        """Choose, and write to `out`."""


def extreme_around(values: Tensor, by: int, choice: Choice) -> Tensor:
    """The extreme [..., H, W] of the square of so many px around each pixel; has no gradient.

    Squares end at the borders. Each round joins squares side by side: 8 px take three.

    Args:
        values: [..., H, W], numbers or bool.
        by: Px to each side.
        choice: torch.maximum or torch.minimum.
    """
    values = values.detach()
    for dim in (-2, -1):
        reached = 0
        while step := min(by - reached, 2 * reached + 1, values.shape[dim] - 1):
            values = _joined(values, step, dim, choice)
            reached += step
    return values


def steps_beside(values: Tensor, dim: int) -> tuple[Tensor, Tensor, Tensor]:
    """Along an axis each step between two pixels, the one before it and the one after it, |...|.

    Of n pixels there are n - 3, and none if there are fewer.
    """
    step = values.detach().diff(dim=dim).abs()
    n = max(step.shape[dim] - 2, 0)
    before, here, after = (step.narrow(dim, i if n else 0, n) for i in range(3))
    return before, here, after


def squares_around(at: Tensor, size: tuple[int, int], by: int = 1) -> Tensor:
    """The numbers [n, side, side] of the pixels so many px around some at [n, 2].

    Of a frame of (height, width); at its borders pixels stand for what is beyond.
    """
    offset = torch.arange(-by, by + 1, device=at.device)
    y = (at[:, :1] + offset).clamp(0, size[0] - 1)[:, :, None]
    x = (at[:, 1:] + offset).clamp(0, size[1] - 1)[:, None, :]
    return y * size[1] + x


def _joined(values: Tensor, step: int, dim: int, choice: Choice) -> Tensor:
    """The extreme of each value, those some px before and after it, or else the outermost ones."""
    found, n = values.clone(), values.shape[dim]
    first, last, rest = (0, step), (n - step, step), n - step
    for target, source in (
        ((step, rest), (0, rest)),
        ((0, rest), (step, rest)),
        (first, (0, 1)),
        (last, (n - 1, 1)),
    ):
        some = found.narrow(dim, *target)
        choice(some, values.narrow(dim, *source), out=some)
    return found


def ends_of(values: Tensor) -> Tensor:
    """The least and the greatest [2] of values [...]; NaN if any is one.

    In two passes: on a CPU the one that finds both takes longer, and four times as long where rows
    do not lie together.
    """
    return torch.stack([values.amin(), values.amax()])


# Where between two radii the border is that tells them apart.
_HALFWAY = 0.499


def halfway(near: Tensor, far: Tensor) -> Tensor:
    """The border between each near and far radius: what is as far from both belongs to the far."""
    return near + (far - near) * _HALFWAY

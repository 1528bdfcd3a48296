"""The least or the greatest of what lies around each pixel."""

from __future__ import annotations

from typing import Protocol

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

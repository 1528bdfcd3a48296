"""Neighbours of pixels, and lists of the pixels in a mask."""

from __future__ import annotations

from typing import Protocol

from defocus_core.tensors.device_plan import launches_cost
from defocus_core.tensors.later import Tensor, torch


class Choice(Protocol):
    """The signature of torch.maximum and torch.minimum."""

    def __call__(self, a: Tensor, b: Tensor, /, *, out: Tensor) -> Tensor:
        """Write the elementwise maximum or minimum to `out` and return it."""


def extreme_around(values: Tensor, by: int, choice: Choice) -> Tensor:
    """The greatest or least value in the square around each pixel, [..., H, W], without gradient.

    Squares are clipped at the borders. They grow in rounds, each to at most three times the side,
    so that 8 px take 3 rounds.

    `values`: [..., H, W], numbers or bool; `by`: distance in px from a pixel to the sides of its
    square; `choice`: torch.maximum or torch.minimum.
    """
    values = values.detach()
    for dim in (-2, -1):
        reached = 0
        while step := min(by - reached, 2 * reached + 1, values.shape[dim] - 1):
            values = _shifted_extreme(values, step, dim, choice)
            reached += step
    return values


def steps_beside(values: Tensor, dim: int) -> tuple[Tensor, Tensor, Tensor]:
    """Absolute differences of neighbours along an axis, as three tensors: before, middle and after.

    `before` and `after` hold the differences next to each difference in `middle`; an axis of n
    pixels gives n - 3 of each.
    """
    step = values.detach().diff(dim=dim).abs()
    n = max(step.shape[dim] - 2, 0)
    before, middle, after = (step.narrow(dim, i if n else 0, n) for i in range(3))
    return before, middle, after


def squares_around(at: Tensor, size: tuple[int, int], by: int = 1) -> Tensor:
    """Flat indices [n, side, side] of the pixels in the square around each of n pixels.

    Outside the frame, the nearest border pixel is repeated.

    `at`: [n, 2], row and column of each pixel; `size`: (height, width) of the frame; `by`: distance
    in px from a pixel to the sides of its square.
    """
    offset = torch.arange(-by, by + 1, device=at.device)
    y = (at[:, :1] + offset).clamp_(0, size[0] - 1)[:, :, None]
    x = (at[:, 1:] + offset).clamp(0, size[1] - 1)[:, None, :]
    return y * size[1] + x


def _shifted_extreme(values: Tensor, step: int, dim: int, choice: Choice) -> Tensor:
    """The extreme of each value and of the values `step` px before and after it along `dim`.

    Beyond an end of the axis, the last value is repeated.
    """
    extreme, n = values.clone(), values.shape[dim]
    rest = n - step
    parts = [((step, rest), (0, rest)), ((0, rest), (step, rest))]
    if step > 1:  # else the ends stay as they are
        parts += [((0, step), (0, 1)), ((rest, step), (n - 1, 1))]
    for target, source in parts:
        part = extreme.narrow(dim, *target)
        choice(part, values.narrow(dim, *source), out=part)
    return extreme


def range_of(values: Tensor) -> Tensor:
    """The minimum and the maximum [2] of values [...]; NaN if any value is NaN.

    Two reductions are faster on a CPU than torch.aminmax, by a factor of four where rows are not
    contiguous.
    """
    return torch.stack([values.amin(), values.amax()])


# Place of the border between a near and a far radius; below 1/2, so that the middle is far.
HALFWAY = 0.499


def halfway(near: Tensor, far: Tensor) -> Tensor:
    """The threshold between near and far radii, just below the mean, so that it counts as far."""
    return near + (far - near) * HALFWAY


def exceeding(values: Tensor, bound: float | Tensor) -> Tensor:
    """Whether each of the values [...] exceeds `bound`: bool, without gradient."""
    return values.detach() > bound


def flat_nonzero(mask: Tensor) -> Tensor:
    """Flat indices [n], in ascending order, of the True pixels of a mask [...]."""
    return torch.nonzero(mask.flatten())[:, 0]


def masked_values(values: Tensor, mask: Tensor) -> Tensor:
    """The values [n] of the pixels in a mask.

    On devices other than the CPU, all values [...], with 0 outside the mask, since n would only be
    known after a wait for the device.
    """
    if launches_cost(values.device):
        return torch.where(mask, values, 0)
    return values.flatten()[flat_nonzero(mask)]


def tally(numbers: Tensor, kinds: int) -> Tensor:
    """How often each integer from 0 to kinds - 1 occurs in `numbers` [n]: counts [kinds].

    The device is not waited for.
    """
    if not launches_cost(numbers.device):
        return torch.bincount(numbers, minlength=kinds)
    counts = torch.zeros(kinds, dtype=torch.long, device=numbers.device)
    return counts.scatter_add_(0, numbers.long(), counts.new_ones(()).expand_as(numbers))


def positions_of(mask: Tensor) -> Tensor:
    """The row and column [n, 2] of each True pixel of a mask [H, W]."""
    number = flat_nonzero(mask)
    row = number.div(mask.shape[-1], rounding_mode="floor")
    return torch.stack([row, number - row * mask.shape[-1]], 1)

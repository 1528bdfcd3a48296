"""Pixels of a picture: the few in a mask, listed, and the neighbours of each."""

from __future__ import annotations

from typing import Protocol

from defocus_core.tensors.device_plan import launches_cost
from defocus_core.tensors.later import Tensor, torch


class Choice(Protocol):
    """torch.maximum or torch.minimum: the greater or the less of two tensors."""

    def __call__(self, a: Tensor, b: Tensor, /, *, out: Tensor) -> Tensor:
        """Write the choice to `out`."""


def extreme_around(values: Tensor, by: int, choice: Choice) -> Tensor:
    """The greatest or least value [..., H, W] in the square around each pixel, without gradient.

    Squares end at the borders. Each round joins squares side by side: 8 px take three.

    `values`: [..., H, W], numbers or bool; `by`: distance in px from a pixel to the sides of its
    square.
    """
    values = values.detach()
    for dim in (-2, -1):
        reached = 0
        while step := min(by - reached, 2 * reached + 1, values.shape[dim] - 1):
            values = _shifted_extreme(values, step, dim, choice)
            reached += step
    return values


def steps_beside(values: Tensor, dim: int) -> tuple[Tensor, Tensor, Tensor]:
    """Sizes of the step before, the step itself and the step after, for steps along an axis.

    n pixels have n - 3 steps that lie between two others.
    """
    step = values.detach().diff(dim=dim).abs()
    n = max(step.shape[dim] - 2, 0)
    before, middle, after = (step.narrow(dim, i if n else 0, n) for i in range(3))
    return before, middle, after


def squares_around(at: Tensor, size: tuple[int, int], by: int = 1) -> Tensor:
    """Flat indices [n, side, side] of the pixels in the squares around pixels at [n, 2].

    Beyond the borders of the frame the pixels at the border are repeated.

    `at`: [n, 2] rows and columns; `size`: (height, width) of the frame; `by`: distance in px from a
    pixel to the sides of its square.
    """
    offset = torch.arange(-by, by + 1, device=at.device)
    y = (at[:, :1] + offset).clamp_(0, size[0] - 1)[:, :, None]
    x = (at[:, 1:] + offset).clamp(0, size[1] - 1)[:, None, :]
    return y * size[1] + x


def _shifted_extreme(values: Tensor, step: int, dim: int, choice: Choice) -> Tensor:
    """The extreme of each value and those `step` px before and after; past an end, its value."""
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
    """The least and the greatest [2] of values [...]; NaN if any value is NaN.

    Two passes: on a CPU torch.aminmax takes longer, and four times as long where rows are not
    contiguous.
    """
    return torch.stack([values.amin(), values.amax()])


# Place of the border between a near and a far radius; below 1/2, so that the middle is far.
HALFWAY = 0.499


def halfway(near: Tensor, far: Tensor) -> Tensor:
    """The radius that divides each near and far radius; the exact middle is on the far side."""
    return near + (far - near) * HALFWAY


def exceeding(values: Tensor, bound: float | Tensor) -> Tensor:
    """Where values [...] exceed a bound: bool."""
    return values.detach() > bound


def flat_nonzero(mask: Tensor) -> Tensor:
    """Flat indices [n], ascending, of the pixels in a mask [...] bool."""
    return torch.nonzero(mask.flatten())[:, 0]


def masked_values(values: Tensor, mask: Tensor) -> Tensor:
    """The values [n] of the pixels in a mask.

    On devices other than a CPU, all values, 0 outside the mask, so that the host need not wait.
    """
    if launches_cost(values.device):
        return torch.where(mask, values, 0)
    return values.flatten()[flat_nonzero(mask)]


def tally(numbers: Tensor, kinds: int) -> Tensor:
    """The count [kinds] of each of 0 to kinds - 1 among numbers [n], without synchronisation."""
    if not launches_cost(numbers.device):
        return torch.bincount(numbers, minlength=kinds)
    counts = torch.zeros(kinds, dtype=torch.long, device=numbers.device)
    return counts.scatter_add_(0, numbers.long(), counts.new_ones(()).expand_as(numbers))


def positions_of(mask: Tensor) -> Tensor:
    """The rows and columns [n, 2] of the pixels in a mask [H, W] bool."""
    number = flat_nonzero(mask)
    row = number.div(mask.shape[-1], rounding_mode="floor")
    return torch.stack([row, number - row * mask.shape[-1]], 1)

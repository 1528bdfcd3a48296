"""Controllability: whether more blur asked for is more blur made, by rank alone.

The blur made is the loss of gradient: one less the RMS gradient of linear light, relative to that
of the sharp picture. Any convolution with a pupil lowers it, and a wider one lowers it more.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor

STRENGTHS = tuple(step / 10 for step in range(1, 11))  # shares of the blur of a shot


def blur_made(picture: Tensor, sharp: Tensor, *, border: int = 0) -> float:
    """The share of the RMS gradient of a sharp picture [C, H, W] that another has lost.

    Args:
        picture: [C, H, W], linear.
        sharp: [C, H, W], linear.
        border: Px left out on each side.
    """
    before = _gradient(sharp, border)
    return 1 - _gradient(picture, border) / before if before else 0.0


def rank_correlation(asked: Sequence[float], measured: Sequence[float]) -> float:
    """Spearman's rank correlation (1904), equal values sharing their mean rank; 0 if all are equal.

    Args:
        asked: Numbers.
        measured: As many numbers.
    """
    first, second = (_ranks(values) for values in (asked, measured))
    spread = float(first.norm() * second.norm())
    return float(first @ second) / spread if spread else 0.0


def rises(measured: Sequence[float]) -> int:
    """How many numbers are greater than the one before."""
    return sum(after > before for before, after in pairwise(measured))


def _ranks(values: Sequence[float]) -> Tensor:
    """Ranks less their mean."""
    x = torch.tensor(values, dtype=torch.float64)
    ranks = (x[:, None] > x).double().sum(1) + 0.5 * (x[:, None] == x).double().sum(1)
    return ranks - ranks.mean()


def _gradient(image: Tensor, border: int) -> float:
    """The RMS difference of neighbours."""
    inner = image[..., border : image.shape[-2] - border, border : image.shape[-1] - border]
    across, down = inner.double().diff(dim=-1), inner.double().diff(dim=-2)
    return float((across.square().mean() + down.square().mean()).sqrt())

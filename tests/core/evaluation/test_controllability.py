"""More blur asked for is more blur made, as far as ranks tell."""

from __future__ import annotations

import pytest
import torch

from defocus_core import render
from defocus_core.evaluation.controllability import STRENGTHS, blur_made, rank_correlation, rises


def test_a_wider_convolution_loses_more_gradient() -> None:
    image = torch.rand(3, 48, 64, generator=torch.Generator().manual_seed(1))
    made = [
        blur_made(render(image, torch.full((48, 64), 9 * strength)).render, image, border=9)
        for strength in STRENGTHS
    ]
    assert rises(made) == 9
    assert rank_correlation(STRENGTHS, made) == 1
    assert 0 < made[0] < made[-1] < 1
    assert blur_made(image, image) == 0


@pytest.mark.parametrize(
    ("made", "wanted"),
    [((1, 2, 3, 4), 1.0), ((4, 3, 2, 1), -1.0), ((5, 5, 5, 5), 0.0), ((1, 3, 2, 4), 0.8)],
)
def test_ranks_are_correlated_as_spearman_did(made: tuple[float, ...], wanted: float) -> None:
    assert rank_correlation((1, 2, 3, 4), made) == pytest.approx(wanted)


def test_equal_values_share_their_rank() -> None:
    assert rank_correlation((1, 2, 3), (1, 1, 2)) == pytest.approx(3**0.5 / 2)
    assert rises((1, 1, 2)) == 1

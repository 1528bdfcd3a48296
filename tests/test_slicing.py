"""Shares of pixels in slices: a partition of unity that keeps the second moment."""

import pytest
import torch
from tolerances import ROUNDING

from defocus_core import QUALITIES
from defocus_core.quality import find
from defocus_core.slicing import SHARP, evenly, membership, position, rungs

RADII = torch.linspace(-23.0, 31.0, 217, dtype=torch.float64)[None]
EXACT = ROUNDING[torch.float64]


def shares(ladder: tuple[float, ...]) -> torch.Tensor:
    """[K, 1, n] of RADII."""
    slices = torch.arange(len(ladder), dtype=torch.float64)
    return membership(position(RADII, ladder), slices)


@pytest.mark.parametrize("quality", QUALITIES)
def test_shares_are_a_partition_of_unity(quality: str) -> None:
    share = shares(rungs(-23.0, 31.0, find(quality)))
    assert (share.sum(0) - 1).abs().max() < EXACT
    assert share.min() >= 0
    assert (share > EXACT).sum(0).max() <= 2


@pytest.mark.parametrize("quality", QUALITIES)
def test_shares_keep_the_second_moment(quality: str) -> None:
    ladder = rungs(-23.0, 31.0, find(quality))
    square = (shares(ladder) * torch.tensor(ladder, dtype=torch.float64)[:, None, None] ** 2).sum(0)
    off = (square - RADII**2) / RADII.abs().clamp(min=1) ** 2
    near = RADII.abs() < min(abs(r) for r in ladder if r)
    assert off[~near].abs().max() < EXACT
    assert (off[near] <= EXACT).all()  # up to SHARP a pixel is in focus
    assert off[near].min() >= -(SHARP**2)
    assert (square[RADII.abs() <= SHARP] == 0).all()


@pytest.mark.parametrize("quality", QUALITIES)
def test_the_ladder_stands_where_it_stands(quality: str) -> None:
    """A range only chooses which rungs are there, focus among them, mirrored about it."""
    wide, narrow = rungs(-40.0, 40.0, find(quality)), rungs(-3.3, 7.9, find(quality))
    assert set(narrow) <= set(wide)
    assert 0.0 in narrow
    assert narrow[0] <= -3.3
    assert narrow[-1] >= 7.9
    assert wide == tuple(-r for r in reversed(wide))


def test_an_even_ladder_has_exactly_its_count_and_spans_the_range() -> None:
    assert evenly(-2.0, 6.0, 1) == (2.0,)
    assert evenly(-2.0, 6.0, 5) == (-2.0, 0.0, 2.0, 4.0, 6.0)
    assert (shares(evenly(-2.0, 6.0, 5)).sum(0) - 1).abs().max() < EXACT

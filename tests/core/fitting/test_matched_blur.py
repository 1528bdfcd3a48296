"""A blur is found that gives a picture the radii asked for."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from defocus_core import DefocusLens, fnum_of_strength, matched_blur


def radii_of(sizes: torch.Tensor) -> tuple[float, float, float]:
    return float(sizes.mean()), float(sizes.quantile(0.5)), float(sizes.quantile(0.99))


@settings(deadline=None, max_examples=25)
@given(st.floats(0.0, 2.0), st.floats(1.0, 60.0), st.integers(0, 99))
def test_the_radii_of_a_blur_of_the_picture_are_met(focus: float, k: float, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    disparity = torch.rand(4000, generator=generator, dtype=torch.float64) ** 2
    asked = radii_of(k * (focus - disparity).abs())
    found = matched_blur(disparity, asked)
    assert found.radii == pytest.approx(asked, rel=0.03, abs=0.03)
    assert found.radii == pytest.approx(radii_of(found.strength * (found.focus - disparity).abs()))


def test_radii_that_no_focus_reaches_are_approached_from_both_sides() -> None:
    """A ramp has no plane: with a greatest radius of 8 px its median is 2.7 px at least."""
    found = matched_blur(torch.linspace(0, 1, 2000), (2.0, 0.2, 8.0))
    mean, median, maximum = found.radii
    assert median > 0.2
    assert maximum < 8.0 < 2 * maximum
    assert mean == pytest.approx(2.0, rel=0.5)


def test_a_plane_can_have_any_one_radius() -> None:
    found = matched_blur(torch.full((30,), 0.25), (3.0, 3.0, 3.0))
    assert found.radii == pytest.approx((3.0, 3.0, 3.0))
    assert matched_blur(torch.full((30,), 0.25), (0.0, 0.0, 0.0)).radii[2] < 0.01


def test_the_focus_is_not_nearer_than_asked() -> None:
    disparity = torch.linspace(0.1, 1, 500)
    assert matched_blur(disparity, (9.0, 9.0, 10.0)).focus > 1
    assert matched_blur(disparity, (9.0, 9.0, 10.0), nearest=0.5).focus <= 0.5


def test_the_f_number_of_a_strength_blurs_as_strongly() -> None:
    fnum = fnum_of_strength(9000.0, 1 / 1700, 50.0, 0.02)
    lens = DefocusLens(50.0, fnum, (20.0, 20.0), (1000, 1000), "cpu", torch.float64)
    lens.refocus(1700.0)
    radius = float(lens.signed_radius(torch.tensor([900.0], dtype=torch.float64)))
    assert radius == pytest.approx(9000.0 * (1 / 1700 - 1 / 900))


@pytest.mark.parametrize(
    ("disparity", "radii"),
    [
        ([], (1.0, 1.0, 1.0)),
        ([1.0, math.inf], (1.0, 1.0, 1.0)),
        ([-1.0], (1.0, 1.0, 1.0)),
        ([1.0], (1.0, -1.0, 1.0)),
    ],
)
def test_what_makes_no_sense_is_refused(
    disparity: list[float], radii: tuple[float, float, float]
) -> None:
    with pytest.raises(ValueError, match="must be finite and at least 0"):
        matched_blur(torch.tensor(disparity), radii)


def test_what_is_in_focus_everywhere_cannot_be_blurred() -> None:
    with pytest.raises(ValueError, match="only one that may be in focus"):
        matched_blur(torch.zeros(9), (1.0, 1.0, 2.0), nearest=0.0)

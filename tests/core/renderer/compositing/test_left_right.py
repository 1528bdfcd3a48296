"""Left and right of whatever halves: their mean is the centre."""

import pytest
import torch
from measures import worst
from tolerances import ROUNDING

from defocus_core.renderer.compositing.left_right import left_and_right
from defocus_core.renderer.compositing.saturating_sum import ColorRange

EXACT = ROUNDING[torch.float64]


@pytest.mark.parametrize("minimum", [0.0, -0.3])
@pytest.mark.parametrize("fraction", [0.5, 0.4])
def test_the_mean_of_a_pair_is_the_centre(fraction, minimum):
    random = torch.Generator().manual_seed(0)
    centre, left, right = torch.rand(3, 2, 5, 7, generator=random, dtype=torch.float64)
    left[0, 0] = right[0, 0] = 0.0
    halves, limits = torch.stack([left, right]), ColorRange.from_channels((), centre, -torch.inf)
    given = {"minimum": minimum, "fraction": fraction}
    one, other = left_and_right(halves, centre, limits, **given)
    assert worst(fraction * one + (1 - fraction) * other, centre) < EXACT
    exact = left_and_right(halves, fraction * left + (1 - fraction) * right, limits, **given)
    assert worst(exact, halves) < EXACT


@pytest.mark.filterwarnings("error")
def test_a_pair_of_a_share_that_learns_warns_of_nothing():
    centre, share = torch.rand(3, 4, 4), torch.tensor(0.45, requires_grad=True)
    halves, limits = (
        torch.stack([0.4 * centre, 0.6 * centre]),
        ColorRange.from_channels((), centre, 0.0),
    )
    left_and_right(halves, centre, limits, fraction=share)[0].sum().backward()
    assert float(share.grad) != 0

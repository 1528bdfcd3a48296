"""The saturating sum: complementary coverage adds up, full coverage hides what is behind."""

import pytest
import torch
from measures import worst
from tolerances import ROUNDING

from defocus_core.renderer.compositing.left_right import left_and_right
from defocus_core.renderer.compositing.saturating_sum import ColorRange, add_behind, picture

EXACT = ROUNDING[torch.float64]


def layer(coverage, color):
    """[M, C + 1, h, w] of one colour, premultiplied."""
    values = torch.tensor([coverage * color, coverage], dtype=torch.float64)
    return values[None, :, None, None].expand(2, -1, 3, 4).clone()


def composite(*layers):
    """Layers (coverage, colour), front to back."""
    seen = torch.zeros(2, 2, 3, 4, dtype=torch.float64)
    for coverage, color in layers:
        seen = add_behind(seen, layer(coverage, color))
    return seen


def test_full_coverage_hides_everything_behind():
    assert torch.equal(composite((1.0, 0.2), (1.0, 1e6)), composite((1.0, 0.2)))


def test_coverage_saturates_at_one():
    seen = composite((0.6, 1.0), (0.8, 0.5), (0.5, 9.0))
    assert worst(seen[:, 1], 1.0) < EXACT
    assert worst(seen[:, 0], 0.6 + 0.4 * 0.5) < EXACT


def test_a_picture_is_divided_by_what_was_seen():
    assert worst(picture(composite((0.4, 0.8))), 0.8) < EXACT


@pytest.mark.parametrize("minimum", [0.0, -0.3])
@pytest.mark.parametrize("fraction", [0.5, 0.4])
def test_the_mean_of_a_pair_is_the_centre(fraction, minimum):
    random = torch.Generator().manual_seed(0)
    centre, left, right = torch.rand(3, 2, 5, 7, generator=random, dtype=torch.float64)
    left[0, 0] = right[0, 0] = 0.0
    halves, limits = torch.stack([left, right]), ColorRange.of((), centre, -torch.inf)
    given = {"minimum": minimum, "fraction": fraction}
    one, other = left_and_right(halves, centre, limits, **given)
    assert worst(fraction * one + (1 - fraction) * other, centre) < EXACT
    exact = left_and_right(halves, fraction * left + (1 - fraction) * right, limits, **given)
    assert worst(exact, halves) < EXACT


def test_a_gradient_leaves_its_inputs_alone():
    front = layer(0.5, 1.0)
    with torch.enable_grad():
        add_behind(front, layer(0.5, 0.2))
    assert torch.equal(front, layer(0.5, 1.0))


@pytest.mark.filterwarnings("error")
def test_a_pair_of_a_share_that_learns_warns_of_nothing():
    centre, share = torch.rand(3, 4, 4), torch.tensor(0.45, requires_grad=True)
    halves, limits = torch.stack([0.4 * centre, 0.6 * centre]), ColorRange.of((), centre, 0.0)
    left_and_right(halves, centre, limits, fraction=share)[0].sum().backward()
    assert float(share.grad) != 0

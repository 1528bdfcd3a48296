"""At the borders of the frame: what lies outside is unseen, and lets nothing through."""

import math

import pytest
import torch
from renderers import QUALITIES

from defocus_core import render


@pytest.mark.parametrize("quality", QUALITIES[:2])
def test_nothing_leaks_past_a_card_that_the_frame_cuts(quality):
    """Farther below its edge than it is blurred a black card is black, to the last column."""
    image = torch.full((1, 90, 120), 0.8)
    radius = torch.full((90, 120), 20.0)
    image[:, 40:], radius[40:] = 0.0, -10.0
    seen = render(image, radius, quality=quality, left_right=True)
    for picture in (seen.render, seen.left, seen.right):
        assert picture[:, 53:].abs().max() < 2e-2  # 0.07 where all that is left is filled


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("size", [(1, 1), (1, 2), (2, 2)])
def test_a_frame_smaller_than_a_disc_is_trusted_for_its_share(size, quality):
    r, area = 5.0, size[0] * size[1]
    trust = render(torch.ones(3, *size), torch.full(size, r), quality=quality).trust
    torch.testing.assert_close(
        trust, torch.full((1, *size), area / (math.pi * r * r)), rtol=0.1, atol=1e-2
    )


@pytest.mark.parametrize("quality", QUALITIES)
def test_a_border_is_trusted_for_the_part_of_the_disc_within(quality):
    def trust(size, r):
        return render(torch.ones(3, *size), torch.full(size, r), quality=quality).trust[0]

    x = (torch.arange(8) + 0.5) / 8  # from the border, in radii
    share = 1 - (x.acos() - x * (1 - x * x).sqrt()) / math.pi
    torch.testing.assert_close(trust((40, 60), 8.0)[20, :8], share, rtol=0, atol=0.01)
    assert torch.equal(trust((2, 2), 1e3), torch.full((2, 2), 0.01))

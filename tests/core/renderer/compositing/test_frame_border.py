"""At the borders of the frame: what lies outside is unseen, and lets nothing through."""

import math

import pytest
import torch
from measures import worst
from renderers import QUALITIES

from defocus_core import Aperture, render
from defocus_core.renderer.compositing.sight import fraction_in_frame
from defocus_core.tensors.box import Box


def seen_by_samples(r, x, y, size, aperture):
    """The share of samples of each of four parts of a round pupil that lands in the frame."""
    u = torch.rand(2, 400_000, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    u = 2 * u - 1
    u = u[:, u.square().sum(0) < 1]
    inside = torch.ones(u.shape[1], dtype=torch.bool)
    for along, at, length in ((u[0], x, size[1]), (u[1], y, size[0])):
        q = at - r * along
        inside &= (q >= -0.5) & (q <= length - 0.5)
    shares = []
    for part in aperture.parts(4):
        mine = (u[0] >= part.x0) & (u[0] < part.x1) & (u[1] >= part.y0) & (u[1] < part.y1)
        shares.append((inside & mine).sum() / mine.sum())
    return torch.stack(shares)


@pytest.mark.parametrize(("r", "x", "y"), [(9.0, 2, 30), (-9.0, 2, 30), (12.0, 38, 1), (2.5, 0, 0)])
def test_the_share_in_the_frame_is_that_of_samples(r, x, y):
    size, aperture = (50, 40), Aperture()
    radius = torch.full((1, 1), r, dtype=torch.float64)
    found = fraction_in_frame(radius, Box(y, x, 1, 1), size, aperture, aperture.parts(4))
    assert worst(found.flatten(), seen_by_samples(r, x, y, size, aperture)) < 5e-3


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

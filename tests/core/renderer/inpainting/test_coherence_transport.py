"""Coherence transport: lines go on behind what hides them, and nothing else changes."""

import math

import pytest
import torch
from measures import worst

from defocus_core.renderer.inpainting.coherence_transport import transported
from defocus_core.renderer.inpainting.hidden_layers import hidden_layer

H, W = 96, 112
BAR = slice(50, 60)  # columns that a nearer bar hides
FAR, NEAR = 4.0, -7.0


def stripes(degrees, period=14.0):
    """Smooth stripes [2, H, W], at an angle from upright."""
    y, x = torch.arange(H, dtype=torch.float64)[:, None], torch.arange(W, dtype=torch.float64)
    turned = x * math.cos(math.radians(degrees)) + y * math.sin(math.radians(degrees))
    wave = 0.5 + 0.3 * torch.sin(2 * math.pi * turned / period)
    return torch.stack([wave, 1 - wave])


def behind_a_bar(background):
    """A plain bar before a background, and the radii of both."""
    image, radius = background.clone(), torch.full((H, W), FAR, dtype=torch.float64)
    image[..., BAR], radius[:, BAR] = 0.9, NEAR
    return image, radius


@pytest.mark.parametrize("degrees", [35.0, 60.0, 90.0, 120.0])
def test_stripes_go_on_behind_a_bar(degrees):
    background = stripes(degrees)
    found = hidden_layer(*behind_a_bar(background))
    mask = found.mask.clone()
    mask[:24], mask[-24:] = False, False  # stripes that leave the frame have one end
    assert mask.any()
    off = (found.color - background)[:, mask].abs()
    assert float(off.mean()) < 0.04  # of an amplitude of 0.3
    assert float(off.max()) < 0.2


def test_what_lies_at_another_distance_lends_no_colour():
    background = stripes(90.0)
    image, radius = behind_a_bar(background)
    picture = torch.cat([image, radius[None]])
    at = torch.tensor([[48, 55]])
    tensor = torch.tensor([[0.0, 0.0, 0.01]], dtype=torch.float64)  # level stripes
    border = torch.zeros(1, dtype=torch.float64)
    for r, weight in ((FAR, 1.0), (FAR + 5, 0.0)):
        smooth = torch.tensor([[0.2, 0.4, r]], dtype=torch.float64)
        found = transported(picture, at, border, smooth, tensor)
        expected = torch.lerp(smooth[:, :2], background[:, 48, 30][None], weight)
        assert worst(found, expected) < 1e-3


def test_one_end_counts_the_less_the_farther_it_is():
    image = torch.full((1, 1, 40), 0.2, dtype=torch.float64)
    radius = torch.full((1, 40), NEAR, dtype=torch.float64)
    image[..., :10], radius[:, :10] = 1.0, FAR
    picture = torch.cat([image, radius[None]])
    tensor = torch.tensor([[0.0, 0.0, 0.01]], dtype=torch.float64)
    smooth = torch.tensor([[0.0, FAR]], dtype=torch.float64)
    border = torch.zeros(1, dtype=torch.float64)
    found = [
        float(transported(picture, torch.tensor([[0, x]]), border, smooth, tensor))
        for x in (11, 15, 20, 27, 39)
    ]
    assert found == sorted(found, reverse=True)
    assert found[0] > 0.85
    assert found[-1] == 0

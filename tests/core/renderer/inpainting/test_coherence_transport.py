"""Coherence transport: lines go on behind what hides them, and nothing else changes."""

import math

import pytest
import torch

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

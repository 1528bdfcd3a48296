"""Axial colour: each channel has the radius of its own focus, and white stays white."""

import math

import pytest
import torch
from measures import worst
from renderers import QUALITIES
from scenes import white

from defocus_core import DefocusLens, render
from defocus_core.optics.axial_color import color_offset

SHIFT = 0.1  # mm


def lens(foc_dist=2000.0):
    made = DefocusLens(50.0, 1.4, (36.0, 24.0), (480, 320))
    made.refocus(foc_dist)
    return made


@pytest.mark.parametrize("foc_dist", [2000.0, math.inf])
def test_the_offset_is_that_of_a_sensor_moved_by_the_shift(foc_dist):
    made = lens(foc_dist)
    v = 50.0 if math.isinf(foc_dist) else 50 * foc_dist / (foc_dist - 50)
    for z in (900.0, 3000.0, 1e5):
        image = 1 / (1 / 50 - 1 / z)
        circle = (50 / 1.4) * (v - image - SHIFT) / image  # of a colour whose image is farther
        green = float(made.signed_radius(z))
        moved = circle / (2 * made.pixel_size)
        assert green + float(color_offset(made, SHIFT)) == pytest.approx(moved, rel=0.02, abs=0.05)


def test_each_channel_is_rendered_with_its_radius_and_white_stays_white():
    generator = torch.Generator().manual_seed(1)
    image = torch.rand(3, 40, 48, generator=generator)
    radius = torch.full((40, 48), 5.0)
    radius[10:30, 12:30] = -3.0
    offsets = (0.8, 0.0, -0.6)
    views = render(image, radius, color_offsets=offsets, left_right=True)
    flat = torch.full((40, 48), 5.0)
    together = render(image, flat, color_offsets=offsets).render
    for c, px in enumerate(offsets):
        assert torch.equal(together[c : c + 1], render(image[c : c + 1], flat + px).render)
    white = render(torch.ones_like(image), radius, color_offsets=offsets).render
    assert (white - 1).abs().max() < 1e-5
    assert (views.left + views.right - 2 * views.render).abs().max() < 1e-6


@pytest.mark.parametrize("quality", QUALITIES)
def test_grey_stays_grey_with_or_without_gradients(quality):
    """With offsets that vanish: each colour alone is taken apart as the others are."""
    image, radius = white("steps")
    image = image * torch.rand(image.shape[1:], generator=torch.Generator().manual_seed(1))
    apart = render(image, radius, color_offsets=(1e-9, 0.0, -1e-9), quality=quality).render
    assert worst(apart[1:], apart[:1]) < 1e-8
    shown = render(image, radius, color_offsets=(0.8, 0.0, -0.6), quality=quality).render
    image, radius = image.requires_grad_(), radius.requires_grad_()
    learnt = render(image, radius, color_offsets=(0.8, 0.0, -0.6), quality=quality).render
    assert worst(learnt.detach(), shown) < 1e-12

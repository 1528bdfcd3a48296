"""The baseline is right where nothing occludes, and wrong where something does."""

import pytest
from measures import inner, psnr, worst
from reference import flatten, layered, lens_points, one_plane_within
from scenes import SIZE, card_layers, plane
from tolerances import OVERSAMPLING

from defocus_core import render
from defocus_core.evaluation.baselines import plain_sum


def test_a_plane_on_a_rung_is_one_convolution():
    """Black beyond the frame, divided by the share within, as the oracle has it."""
    image, radius = plane(6.0)
    assert worst(plain_sum(image, radius), one_plane_within(image, 6.0)) < OVERSAMPLING


@pytest.mark.parametrize(("card_r", "background_r"), [(-7.0, 0.0), (-7.0, 3.0), (4.0, 9.0)])
def test_the_renderer_is_nearer_to_a_card_before_waves(card_r, background_r):
    layers = card_layers(card_r, background_r)
    image, radius = flatten(layers, SIZE)
    truth = inner(layered(layers, lens_points(24), SIZE), 9)
    rendered = inner(render(image, radius).render, 9)
    assert psnr(inner(plain_sum(image, radius), 9), truth) < psnr(rendered, truth) - 3

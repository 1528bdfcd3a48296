"""Baselines are right where nothing occludes, and wrong where something does."""

import pytest
import torch
from measures import inner, psnr, worst
from reference import flatten, layered, lens_points, one_plane_within
from scenes import SIZE, card_layers, pattern, plane, slanted, white
from tolerances import OVERSAMPLING, RENDERED, WHITE

from defocus_core import render
from defocus_core.evaluation.baselines import over, plain_sum

BASELINES = pytest.mark.parametrize("baseline", [plain_sum, over])


@BASELINES
def test_white_stays_white(baseline):
    assert worst(baseline(*white()), 1.0) < WHITE


@BASELINES
def test_what_is_in_focus_stays_as_it_is(baseline):
    image, radius = plane(0.0)
    assert worst(baseline(image, radius), image) < RENDERED[image.dtype]


@BASELINES
def test_threads_change_nothing(baseline):
    image, radius = pattern(), slanted()
    assert torch.equal(baseline(image, radius), baseline(image, radius, threads=3))


@BASELINES
def test_a_plane_on_a_rung_is_one_convolution(baseline):
    """Black beyond the frame, divided by the share within, as the oracle has it."""
    image, radius = plane(6.0)
    assert worst(baseline(image, radius), one_plane_within(image, 6.0)) < OVERSAMPLING


def test_a_slope_adds_up_but_does_not_occlude_itself():
    image, radius = pattern(period=14.0), slanted()
    rendered, border = render(image, radius).render, 9
    summed = psnr(inner(plain_sum(image, radius), border), inner(rendered, border))
    leaked = psnr(inner(over(image, radius), border), inner(rendered, border))
    assert leaked < summed - 3


@BASELINES
@pytest.mark.parametrize(("card_r", "background_r"), [(-7.0, 0.0), (-7.0, 3.0), (4.0, 9.0)])
def test_the_renderer_is_nearer_to_a_card_before_waves(baseline, card_r, background_r):
    layers = card_layers(card_r, background_r)
    image, radius = flatten(layers, SIZE)
    truth = inner(layered(layers, lens_points(24), SIZE), 9)
    rendered = inner(render(image, radius).render, 9)
    assert psnr(inner(baseline(image, radius), 9), truth) < psnr(rendered, truth) - 3

"""The oracles agree with each other and with closed forms before they judge anything else."""

import math

import pytest
import torch
from measures import centroid, inner
from reference import forward_splat, kernel, layered, left, lens_points, one_plane, polygon
from scenes import RADII, SIZE, card_layers, highlight, plane, sharp_card, white
from tolerances import ROUNDING

EXACT = ROUNDING[torch.float64]
SAMPLING = 3e-3  # 32 lens points a diameter against areas, for waves of amplitude 0.4


@pytest.mark.parametrize("kind", RADII)
def test_white_splats_to_white_at_any_depth(kind):
    image, radius = white(kind)
    assert (forward_splat(image, radius, lens_points(8)) - 1).abs().max() < EXACT


@pytest.mark.parametrize("r", [-5.0, 3.3, 8.0])
def test_splatting_one_plane_is_one_convolution(r):
    image, radius = plane(r)
    splatted = forward_splat(image, radius, lens_points(32))
    border = math.ceil(abs(r)) + 1
    assert (inner(splatted - one_plane(image, r), border)).abs().max() < SAMPLING


@pytest.mark.parametrize("r", [-7.0, 7.0])
def test_beyond_focus_moves_left_in_the_left_picture(r):
    image, _ = highlight(r)
    column, row = centroid(one_plane(image, r, left))
    assert column == pytest.approx(-4 * r / (3 * math.pi), rel=4e-3)
    assert row == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(("r", "tip"), [(9.0, -1), (-9.0, 1)])
def test_the_polygon_stands_upright_beyond_focus_and_on_its_head_before_it(r, tip):
    rows = kernel(r, polygon(3, 90.0)).sum(1).nonzero().flatten() - kernel(r).shape[0] // 2
    assert rows[0] == (-9 if tip < 0 else -4)
    assert rows[-1] == (4 if tip < 0 else 9)


def test_the_second_moment_is_that_of_a_disc_and_a_pixel():
    psf = kernel(6.0)
    x = torch.arange(psf.shape[0]) - psf.shape[0] // 2
    assert float((psf.sum(0) * x * x).sum()) == pytest.approx(6.0**2 / 4 + 1 / 12, rel=4e-3)


def test_splatting_agrees_with_layers_where_nothing_is_hidden():
    # a card in focus hides background, but not from the pixels farther than r from it
    layers = card_layers(0.0, 6.0)
    image, radius = sharp_card(6.0)
    points = lens_points(24)
    error = (forward_splat(image, radius, points) - layered(layers, points, SIZE)).abs()
    free = torch.nn.functional.max_pool2d((radius == 0.0)[None].double(), 15, 1, 7)[0] == 0
    assert inner(error * free, 8).max() < 2 * SAMPLING

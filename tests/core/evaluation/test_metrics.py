"""Errors by closed forms."""

import math

import numpy as np
import pytest
import torch
from measures import inner

from defocus_core.evaluation import metrics


def noise(*shape, seed=0):
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def flat(size=(30, 40)):
    return torch.zeros(size, dtype=torch.float64)


def test_a_picture_is_equal_to_itself():
    picture = noise(3, 30, 40)
    found = metrics.measure(picture, picture, flat(), border=2)
    assert (found.psnr, found.psnr_elsewhere) == (99.0, 99.0)
    assert found.psnr_edges is None
    assert (found.rel_rmse, found.p999) == (0.0, 0.0)
    assert found.ssim == pytest.approx(1.0)


def test_ssim_of_flat_pictures_is_the_ratio_of_their_means():
    a, b = flat() + 0.3, flat() + 0.7
    expected = (2 * 0.3 * 0.7 + 1e-4) / (0.3**2 + 0.7**2 + 1e-4)
    assert metrics.ssim(a, b) == pytest.approx(expected, rel=1e-9)


def test_ssim_of_one_window_is_its_formula():
    a, b = noise(11, 11), noise(11, 11, seed=1)
    x = torch.arange(-5, 6).double()
    w = torch.exp(-(x[:, None] ** 2 + x**2) / (2 * 1.5**2))
    w = w / w.sum()
    mean_a, mean_b = float((w * a).sum()), float((w * b).sum())
    var_a, var_b = float((w * (a - mean_a) ** 2).sum()), float((w * (b - mean_b) ** 2).sum())
    both = float((w * (a - mean_a) * (b - mean_b)).sum())
    light = (2 * mean_a * mean_b + 1e-4) / (mean_a**2 + mean_b**2 + 1e-4)
    expected = light * (2 * both + 9e-4) / (var_a + var_b + 9e-4)
    assert metrics.ssim(a, b) == pytest.approx(expected, rel=1e-9)


def test_relative_rmse_and_percentile_of_a_constant_error():
    truth = 0.2 + noise(3, 30, 40)
    found = metrics.measure(truth + 0.05, truth, flat(), border=3)
    assert found.rel_rmse == pytest.approx(0.05 / float(inner(truth, 3).mean()))
    assert found.p999 == pytest.approx(0.05)


def test_a_percentile_lies_between_its_neighbours():
    values = noise(7, 333)
    assert metrics.percentile(values, 99.9) == pytest.approx(np.percentile(values.numpy(), 99.9))
    assert metrics.percentile(values, 100.0) == float(values.max())


def test_near_an_edge_is_within_the_distance():
    radius = flat((21, 40))
    radius[:, 20:] = 1.5  # the edge lies between columns 19 and 20
    near = metrics.near_edges(radius, 4.0)
    assert near.all(0).nonzero().flatten().tolist() == list(range(15, 25))
    assert torch.equal(near.any(0), near.all(0))
    assert not metrics.near_edges(radius * 0.6, 4.0).any()  # 0.9 px is a slope


def test_near_a_point_is_a_disc():
    radius = flat((41, 41))
    radius[20, 20] = 9.0  # with its neighbours a cross of five pixels
    y, x = torch.meshgrid(torch.arange(41), torch.arange(41), indexing="ij")
    cross = [(20, 20), (19, 20), (21, 20), (20, 19), (20, 21)]
    wanted = torch.stack([(y - v) ** 2 + (x - u) ** 2 <= 36 for v, u in cross]).any(0)
    assert torch.equal(metrics.near_edges(radius, 6.0), wanted)


def test_an_error_at_an_edge_is_found_there():
    truth, radius = noise(3, 40, 60), flat((40, 60))
    radius[:, 30:] = 5.0
    picture = truth.clone()
    picture[..., 27:33] += 0.1
    found = metrics.measure(picture, truth, radius, border=6)
    assert found.psnr_elsewhere == 99.0
    assert found.psnr_edges is not None
    assert found.psnr_edges < found.psnr < 40


@pytest.mark.parametrize(
    ("picture", "border", "words"),
    [
        (torch.zeros(3, 30, 41), 0, "of the signed_radius"),
        (torch.zeros(3, 30, 40), 10, "leave 11 px"),
        (torch.full((3, 30, 40), math.nan), 0, "finite"),
    ],
)
def test_what_cannot_be_measured_is_refused(picture, border, words):
    with pytest.raises(ValueError, match=words):
        metrics.measure(picture, torch.ones_like(picture), flat(), border=border)

"""Errors by closed forms."""

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


def test_near_an_edge_is_within_the_distance():
    radius = flat((21, 40))
    radius[:, 20:] = 1.5  # the edge lies between columns 19 and 20
    near = metrics.near_edges(radius, 4.0)
    assert near.all(0).nonzero().flatten().tolist() == list(range(15, 25))
    assert torch.equal(near.any(0), near.all(0))
    assert not metrics.near_edges(radius * 0.6, 4.0).any()  # 0.9 px is a slope


def test_an_error_at_an_edge_is_found_there():
    truth, radius = noise(3, 40, 60), flat((40, 60))
    radius[:, 30:] = 5.0
    picture = truth.clone()
    picture[..., 27:33] += 0.1
    found = metrics.measure(picture, truth, radius, border=6)
    assert found.psnr_elsewhere == 99.0
    assert found.psnr_edges is not None
    assert found.psnr_edges < found.psnr < 40

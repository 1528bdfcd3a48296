"""Noise has the mean and the variance of a sensor, and the same seed makes the same."""

import pytest
import torch

from defocus_core import with_noise


@pytest.mark.parametrize(
    ("light", "electrons", "read"), [(0.5, 4e3, 3.0), (0.02, 100, 5), (0.0, 50, 2)]
)
def test_the_mean_is_the_light_and_the_variance_that_of_shot_and_read_noise(light, electrons, read):
    noisy = with_noise(torch.full((1, 200, 200), light), electrons=electrons, read=read, seed=1)
    variance = light / electrons + (read / electrons) ** 2
    assert float(noisy.mean()) == pytest.approx(light, abs=4 * (variance / 40_000) ** 0.5)
    assert float(noisy.var()) == pytest.approx(variance, rel=0.05)


def test_strips_are_the_whole_picture_and_another_seed_is_other_noise():
    image = torch.rand(3, 20, 30, generator=torch.Generator().manual_seed(1))
    whole = with_noise(image, electrons=500, read=2, seed=7)
    lower = with_noise(image[:, 8:], electrons=500, read=2, seed=7, first_row=8)
    assert torch.equal(whole[:, 8:], lower)
    assert torch.equal(whole, with_noise(image, electrons=500, read=2, seed=7))
    assert not torch.equal(whole, with_noise(image, electrons=500, read=2, seed=8))
    assert (whole[:, 0] - image[:, 0]).ne(whole[:, 1] - image[:, 1]).any()

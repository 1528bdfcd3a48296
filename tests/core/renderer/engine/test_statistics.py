"""What is found of a picture is found wherever in it it lies."""

import pytest
import torch
from renderers import repair_of

from defocus_core.renderer.engine.survey import needs_double, surveyed

SIZE = (600, 24)


def noise(*size):
    return torch.randn(size, generator=torch.Generator().manual_seed(3))


@pytest.mark.parametrize("row", [0, 255, 256, 598])
def test_the_steepest_step_is_seen_wherever_it_is(row):
    radius = torch.zeros(SIZE)
    radius[row + 1 :] = 7.0
    radius[row, 5] = 1.0
    survey = surveyed(noise(3, *SIZE), radius, torch.float32)
    assert survey.steepest == (7.0, 1.0)
    assert (survey.minimum, survey.maximum) == (0.0, 7.0)


@pytest.mark.parametrize("row", [1, 254, 255, 256, 598])
def test_a_soft_edge_is_seen_wherever_it_is(row):
    radius = torch.zeros(SIZE)
    radius[row + 1 :] = 4.0
    assert not repair_of(radius).ramps
    radius[row, 5::4] = 2.0  # in two steps
    assert repair_of(radius).ramps
    assert repair_of(radius.T, threads=2).ramps


@pytest.mark.parametrize(("dark", "double"), [(1.1e-3, False), (0.9e-3, True)])
def test_what_is_bright_beside_the_median_of_lit_pixels_needs_double_precision(dark, double):
    image = torch.zeros(3, *SIZE)
    image[1, :400] = dark
    image[0, 7, 7] = 1.0
    survey = surveyed(image, torch.zeros(SIZE), torch.float32)
    assert needs_double(survey, limit=1.0) == double
    assert not needs_double(survey, limit=dark)

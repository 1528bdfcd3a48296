"""The formulas of a thin lens by themselves, against each other."""

import math

import pytest
import torch

from defocus_core.optics.thin_lens import (
    coc_of,
    coc_per_disparity,
    depth_of_field,
    far_point,
    field_of_view,
)

F, N, C = (torch.tensor(x, dtype=torch.float64) for x in (50.0, 2.0, 0.03))


def test_focused_at_the_far_point_infinity_is_as_blurred_as_accepted_and_half_way_too():
    s = far_point(F, N, C)
    per_disparity = coc_per_disparity(F, N, s)
    near, far = depth_of_field(s, C / per_disparity, s)
    assert float(coc_of(per_disparity, 1 / s, torch.tensor(math.inf))) == pytest.approx(0.03)
    assert math.isinf(far)
    assert float(coc_of(per_disparity, 1 / s, near)) == pytest.approx(-0.03)


def test_a_side_of_twice_the_focal_length_is_seen_at_a_right_angle():
    assert field_of_view(100.0, 50.0) == pytest.approx(math.pi / 2)
    assert float(field_of_view(100.0, F)) == pytest.approx(math.pi / 2)

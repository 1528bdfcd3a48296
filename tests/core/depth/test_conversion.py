"""Disparity, logarithms and distances to the point become planar depth."""

import math

import torch

from defocus_core import depth_from_disparity, depth_from_logarithm, planar_depth

DOUBLE = torch.float64


def test_disparity_is_focal_length_times_baseline_over_depth():
    depth = torch.tensor([0.5, 2.0, 80.0], dtype=DOUBLE)
    disparity = 700.0 * 0.12 / depth - 31.0
    torch.testing.assert_close(depth_from_disparity(disparity, 700 * 0.12, 31.0), depth)


def test_disparity_of_0_is_infinitely_far_and_below_there_is_no_depth():
    disparity = torch.tensor([0.0, -1.0, 2.0], dtype=DOUBLE, requires_grad=True)
    depth = depth_from_disparity(disparity)
    assert depth[0] == math.inf
    assert depth[1].isnan()
    depth[2].backward()  # the others must not spoil it
    assert disparity.grad.tolist() == [0.0, 0.0, -0.25]


def test_the_middle_of_the_logarithm_is_the_geometric_mean():
    depth = depth_from_logarithm(torch.tensor([0.0, 0.5, 1.0], dtype=DOUBLE), 2.0, 50.0)
    torch.testing.assert_close(depth, torch.tensor([2.0, 10.0, 50.0], dtype=DOUBLE))


def test_points_of_a_plane_before_the_camera_have_one_planar_depth():
    focal, height, width = 40.0, 5, 8
    y, x = torch.meshgrid(
        torch.arange(height, dtype=DOUBLE) - 2,
        torch.arange(width, dtype=DOUBLE) - 3.5,
        indexing="ij",
    )
    points = torch.stack([x, y, torch.full_like(x, focal)]) * (7.0 / focal)
    distance = points.norm(dim=0)
    whole = planar_depth(distance, focal)
    torch.testing.assert_close(whole, torch.full_like(x, 7.0))
    part = planar_depth(distance[3:], focal, first=(3, 0), size=whole.shape[-2:])
    torch.testing.assert_close(part, whole[3:])


def test_sky_stays_sky():
    assert planar_depth(torch.full((2, 3), math.inf), 10.0).isposinf().all()


def test_gradients_of_conversions():
    values = torch.tensor([[0.3, 1.2, 2.0]], dtype=DOUBLE, requires_grad=True)
    for convert in (
        lambda v: depth_from_disparity(v, 3.0, 0.1),
        lambda v: depth_from_logarithm(v, 1.0, 9.0),
        lambda v: planar_depth(v, 2.0),
    ):
        assert torch.autograd.gradcheck(convert, values)

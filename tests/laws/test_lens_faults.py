"""What was measured to go wrong in the code this class replaces cannot happen here.

One test for each fault, named for the law that excludes it.
"""

import math

import pytest
import torch

from defocus_core import DefocusLens

DTYPE = torch.float64


def camera(foc_dist=2000.0, foclen=50.0):
    lens = DefocusLens(foclen, 1.4, sensor_size=(36.0, 20.25), sensor_res=(480, 270), dtype=DTYPE)
    lens.refocus(foc_dist)
    return lens


def axis_points(*depths):
    return torch.tensor([[0.0, 0.0, z] for z in depths], dtype=DTYPE)


def speckle(height, width, seed=1):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(1, 3, height, width, dtype=DTYPE, generator=generator)


def test_a_coc_wider_than_the_kernel_is_cropped_with_a_warning_that_names_the_ks_it_needs():
    lens, points = camera(), axis_points(-3000.0, -700.0)
    needed = math.ceil(2 * float(lens.signed_radius(700.0).abs()))
    for method in (lens.psf, lens.psf_dp, lens.psf_rgb, lens.psf_rgb_dp):
        with pytest.warns(UserWarning, match=f"use ks={needed} or more"):
            method(points, ks=needed - 1)
        with pytest.raises(ValueError, match=f"use ks={needed} or more"):
            method(points, ks=needed - 1, strict=True)
    assert float(lens.psf(points, ks=needed, strict=True)[1].sum()) == pytest.approx(1)
    with pytest.raises(ValueError, match="ks"):
        lens.render_rgbd(speckle(20, 20), torch.full((1, 20, 20), 700.0), psf_ks=needed - 2)


@pytest.mark.filterwarnings("ignore:kernels are cropped")
@pytest.mark.parametrize("psf_type", ["pillbox", "gaussian"])
def test_a_cropped_kernel_is_the_middle_of_the_whole_one_with_sum_one(psf_type):
    lens, points = camera(), axis_points(-700.0, -2100.0)
    whole = lens.psf(points, ks=65, psf_type=psf_type, strict=True)
    middle = whole[:, 25:40, 25:40]
    cropped, (left, right) = (
        psf(points, ks=15, psf_type=psf_type) for psf in (lens.psf, lens.psf_dp)
    )
    torch.testing.assert_close(cropped, middle / middle.sum((1, 2), keepdim=True))
    torch.testing.assert_close((left + right) / 2, cropped)
    assert middle[0].sum() < 0.7
    level = lens.psf(axis_points(-1e-9), ks=4, psf_type="pillbox")
    torch.testing.assert_close(level, torch.full_like(level, 1 / 16))


def test_depth_is_never_clamped_and_no_depth_is_invalid_in_silence():
    lens = camera(1000.0)
    for z in (0.0, math.nan):
        for method in (lens.coc, lens.signed_radius, lens.dof):
            with pytest.raises(ValueError, match="depth must be"):
                method(torch.tensor([900.0, z]))
        with pytest.raises(ValueError, match="depth must be"):
            lens.psf(axis_points(-900.0, z))
    for z in (0.0, -900.0, math.nan):
        depth = torch.full((1, 20, 20), 900.0)
        depth[0, 3, 4] = z
        for method in (lens.render_rgbd, lens.render_rgbd_dp):
            with pytest.raises(ValueError, match="depth must be positive"):
                method(speckle(20, 20), depth)


def at_radius(lens, radius):
    """Points [N, 3] on the axis with these signed radii in px."""
    at_infinity = lens.radius_at_infinity()
    disparity = (1 - radius / at_infinity) / 2000.0
    return torch.stack([torch.zeros_like(radius), torch.zeros_like(radius), -1 / disparity], -1)


@pytest.mark.parametrize("ks", [4, 5, 63, 64])
@pytest.mark.parametrize(
    ("psf_type", "shift"), [("pillbox", 8 / (3 * math.pi)), ("gaussian", 0.806)]
)
def test_dual_pixel_halves_are_as_far_apart_near_focus_as_their_halves_of_the_lens(
    ks, psf_type, shift
):
    lens = camera()
    radius = torch.tensor([-1.9, -0.43, -0.024, -1e-9, 0.0, 1e-5, 0.024, 0.43, 0.51, 0.97, 1.6])
    radius = radius.double().requires_grad_()
    left, right = lens.psf_dp(at_radius(lens, radius), ks, psf_type, strict=True)
    columns = torch.arange(ks, dtype=DTYPE)
    apart = ((right - left).sum(1) * columns).sum(1)
    torch.testing.assert_close(apart, shift * radius, atol=1e-9, rtol=1e-3)
    (slope,) = torch.autograd.grad(apart.sum(), radius)
    torch.testing.assert_close(slope, torch.full_like(radius, shift), atol=1e-6, rtol=1e-3)
    assert min(left.min(), right.min()) > (-0.11 if ks % 2 else -1e-3)

"""Dual pixels of real sensors: less apart than half discs, and the mean of the pair stays."""

import math

import pytest
import torch
from measures import centroid

from defocus_core import Aperture, DualPixel, PupilImage, render, sensitivities
from defocus_core.allowed_values import DUAL_PIXEL_SENSORS

SMOOTH = DualPixel("smooth")
CROSSED = DualPixel("split", 0.15)


def measured(side=33):
    """Kernels of two photodiodes whose light falls off as a steep, smooth step across a disc."""
    v = (torch.arange(side, dtype=torch.float64) - side // 2) / (side // 2)
    disc = (v[None, :] ** 2 + v[:, None] ** 2 <= 1).double()
    left = disc / (1 + torch.exp(6 * (v[None, :] - 0.1)))
    return left, disc - left


MEASURED = DualPixel(measured=sensitivities(*measured()))


def scene():
    generator = torch.Generator().manual_seed(3)
    radius = torch.full((40, 48), 5.0)
    radius[12:30, 14:32] = -3.0
    return torch.rand(2, 40, 48, generator=generator), radius


@pytest.mark.parametrize("quality", ["standard", "high"])
@pytest.mark.parametrize("dual_pixel", [SMOOTH, CROSSED, DualPixel("smooth", 0.1), MEASURED])
def test_the_mean_of_the_pair_stays_the_centre(dual_pixel, quality):
    image, radius = scene()
    views = render(image, radius, quality=quality, left_right=True, dual_pixel=dual_pixel)
    alone = render(image, radius, quality=quality, dual_pixel=dual_pixel)
    assert torch.equal(views.render, alone.render)
    assert ((views.left + views.right) / 2 - views.render).abs().max() < 1e-6
    white = render(torch.ones_like(image), radius, left_right=True, dual_pixel=dual_pixel)
    assert all((view - 1).abs().max() < 1e-5 for view in white.images)


@pytest.mark.parametrize("name", DUAL_PIXEL_SENSORS)
def test_a_sensor_that_was_measured_is_its_model_with_its_crosstalk(name):
    model, crosstalk, _ = DUAL_PIXEL_SENSORS[name]
    image, radius = scene()
    sensors = DualPixel(name), DualPixel(model, crosstalk)
    views = [render(image, radius, left_right=True, dual_pixel=sensor) for sensor in sensors]
    torch.testing.assert_close(views[0].left, views[1].left)
    apart = DualPixel(name, 0.25).disparity(Aperture())
    assert apart == pytest.approx(DualPixel(model, crosstalk).disparity(Aperture()) / 2)


def test_nothing_of_a_smooth_half_is_dark_but_the_far_rim():
    kernel = SMOOTH.kernels(Aperture(), torch.tensor(20.0, dtype=torch.float64), 41)
    centre, left, right = kernel
    torch.testing.assert_close((left + right) / 2, centre, atol=1e-12, rtol=0)
    shares = (left / (2 * centre))[20]
    at = (torch.arange(41, dtype=torch.float64) - 20) / 20
    torch.testing.assert_close(shares[1:-1], ((1 - at) / 2)[1:-1], atol=1e-9, rtol=0)


def test_crosstalk_changes_the_pair_by_its_share():
    image, radius = scene()
    plain = render(image, radius, left_right=True)
    crossed = render(image, radius, left_right=True, dual_pixel=CROSSED)
    expected = 0.85 * plain.left + 0.15 * plain.right
    torch.testing.assert_close(crossed.left, expected, atol=1e-5, rtol=0)


def test_a_gradient_flows_to_the_crosstalk():
    image, radius = (x.double() for x in scene())

    def left(crosstalk):
        options = {"dual_pixel": DualPixel("split", crosstalk), "depth_repair": "off"}
        return render(image[:1, :20, :20], radius[:20, :20], left_right=True, **options).left

    share = torch.tensor(0.2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(left, [share], fast_mode=True)


@pytest.mark.parametrize("r", [16.5, -16.5])
def test_a_point_is_what_the_photodiodes_were_measured_to_see(r):
    left, right = measured()
    both = Aperture(image=PupilImage(left + right))
    image = torch.zeros(1, 80, 80)
    image[0, 40, 40] = 1.0
    options = {"aperture": both, "left_right": True, "dual_pixel": MEASURED}
    views = render(image, torch.full((80, 80), r), **options)
    for view, kernel in ((views.left, left), (views.right, right)):
        seen = view[0, 24:57, 24:57].double()
        expected = (kernel if r > 0 else kernel.flip(0, 1)) / left.sum()
        pair = torch.stack([seen.flatten(), expected.flatten()])
        assert float(torch.corrcoef(pair)[0, 1]) > 0.998
    apart = centroid(views.right)[0] - centroid(views.left)[0]
    expected = centroid(right)[0] - centroid(left)[0]
    assert apart == pytest.approx(math.copysign(expected, r), abs=0.05)


def test_noise_and_a_soft_border_of_measured_kernels_have_no_extent():
    left, right = (torch.nn.functional.pad(kernel, (24,) * 4) for kernel in measured())
    noisy = left.clone()
    noisy[0, 0] = noisy[-1, -2] = 0.03 * float((left + right).max())
    clean = DualPixel(measured=sensitivities(left, right))
    for pair in ((noisy, right), measured()):
        apart = DualPixel(measured=sensitivities(*pair)).disparity(Aperture())
        assert apart == pytest.approx(clean.disparity(Aperture()), rel=1e-3)

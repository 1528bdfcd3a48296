"""The thin lens obeys its closed forms, in float and in tensors, up to infinity."""

import math
import warnings

import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from defocus_core import DefocusLens, RandomDefocus

DEPTHS = torch.tensor([120.0, 800.0, 1999.0, 2000.0, 2500.0, 1e5, math.inf], dtype=torch.float64)


def camera(foc_dist=2000.0, **changes):
    """A 50 mm f/1.4 on a 36 mm sensor 480 px wide."""
    known = {"foclen": 50.0, "fnum": 1.4, "dtype": torch.float64}
    lens = DefocusLens(sensor_size=(36.0, 20.25), sensor_res=(480, 270), **known | changes)
    lens.refocus(foc_dist)
    return lens


def parameter(value):
    return torch.tensor(value, dtype=torch.float64, requires_grad=True)


def shot(pictures):
    """Pictures of two planes each, and their depth in mm."""
    image = torch.rand(pictures, 2, 12, 16, generator=torch.Generator().manual_seed(3)).double()
    depth = torch.full((pictures, 12, 16), 2600.0, dtype=torch.float64)
    depth[:, 3:9, 5:11] = 1500.0
    return image, depth * torch.linspace(1.0, 1.2, pictures).double()[:, None, None]


def test_a_lens_of_each_picture_renders_as_alone_and_has_its_gradients():
    image, depth = shot(3)
    values = torch.tensor([[50.0, 35.0, 85.0], [1.4, 2.0, 4.0], [2000.0, 1700.0, 2400.0]]).double()
    foclen, fnum, focus = together = [row.clone().requires_grad_() for row in values]
    seen = camera(focus, foclen=foclen, fnum=fnum).render_rgbd(image, depth)
    gradients = torch.stack(torch.autograd.grad(seen.square().sum(), together))
    for n in range(3):
        own = [parameter(float(value)) for value in values[:, n]]
        lens = camera(own[2], foclen=own[0], fnum=own[1])
        alone = lens.render_rgbd(image[n : n + 1], depth[n : n + 1])
        torch.testing.assert_close(seen[n : n + 1], alone)
        wanted = torch.stack(torch.autograd.grad(alone.square().sum(), own))
        torch.testing.assert_close(gradients[:, n], wanted)


def test_a_lens_of_each_picture_needs_as_many_pictures():
    lens = camera(fnum=torch.tensor([1.4, 2.0]))
    with pytest.raises(ValueError, match="fnum must be one number, or one for each of 3 pictures"):
        lens.render_rgbd(*shot(3))
    with pytest.raises(ValueError, match="radii_at_infinity has all"):
        lens.radius_at_infinity()


@settings(deadline=None)
@given(
    foclen=st.floats(5, 300),
    fnum=st.floats(0.7, 32),
    focus=st.floats(10, 1e7),
    depth=st.floats(10, 1e7),
)
def test_coc_is_what_the_marginal_rays_leave_on_the_sensor(foclen, fnum, focus, depth):
    assume(focus > 1.01 * foclen and depth > 1.01 * foclen)
    sensor = foclen * focus / (focus - foclen)
    image = foclen * depth / (depth - foclen)  # where the rays of the point meet
    traced = foclen / fnum * (sensor - image) / image
    lens = camera(focus, foclen=foclen, fnum=fnum)
    coc = 2 * lens.pixel_size * lens.signed_radius(depth)
    assert float(coc) == pytest.approx(traced, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("focus", [77.7, 2000.0, 12345.678, 1e7])
def test_what_is_in_focus_has_radius_exactly_zero(dtype, focus):
    depth = torch.tensor(focus, dtype=dtype)
    assert float(camera(focus, dtype=dtype).signed_radius(depth)) == 0


def test_a_focus_in_a_tensor_is_followed_through_gradient_steps():
    focus = parameter(2000.0)
    lens = camera(focus)
    for expected in (-2000.0, -2100.0):
        assert float(lens.foc_dist.detach()) == expected
        lens.signed_radius(3000.0).backward()
        focus.data += 100
    lens.foc_dist = 800.0
    assert lens.foc_dist == -800.0


def test_focus_is_at_twenty_metres_until_it_is_set_or_beyond_a_longer_lens():
    assert DefocusLens(50, 1.4).foc_dist == -20000.0
    assert DefocusLens(20000, 15.0).foc_dist == -math.inf, "a telescope has no nearer one"


@pytest.mark.parametrize("coc", [0.03, 0.1])
def test_focused_at_the_hyperfocal_distance_infinity_is_just_sharp(coc):
    far_point = camera().hyperfocal(coc)
    lens = camera(far_point)
    assert float(lens.coc(math.inf)) == pytest.approx(coc)
    near, _ = lens.dof_limits(far_point, coc)
    assert float(near) == pytest.approx(float(far_point) / 2)
    assert float(lens.dof_limits(far_point * 1.0001, coc)[1]) == math.inf
    assert math.isfinite(lens.dof_limits(far_point * 0.9999, coc)[1])


@pytest.mark.parametrize("focus", [100.0, 2000.0, -2000.0, 20000.0])
def test_at_the_limits_of_the_depth_of_field_the_coc_is_the_acceptable_one(focus):
    lens = camera(focus)
    near, far = lens.dof_limits(focus, 0.03)
    for limit, radius in ((near, -0.015), (far, 0.015)):
        assert float(lens.signed_radius(limit)) == pytest.approx(radius / lens.pixel_size)
    assert float(lens.dof(focus, 0.03)) == pytest.approx(float(far - near))


@pytest.mark.parametrize("depth", [-1500.0, -2500.0])
def test_dof_by_default_takes_the_points_own_coc_as_the_seed_does(depth):
    lens = camera()
    coc, m = float(lens.coc(depth)), 50.0 / (abs(depth) - 50.0)
    textbook = 2 * 1.4 * coc * (m + 1) / (m**2 - (1.4 * coc / 50.0) ** 2)
    assert float(lens.dof(depth)) == pytest.approx(textbook)
    assert float(lens.dof(-2000.0)) == 0


def test_limits_on_depth_are_none_unless_asked_for():
    lens = camera()
    assert (lens.d_far, lens.d_close) == (-math.inf, 0)
    lens.d_far, lens.d_close = -20000.0, -200.0
    torch.testing.assert_close(lens.coc(-1e6), lens.coc(-20000.0))
    torch.testing.assert_close(lens.coc(100.0), lens.coc(200.0))
    torch.testing.assert_close(lens.signed_radius(100.0), lens.signed_radius(200.0))


def test_gradients_of_the_radius_in_depth_and_every_lens_parameter():
    depth = DEPTHS[:-1].clone().requires_grad_()

    def radius(depth, foclen, fnum, foc_dist):
        return camera(foc_dist, foclen=foclen, fnum=fnum).signed_radius(depth)

    inputs = (depth, parameter(50.0), parameter(1.4), parameter(-2000.0))
    assert torch.autograd.gradcheck(radius, inputs, eps=1e-4, rtol=1e-6)


def test_gradients_at_infinity_are_zero_and_not_nan():
    focus, depth = parameter(math.inf), parameter(math.inf)
    camera(focus).signed_radius(depth).backward()
    assert focus.grad == 0
    assert depth.grad == 0


@pytest.mark.parametrize("psf_type", ["pillbox", "gaussian"])
def test_gradients_of_psf_and_depth_of_field_reach_the_lens(psf_type):
    inputs = (parameter(-1700.0), parameter(50.0), parameter(1.4), parameter(-2000.0))

    def outputs(z, foclen, fnum, foc_dist):
        lens = camera(foc_dist, foclen=foclen, fnum=fnum)
        points = torch.stack([z * 0, z * 0, z])
        kernels = (lens.psf(points, ks=8, psf_type=psf_type), *lens.psf_dp(points, 7, psf_type))
        return *kernels, lens.dof(z, 0.03), lens.hyperfocal(0.03)

    assert torch.autograd.gradcheck(outputs, inputs, eps=1e-5, rtol=1e-5)


def test_psf_is_the_same_alone_in_a_batch_in_rgb_and_in_a_map():
    lens = camera()
    points = torch.tensor([[0, 0, -1500.0], [0.5, -1, -2500.0]], dtype=torch.float64)
    batch = lens.psf(points, ks=31)
    torch.testing.assert_close(batch[1], lens.psf(points[1], ks=31))
    torch.testing.assert_close(batch, lens.psf(points.abs(), ks=31))
    pair = zip(
        lens.psf_dp(points, 32, "pillbox"),
        lens.psf_rgb_dp(points, 32, "pillbox"),
        lens.psf_map_dp((2, 3), 32, depth=-2500.0, psf_type="pillbox"),
        strict=True,
    )
    whole = batch, lens.psf_rgb(points, 31), lens.psf_map((2, 3), 31, depth=-2500.0)
    for psf, rgb, grid in (whole, *pair):
        size = psf.shape[-2:]
        assert (rgb.shape, grid.shape) == ((2, 3, *size), (2, 3, 1, *size))
        torch.testing.assert_close(rgb, psf[:, None].expand_as(rgb))
        torch.testing.assert_close(grid, psf[1].expand_as(grid))


def test_a_sharp_range_has_no_blur_and_leaves_the_law_outside():
    lens = DefocusLens(50.0, 1.4, (36.0, 24.0), (480, 320))
    lens.refocus(2000.0)
    z = torch.tensor([1000.0, 1800.0, 2100.0, 2400.0, 2400.1, math.inf], dtype=torch.float64)
    plain = lens.signed_radius(z)
    lens.sharp_range = (1800.0, 2400.0)
    ranged = lens.signed_radius(z)
    assert ranged[1:4].tolist() == [0.0, 0.0, 0.0]
    torch.testing.assert_close(ranged[[0, 4, 5]], plain[[0, 4, 5]], rtol=0, atol=0)
    for wrong in ((2400.0, 1800.0), (0.0, 1.0), 5.0, (1.0,)):
        lens.sharp_range = wrong
        with pytest.raises(ValueError, match=r"sharp_range must be \(nearest, farthest\)"):
            lens.signed_radius(z)


def test_depth_may_be_in_metres():
    image, depth = shot(1)
    lens = camera(depth_unit="m")
    assert torch.equal(lens.signed_radius(depth / 1000), camera().signed_radius(depth))
    dp = lens.render_rgbd_dp(image, -depth / 1000), camera().render_rgbd_dp(image, depth)
    assert all(map(torch.equal, *dp))
    drawn = RandomDefocus(depth_unit="m", max_radius=9.0)(image, depth / 1000, [7])[1]
    assert drawn.fnum == RandomDefocus(max_radius=9.0)(image, depth, [7])[1].fnum
    with pytest.warns(UserWarning, match='say DefocusLens.*depth_unit="m"'):
        camera().render_rgbd(image[..., :2, :2], depth[..., :2, :2] / 100_000)


def test_metres_taken_as_mm_are_said_once():
    lens = DefocusLens(50.0, 2.0, sensor_res=(16, 16))
    image, metres = torch.rand(1, 3, 16, 16), torch.full((1, 1, 16, 16), 3.0)
    with pytest.warns(UserWarning, match="within the focal length") as said:
        first = lens.render_rgbd(image, metres)
    assert len(said) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert torch.equal(lens.render_rgbd(image, metres), first)


def test_deeplens_names_of_type_and_half_diagonal():
    lens = DefocusLens(50.0, 2.0, sensor_size=(3.0, 4.0), sensor_res=(30, 40))
    assert lens.r_sensor == 2.5
    assert lens.astype(torch.float64) is lens
    assert lens.coc(-3000.0).dtype == torch.float64
    with pytest.raises(ValueError, match="dtype"):
        lens.astype(torch.int32)

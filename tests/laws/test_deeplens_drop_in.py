"""Programs for DeepLens' DefocusLens run with ours: signatures, shapes and signs are DeepLens'.

The cases are those of DeepLens' own tests of the class, told anew, and of its first example.
"""

import inspect
import math

import pytest
import torch

from defocus_core import DefocusLens

# Most of these kernels are narrower than the blur, as DeepLens' are.
pytestmark = pytest.mark.filterwarnings("ignore:kernels are cropped")


@pytest.fixture
def lens():
    """A 50 mm f/1.8 with pixels of 0.02 mm, focused at 1 m."""
    return focused(DefocusLens(50.0, 1.8, (20.0, 20.0), (1000, 1000), device="cpu"))


@pytest.fixture
def small():
    """The same lens before a sensor of 64 x 64 px."""
    return focused(DefocusLens(50.0, 1.8, (20.0, 20.0), (64, 64), device="cpu"))


@pytest.fixture
def pretended_gpu(monkeypatch):
    """A CUDA device that is there by its own word; who puts a tensor on it fails."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)


def focused(lens):
    lens.refocus(-1000.0)
    return lens


def points(*depths):
    return torch.tensor([[0.0, 0.0, z] for z in depths])


def image():
    return torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(0))


def plane(depth):
    return torch.full((1, 1, 64, 64), depth)


def test_the_sky_may_be_minus_infinity_in_a_map_of_negative_depth(small):
    depth = plane(-500.0)
    depth[..., :20] = -math.inf
    left, _ = small.render_rgbd_dp(image(), depth)
    assert torch.equal(left, small.render_rgbd_dp(image(), -depth)[0])


def test_the_first_example_of_deeplens_runs(small):
    assert f"f={small.foclen}, f/{small.fnum}, at {small.foc_dist}" == "f=50.0, f/1.8, at -1000.0"
    depths = torch.tensor([-500.0, -1000.0, -2000.0])
    assert all(len(numbers.tolist()) == 3 for numbers in (small.coc(depths), small.dof(depths)))
    psf = small.psf(torch.tensor([[0.0, 0.0, -500.0]]), ks=31, psf_type="pillbox")
    assert tuple(psf.shape[-2:]) == (31, 31)
    assert torch.equal(
        psf.to("cpu"), small.psf([[0.0, 0.0, -500.0]], ks=31, psf_type="pillbox").cpu()
    )
    chart = torch.rand(1, 3, 100, 150).to(small.device)
    small.set_sensor_res((chart.shape[-1], chart.shape[-2]))
    seen = small.render_rgbd(chart, torch.full_like(chart[:, :1], 2000.0), psf_ks=128)
    assert seen.shape == chart.shape


@pytest.mark.parametrize(
    ("method", "arguments"),
    [
        ("__init__", "foclen, fnum, sensor_size=(8.0, 8.0), sensor_res=(2000, 2000), device=None"),
        ("psf", "points, wvln=None, ks=64, psf_type='gaussian'"),
        ("psf_rgb", "points, ks=64"),
        ("psf_map", "grid=(5, 5), ks=64, depth=None"),
        ("psf_map_rgb", "grid=(5, 5), ks=64, depth=None"),
        ("psf_dp", "points, ks=64"),
        ("psf_rgb_dp", "points, ks=64"),
        ("psf_map_dp", "grid=(5, 5), ks=64, depth=None"),
        ("render_rgbd", "img_obj, depth_map, psf_ks"),
        ("render_rgbd_dp", "rgb_img, depth, psf_ks"),
        ("set_sensor", "sensor_size, sensor_res"),
        ("set_sensor_res", "sensor_res"),
        ("to", "device"),
        ("refocus", "foc_dist"),
        ("coc", "depth"),
        ("dof", "depth"),
    ],
)
def test_arguments_have_deeplens_names_order_and_defaults(method, arguments):
    parameters = list(inspect.signature(getattr(DefocusLens, method)).parameters.values())[1:]
    plain = [p.replace(annotation=p.empty) for p in parameters]
    assert str(inspect.Signature(plain))[1:-1].startswith(arguments)


def test_another_resolution_keeps_the_diagonal_and_makes_pixels_square(lens):
    lens.set_sensor_res((1600, 900))
    assert lens.sensor_res == (1600, 900)
    assert math.hypot(*lens.sensor_size) == pytest.approx(math.hypot(20, 20))
    width, height = lens.sensor_size
    assert width / 1600 == pytest.approx(height / 900) == pytest.approx(lens.pixel_size)


def test_another_sensor_has_its_own_pitch(lens):
    lens.set_sensor((36.0, 24.0), (360, 240))
    assert (lens.sensor_size, lens.sensor_res, lens.pixel_size) == ((36.0, 24.0), (360, 240), 0.1)
    with pytest.raises(ValueError, match="pixels must be square"):
        lens.set_sensor((36.0, 24.0), (360, 200))
    with pytest.raises(ValueError, match="vertical sensor_res must be positive"):
        lens.set_sensor_res((360, 0))
    assert lens.sensor_res == (360, 240)


def test_the_field_of_view_is_that_of_a_pinhole_in_radians(lens):
    lens.set_sensor((36.0, 24.0), (360, 240))
    assert math.degrees(lens.hfov) == pytest.approx(39.6, abs=0.01)  # tables of 35 mm film
    assert math.degrees(lens.vfov) == pytest.approx(26.99, abs=0.01)
    assert math.degrees(lens.dfov) == pytest.approx(46.79, abs=0.01)
    zoom = torch.tensor(50.0, requires_grad=True)
    lens.foclen = zoom
    lens.hfov.backward()
    assert zoom.grad.item() == pytest.approx(-36 / (50**2 + 18**2))


def test_without_a_device_a_lens_takes_the_gpu_if_there_is_one(monkeypatch, pretended_gpu):
    lens = DefocusLens(50.0, 1.8)
    assert lens.device.type == "cuda"
    assert "device=cuda" in repr(lens)
    assert lens.to("cpu") is lens
    assert lens.device == torch.device("cpu")
    assert lens.coc(-500.0).device.type == "cpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert DefocusLens(50.0, 1.8).device.type == "cpu"


def test_a_tensor_is_worked_on_where_it_is(small, pretended_gpu):
    lens = focused(DefocusLens(50.0, 1.8, (20.0, 20.0), (64, 64)))
    assert lens.device.type == "cuda"
    assert torch.equal(lens.psf(points(-900.0)), small.psf(points(-900.0)))
    assert torch.equal(lens.coc(torch.tensor([-500.0])), small.coc(torch.tensor([-500.0])))
    seen, depth = small.render_rgbd(image(), plane(900.0)), plane(900.0)
    for same in (depth, depth.numpy(), depth.tolist()):
        assert torch.equal(lens.render_rgbd(image(), same), seen)


def test_a_lens_says_what_it_is(lens):
    said = (
        "DefocusLens(foclen=50.0, fnum=1.8, sensor_size=(20.0, 20.0), sensor_res=(1000, 1000), "
        f"foc_dist=-1000.0, device={lens.device}, dtype=torch.float32)"
    )
    assert repr(lens) == str(lens) == said
    lens.foclen = torch.tensor(50.0, requires_grad=True)
    lens.refocus(torch.tensor(1000.0, requires_grad=True))
    assert repr(lens) == said

"""Kernels are the exact areas of the pupil over each pixel."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tolerances import ROUNDING, SUM

from defocus_core import Aperture
from defocus_core.optics.parts import FULL, LEFT, RIGHT, Part

DISC = Aperture()
HEXAGON = Aperture(blades=6, rotation=10.0)
PENTAGON = Aperture(blades=5)  # its left and right halves differ in area
SQUARE = Aperture(blades=4, rotation=45.0)  # edges level and upright
GAUSSIAN = Aperture(psf_type="gaussian")
APERTURES = [DISC, HEXAGON, PENTAGON, SQUARE, GAUSSIAN, Aperture(7, 3.0, "gaussian")]
FLAT = [DISC, HEXAGON, PENTAGON, SQUARE]
OBLIQUE = Part(x0=-0.43, x1=0.61, y0=-0.27, y1=0.9)
FINE = 61  # sub-pixels on a side of a supersampled pixel; odd, so the axes cut through middles


def sampled(radius, size, aperture, part):
    """The kernel by counting sub-pixel centres inside half planes."""
    fine = (torch.arange(size * FINE, dtype=torch.float64) + 0.5) / FINE - size / 2
    x, y = fine[None, :] / radius, fine[:, None] / radius
    inside = (x >= part.x0) & (x <= part.x1) & (y >= part.y0) & (y <= part.y1)
    for k in range(aperture.blades):
        middle = math.radians(aperture.rotation + 360 * (k + 0.5) / aperture.blades)
        apothem = math.cos(math.pi / aperture.blades)
        inside &= x * math.cos(middle) - y * math.sin(middle) <= apothem
    if not aperture.blades:
        inside &= x**2 + y**2 <= 1
    counts = inside.double().reshape(size, FINE, size, FINE).sum((1, 3))
    return counts / counts.sum()


def double(value):
    return torch.tensor(value, dtype=torch.float64)


def centres(size):
    return torch.arange(size, dtype=torch.float64) - (size - 1) / 2


@settings(deadline=None, max_examples=60)
@given(
    radius=st.floats(-12, 12),
    size=st.sampled_from([25, 26]),
    aperture=st.sampled_from(APERTURES),
    part=st.sampled_from([FULL, LEFT, RIGHT, OBLIQUE]),
    dtype=st.sampled_from([torch.float32, torch.float64]),
)
def test_every_kernel_that_fits_sums_to_one(radius, size, aperture, part, dtype):
    k = aperture.kernel(torch.tensor(radius, dtype=dtype), size, part)
    assert k.dtype == dtype
    assert k.min() >= 0
    assert float(k.sum()) == pytest.approx(1, abs=SUM[dtype])


@pytest.mark.parametrize("aperture", FLAT)
@pytest.mark.parametrize("part", [FULL, LEFT, RIGHT, OBLIQUE])
@pytest.mark.parametrize(("radius", "size"), [(3.3, 9), (-4.1, 10), (0.83, 4), (5.0, 11)])
def test_a_pixel_holds_the_share_of_the_area_that_falls_on_it(aperture, part, radius, size):
    k = aperture.kernel(double(radius), size, part)
    expected = sampled(radius, size, aperture, part)
    # along an upright or level edge the count is off by up to half a column of sub-pixels
    tolerance = 1.5 / FINE / (math.pi * radius**2 * aperture.fraction(part))
    assert (k - expected).abs().max() < tolerance
    assert (k - expected).abs().mean() < tolerance / 10


@pytest.mark.parametrize("size", [1, 7, 63])
@pytest.mark.parametrize("aperture", APERTURES)
def test_below_half_a_pixel_an_odd_kernel_is_a_delta(aperture, size):
    for radius in (0.0, 1e-12, 0.3, -0.5):
        k = aperture.kernel(double(radius), size)
        assert float(k[size // 2, size // 2]) == pytest.approx(1, abs=ROUNDING[torch.float64])


def test_at_radius_zero_an_even_kernel_is_shared_by_the_four_middle_pixels():
    for aperture in FLAT[:2]:
        k = aperture.kernel(double(0.0), 8)
        torch.testing.assert_close(k[3:5, 3:5].sum(), double(1.0))
        torch.testing.assert_close(k, k.flip(0, 1))


@pytest.mark.parametrize("aperture", APERTURES)
@pytest.mark.parametrize("part", [FULL, LEFT, OBLIQUE])
def test_a_negative_radius_turns_pupil_and_part_by_half_a_turn(aperture, part):
    far, near = (aperture.kernel(double(r), 13, part) for r in (5.3, -5.3))
    torch.testing.assert_close(near, far.flip(0, 1), atol=1e-14, rtol=0)


def test_rotation_puts_a_vertex_counter_clockwise_from_plus_x_as_seen():
    k = Aperture(blades=3, rotation=90.0).kernel(double(10.0), 21)
    assert k[:5].sum() > 0.01  # the vertex reaches up to y = -10 beyond focus
    assert k[16:].sum() < 1e-14  # the opposite edge lies at y = 5
    right = Aperture(blades=3).kernel(double(10.0), 21)
    torch.testing.assert_close(right, k.rot90(-1), atol=1e-14, rtol=0)


def test_gaussian_falls_off_as_its_formula_within_the_disc():
    radius, size = 9.0, 19
    ratio = GAUSSIAN.kernel(double(radius), size) / DISC.kernel(double(radius), size).clamp(
        min=1e-30
    )
    d2 = centres(size)[:, None] ** 2 + centres(size) ** 2
    whole = d2.sqrt() < radius - 1
    expected = torch.exp(-d2 / (2 * radius**2))
    relative = (ratio / expected)[whole]
    torch.testing.assert_close(relative, relative.mean().expand_as(relative))


@pytest.mark.parametrize("aperture", APERTURES)
@pytest.mark.parametrize(("part", "size"), [(FULL, 9), (LEFT, 10), (OBLIQUE, 9)])
def test_gradient_in_the_radius_is_that_of_the_areas(aperture, part, size):
    radius = torch.tensor([0.71, 2.33, -3.71], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda r: aperture.kernel(r, size, part), radius, fast_mode=True
    )


@pytest.mark.parametrize("aperture", APERTURES)
@pytest.mark.parametrize("size", [1, 8, 9])
def test_gradients_are_finite_where_square_roots_vanish(aperture, size):
    radius = torch.tensor([0, 1e-30, 0.5, 1, 1.5, -2, 4, 300], dtype=torch.float64)
    radius.requires_grad_()
    (aperture.kernel(radius, size) ** 2).sum().backward()
    assert radius.grad.isfinite().all()
    assert radius.grad[:2].tolist() == [0, 0]


@pytest.mark.parametrize("aperture", FLAT)
@pytest.mark.parametrize("count", [1, 2, 4])
def test_parts_tile_the_pupil_half_by_half_in_equal_areas(aperture, count):
    parts = aperture.parts(count)
    weights = [aperture.fraction(part) for part in parts]
    assert len(parts) == count
    for part, weight in zip(parts, weights, strict=True):
        half = aperture.fraction(LEFT if part.x1 <= 0 else RIGHT) if count > 1 else 1
        assert weight == pytest.approx(half / max(count // 2, 1), abs=1e-9)
    assert all(part.x1 <= 0 for part in parts[: count // 2])
    whole = sum(
        w * aperture.kernel(double(5.2), 13, p) for w, p in zip(weights, parts, strict=True)
    )
    torch.testing.assert_close(whole, aperture.kernel(double(5.2), 13), atol=1e-12, rtol=0)

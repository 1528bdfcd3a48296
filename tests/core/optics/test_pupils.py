"""Pupils that are neither round nor of straight blades keep energy, shape and gradients."""

import math

import pytest
import torch
from measures import centroid

from defocus_core import Aperture, PupilImage, render

CURVED = Aperture(5, 33.0, curvature=0.6)
MIRROR = Aperture(obstruction=0.4)
RING = Aperture(spherical=0.8)
OVAL = Aperture(squeeze=2.0)
FINE = 25  # sub-pixels on a side of a supersampled pixel


def double(value, *, learns=False):
    return torch.tensor(value, dtype=torch.float64, requires_grad=learns)


def heart(side=96):
    """A picture without symmetry up and down, off the middle of its frame."""
    v, u = (torch.arange(side, dtype=torch.float64) - side / 2) / (side / 3), None
    u = v[None, :] + 0.2
    v = -v[:, None] + 0.1
    return ((u**2 + v**2 - 1) ** 3 < u**2 * v**3).double()


IMAGE = Aperture(image=PupilImage(heart()))
PUPILS = [
    CURVED,
    MIRROR,
    RING,
    OVAL,
    IMAGE,
    Aperture(image=PupilImage(torch.eye(2))),  # no light in its middle
    Aperture(9, 10.0, curvature=0.9, obstruction=0.3, spherical=-0.7, squeeze=0.6),
]


def grid(radius, size):
    """Lens points u.x and u.y of the sub-pixels of a kernel."""
    fine = ((torch.arange(size * FINE, dtype=torch.float64) + 0.5) / FINE - size / 2) / radius
    return fine[None, :].expand(size * FINE, -1), fine[:, None].expand(-1, size * FINE)


def counted(inside, size):
    counts = inside.double().reshape(size, FINE, size, FINE).sum((1, 3))
    return counts / counts.sum()


@pytest.mark.parametrize("sides", [3, 5, 8])
@pytest.mark.parametrize("curvature", [0.2, 0.6, 0.97])
def test_curved_blades_are_arcs_through_the_vertices(sides, curvature):
    x, y = grid(7.3, 17)
    inside = torch.ones_like(x, dtype=torch.bool)
    for k in range(sides):
        middle = math.radians(33.0 + 360 * (k + 0.5) / sides)
        half = math.sin(math.pi / sides)
        away = math.cos(math.pi / sides) - math.sqrt(curvature**-2 - half**2)
        across, down = away * math.cos(middle), -away * math.sin(middle)
        inside &= (x - across) ** 2 + (y - down) ** 2 <= curvature**-2
    kernel = Aperture(sides, 33.0, curvature=curvature).kernel(double(7.3), 17)
    expected = counted(inside, 17)
    assert (kernel - expected).abs().max() < 3e-2 * expected.max()


def test_curvature_goes_from_the_polygon_to_the_disc():
    straight, disc = (a.kernel(double(8.2), 19) for a in (Aperture(6, 5.0), Aperture()))
    minimum, maximum = (
        Aperture(6, 5.0, curvature=c).kernel(double(8.2), 19) for c in (2e-3, 1 - 1e-7)
    )
    assert (minimum - straight).abs().max() < 5e-3 * straight.max()
    assert (maximum - disc).abs().max() < 1e-6 * disc.max()


def test_an_obstruction_is_a_dark_disc_of_its_share_of_the_radius():
    x, y = grid(9.1, 21)
    distance = (x**2 + y**2).sqrt()
    expected = counted((distance <= 1) & (distance >= 0.4), 21)
    assert (MIRROR.kernel(double(9.1), 21) - expected).abs().max() < 3e-2 * expected.max()


def test_a_squeezed_pupil_is_taller_than_wide_by_its_factor():
    kernel = Aperture(squeeze=2.0).kernel(double(20.0), 43)
    at = torch.arange(43, dtype=torch.float64) - 21
    wide, tall = (float((kernel.sum(dim) * at**2).sum() - 1 / 12) for dim in (0, 1))
    assert math.sqrt(tall / wide) == pytest.approx(2.0, rel=2e-3)
    assert 2 * math.sqrt(tall) == pytest.approx(20.0, rel=2e-3)
    flat = Aperture(squeeze=0.5).kernel(double(20.0), 43)
    torch.testing.assert_close(flat, kernel.mT)


def test_spherical_aberration_is_a_ring_on_one_side_of_focus_and_soft_on_the_other():
    x, y = grid(10.0, 23)
    squared = x**2 + y**2
    for radius in (10.0, -10.0):
        light = (squared <= 1) * (1 + math.copysign(0.8, radius) * (2 * squared - 1))
        expected = counted(light, 23)
        kernel = RING.kernel(double(radius), 23)
        assert (kernel - expected).abs().max() < 0.03 * expected.max()
    assert RING.kernel(double(10.0), 23)[11, 11] < 0.3 / (math.pi * 100)
    assert RING.kernel(double(-10.0), 23)[11, 11] > 1.7 / (math.pi * 100)


@pytest.mark.parametrize("radius", [8.0, 20.7])
def test_a_point_is_the_picture_of_the_pupil_resampled(radius):
    picture = heart()
    size = 2 * math.ceil(radius) + 1
    middle = centroid(picture)
    lit = picture.nonzero().flip(1)
    reach = float((lit - torch.tensor(middle)).abs().max())
    x, y = (u * (reach + 0.5) + m + 0.5 for u, m in zip(grid(radius, size), middle, strict=True))
    within = (x >= 0) & (x < 96) & (y >= 0) & (y < 96)
    light = picture[y.long().clamp(0, 95), x.long().clamp(0, 95)] * within
    expected = counted(light, size)
    for kernel in (
        IMAGE.kernel(double(radius), size),
        IMAGE.kernel(double(-radius), size).flip(0, 1),
    ):
        both = torch.stack([kernel.flatten(), expected.flatten()])
        assert float(torch.corrcoef(both)[0, 1]) > 0.9999
        at = torch.arange(size, dtype=torch.float64) - (size - 1) / 2
        assert abs(float(kernel.sum(0) @ at)) < 0.02
        assert abs(float(kernel.sum(1) @ at)) < 0.02


@pytest.mark.parametrize("pupil", PUPILS)
def test_every_pupil_leaves_white_white_and_left_and_right_make_the_whole(pupil):
    generator = torch.Generator().manual_seed(1)
    radius = torch.full((40, 44), 6.0)
    radius[10:30, 12:30] = -4.0
    views = render(torch.ones(1, 40, 44), radius, aperture=pupil, left_right=True)
    assert all(float((image - 1).abs().max()) < 1e-5 for image in views.images)
    views = render(
        torch.rand(1, 40, 44, generator=generator), radius, aperture=pupil, left_right=True
    )
    share = float(pupil.fraction(pupil.parts(2)[0]))
    mean = share * views.left + (1 - share) * views.right
    assert (views.render - mean).abs().max() < 1e-6


@pytest.mark.parametrize("pupil", PUPILS)
def test_a_highlight_keeps_its_energy(pupil):
    image = torch.zeros(1, 96, 96)
    image[0, 48, 47] = 1000.0
    shown = render(image, torch.full((96, 96), 17.0), aperture=pupil).render
    assert float(shown.sum()) == pytest.approx(1000.0, rel=1e-4)
    expected = pupil.kernel(double(17.0), 35).float() * 1000
    torch.testing.assert_close(shown[0, 31:66, 30:65], expected, atol=1e-3, rtol=0)
